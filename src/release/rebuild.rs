//! What builds a release again: its configuration, its inputs by checksum, the commands.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::Path;

use serde_json::json;

use crate::manifest::{DatasetManifest, Input, MapFile, to_json};

/// The configuration of a dataset.
pub(super) const CONFIG: &str = "config.toml";
/// SHA-256 of extracts and radio maps.
pub(super) const INPUTS: &str = "inputs.sha256";
/// The polygons that tiles were asked for by.
pub(super) const AREA: &str = "area.geojson";
/// What the makers say of the data.
pub(super) const NOTES: &str = "notes.md";
/// Folder of the radio maps in [`INPUTS`].
const MAPS: &str = "maps";
/// Folder of the scenes that maps were traced from.
pub(super) const SCENES: &str = "scenes";

/// All that is written of it, by file name.
pub(super) fn files(manifest: &DatasetManifest) -> Vec<(&'static str, Vec<u8>)> {
    let mut files =
        vec![(CONFIG, config_toml(manifest).into_bytes()), (INPUTS, inputs(manifest).into_bytes())];
    files.extend(area_geojson(manifest).map(|area| (AREA, area)));
    let notes = manifest.release.as_ref().and_then(|release| release.notes.clone());
    files.extend(notes.map(|notes| (NOTES, notes.into_bytes())));
    files
}

/// `config.toml`, as `--config` accepts it: the sections that a dataset depends on.
fn config_toml(manifest: &DatasetManifest) -> String {
    toml::to_string_pretty(&manifest.config).expect("a configuration came from TOML's types")
}

/// `area.geojson`, as `rasterise --area` accepts it, if tiles were asked for by an area.
fn area_geojson(manifest: &DatasetManifest) -> Option<Vec<u8>> {
    let coordinates = manifest.area.as_ref()?;
    Some(to_json(&json!({ "type": "MultiPolygon", "coordinates": coordinates })))
}

/// `inputs.sha256`, in the format of `sha256sum`: the extracts and all maps, those that were rejected
/// too.
fn inputs(manifest: &DatasetManifest) -> String {
    let mut text = String::new();
    for (input, path) in manifest.inputs.iter().zip(extracts(&manifest.inputs)) {
        push(&mut text, &input.digest.sha256, &path);
    }
    for MapFile { file, digest, sidecar } in &manifest.import.maps {
        let of_sidecar = Path::new(file).with_extension("json");
        let files = [(Path::new(file), digest), (&of_sidecar, sidecar)];
        for (file, digest) in files {
            if let Some(digest) = digest {
                push(&mut text, &digest.sha256, &format!("{MAPS}/{}", file.display()));
            }
        }
    }
    text
}

/// Where the extracts lie: each in a folder of its own where two have one name.
fn extracts(inputs: &[Input]) -> Vec<String> {
    let names: BTreeSet<&str> = inputs.iter().map(|input| input.file.as_str()).collect();
    let differ = names.len() == inputs.len();
    let path = |(number, Input { file, .. }): (usize, &Input)| {
        if differ { file.clone() } else { format!("{}/{file}", number + 1) }
    };
    inputs.iter().enumerate().map(path).collect()
}

fn push(text: &mut String, sha256: &str, file: &str) {
    writeln!(text, "{sha256}  {file}").expect("writing to a string cannot fail");
}

/// The commands, one a line, to be run where the inputs and `config.toml` lie.
pub(super) fn commands(manifest: &DatasetManifest) -> String {
    let extracts = extracts(&manifest.inputs);
    let extracts: Vec<String> = extracts.iter().map(|path| quoted(path)).collect();
    let mut release = String::from("holescout release dataset");
    if let Some(this) = &manifest.release {
        let mut flag = |name: &str, value: &str| {
            write!(release, " --{name} {}", quoted(value))
                .expect("writing to a string cannot fail");
        };
        flag("version", &this.version);
        flag("name", &this.name);
        if let Some(date) = &this.date {
            flag("date", date);
        }
        if let Some(url) = &this.url {
            flag("url", url);
        }
        this.creators.iter().for_each(|creator| flag("creator", creator));
        if this.notes.is_some() {
            flag("notes", NOTES);
        }
    }
    let extracts = extracts.join(" ");
    let area = if manifest.area.is_some() { format!(" --area {AREA}") } else { String::new() };
    let from_scenes = manifest.import.scenes_manifest_sha256.is_some();
    let scenes = if from_scenes { format!(" --scenes {SCENES}") } else { String::new() };
    format!(
        "sha256sum -c {INPUTS}\n\
         holescout --config {CONFIG} rasterise --osm {extracts}{area} --out tiles\n\
         holescout --config {CONFIG} import-rsrp --maps {MAPS} --tiles tiles{scenes} --out rsrp\n\
         holescout --config {CONFIG} shard --tiles tiles --rsrp rsrp --out dataset\n\
         {release}\n"
    )
}

/// A word of a shell's command line.
fn quoted(word: &str) -> String {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "-_./:+@%=,".contains(letter);
    if !word.is_empty() && word.chars().all(plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::sha256_bytes;

    #[test]
    fn extracts_of_one_name_lie_apart() {
        let input = |file: &str| Input {
            file: file.to_owned(),
            digest: sha256_bytes(b""),
            licence: String::new(),
            attribution: String::new(),
        };
        assert_eq!(extracts(&[input("a.pbf"), input("b.pbf")]), ["a.pbf", "b.pbf"]);
        assert_eq!(extracts(&[input("a.pbf"), input("a.pbf")]), ["1/a.pbf", "2/a.pbf"]);
    }

    #[test]
    fn words_are_quoted_for_a_shell() {
        assert_eq!(quoted("helsinki.osm.pbf"), "helsinki.osm.pbf");
        assert_eq!(quoted("Ann O'Neill"), r"'Ann O'\''Neill'");
        assert_eq!(quoted(""), "''");
    }
}
