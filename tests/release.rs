//! `holescout release` and `holescout diff`, on the fixtures.
//!
//! What a release is to a reader without Holescout is tested by `tests/release/test_release.py`.

mod pipeline;

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use holescout::dataset::Dataset;
use holescout::grid::TileId;
use serde_json::{Value, json};

use pipeline::{
    DATASET_FILES, HELSINKI, Tree, assert_same_files, assert_says, copy_of, fixture,
    helsinki_config, holescout, import, read, read_json, release, run, sha256, shard, shared_dir,
    temporary_dir, tree, verify, write,
};

const VERSION: &str = "1.2.0";
/// 2026-07-01, seven hours after midnight.
const EPOCH: u64 = 1_782_889_200;

/// A release with an archive, made once.
static RELEASE: LazyLock<PathBuf> = LazyLock::new(|| {
    let out = shared_dir("release").join("out");
    run(release(&HELSINKI.dataset, VERSION, &out).arg("--tar")).succeeds();
    out
});

fn archive(out: &Path) -> PathBuf {
    out.with_extension("tar")
}

/// A dataset of the fixtures with other settings of `shard`.
fn variant(name: &str, flags: &[&str]) -> PathBuf {
    let out = shared_dir(&format!("release-variant-{name}")).join("dataset");
    run(shard(&HELSINKI.tiles, &HELSINKI.rsrp, &out).args(flags)).succeeds();
    out
}

/// A dataset of the fixtures with other keys in its configuration.
fn configured(name: &str, toml: &str) -> PathBuf {
    let root = shared_dir(&format!("release-configured-{name}"));
    let (config, out) = (root.join("config.toml"), root.join("dataset"));
    let text = String::from_utf8(read(&helsinki_config())).expect("text");
    write(&config, format!("{text}\n{toml}\n"));
    let mut command = holescout("shard");
    command.arg("--tiles").arg(&HELSINKI.tiles).arg("--rsrp").arg(&HELSINKI.rsrp);
    run(command.arg("--config").arg(config).arg("--out").arg(&out)).succeeds();
    out
}

/// A dataset of all maps but one.
static FEWER: LazyLock<PathBuf> = LazyLock::new(|| {
    let root = shared_dir("release-fewer");
    let first = read_json(&HELSINKI.dataset.join("manifest.json"))["records"][0]["id"].clone();
    let first = first.as_str().expect("a name").to_owned();
    for (name, bytes) in tree(&fixture("helsinki/rsrp")) {
        if !name.contains(&first) {
            write(&root.join("maps").join(name), bytes);
        }
    }
    let (rsrp, out) = (root.join("rsrp"), root.join("dataset"));
    run(&mut import(&root.join("maps"), &HELSINKI.tiles, &rsrp)).succeeds();
    run(&mut shard(&HELSINKI.tiles, &rsrp, &out)).succeeds();
    assert_eq!(read_json(&out.join("manifest.json"))["records"].as_array().map(Vec::len), Some(14));
    out
});

// What is in it --------------------------------------------------------------------------

#[test]
fn a_release_is_a_sound_dataset_with_the_same_shards() {
    let files = tree(&RELEASE);
    let said = run(&mut verify(&RELEASE)).succeeds();
    assert_says(&said, &["sound", "15 items"]);
    let others = [
        "NOTICE",
        "README.md",
        "SHA256SUMS",
        "config.toml",
        "croissant.json",
        "index.html",
        "inputs.sha256",
        "manifest.json",
        "record.v1.json",
        "records.csv",
    ];
    assert!(others.iter().all(|name| files.contains_key(*name)));
    let shards = [DATASET_FILES[4], DATASET_FILES[5]];
    for name in shards {
        assert!(files[name] == read(&HELSINKI.dataset.join(name)), "{name}");
    }
    let pictures = files.keys().filter(|name| name.starts_with("card/utm")).count();
    assert_eq!(pictures, 10);
    assert_eq!(files.len(), others.len() + shards.len() + pictures + 2, "two histograms");

    let manifest = read_json(&RELEASE.join("manifest.json"));
    let dataset = read(&HELSINKI.dataset.join("manifest.json"));
    let release = json!({
        "name": "helsinki",
        "version": VERSION,
        "creators": [],
        "software": manifest["software"],
        "dataset_manifest_sha256": sha256(&dataset),
    });
    assert_eq!(manifest["release"], release);
    let croissant = read_json(&RELEASE.join("croissant.json"));
    assert_eq!(croissant.get("datePublished"), None, "no date was given");
    let schema = Path::new(env!("CARGO_MANIFEST_DIR")).join("schemas/record.v1.json");
    assert!(files["record.v1.json"] == read(&schema));
}

/// The data of a release's page.
fn page_data(release: &Path) -> Value {
    let page = String::from_utf8(read(&release.join("index.html"))).expect("text");
    assert!(page.len() < 4_000_000, "{} bytes", page.len());
    let (_, data) = page.split_once(r#"<script type="application/json" id="data">"#).expect("data");
    let (data, _) = data.split_once("</script>").expect("its end");
    serde_json::from_str(data).expect("JSON")
}

#[test]
fn the_page_shows_what_the_records_hold() {
    let data = page_data(&RELEASE);
    let detail = &data["detail"];
    let step = |name: &str| detail[name].as_f64().expect("a number");
    assert_eq!(detail["planes"], json!(["heights", "levels"]), "maps of one trace have no errors");
    let dataset = Dataset::open(&RELEASE).expect("a dataset");
    let records = data["records"].as_array().expect("a list");
    assert_eq!(records.len(), dataset.ids().len());
    for shown in records {
        let id: TileId = shown["id"].as_str().expect("a name").parse().expect("an id");
        let (record, grids) = dataset.record_with_grids(id).expect("a record");
        assert_eq!(shown["split"], record.split.name());
        assert_eq!(shown["center_m"], json!(record.center_m));
        assert_eq!(shown["base_station_m"], json!(record.base_station.position_m));
        let decoded = |field: &str| {
            BASE64_STANDARD.decode(shown[field].as_str().expect("text")).expect("base64")
        };
        assert_eq!(decoded("thumbnail").len(), 16 * 16 / 2);
        let mut planes = Vec::new();
        let packed = decoded("planes");
        flate2::read::DeflateDecoder::new(&packed[..]).read_to_end(&mut planes).expect("deflated");
        let (heights, levels) = planes.split_at(grids.height_m.len());
        assert_eq!(levels.len(), grids.height_m.len());
        for (&byte, &height) in heights.iter().zip(&grids.height_m) {
            let off = f64::from(byte) * step("height_step_m") - f64::from(height);
            assert!(off.abs() <= step("height_step_m") / 2.0 || byte == 255, "{id}: {off} m");
        }
        let mut holes = 0;
        for ((&byte, &level), &kind) in levels.iter().zip(&grids.rsrp_dbm).zip(&grids.mask) {
            holes += u64::from(kind != 1 && (kind == 2 || level < -100.0));
            match (byte, kind) {
                (0, 1) | (1, 2) => {}
                (2.., 0) => {
                    let at = step("level_low_dbm") + f64::from(byte - 2) * step("level_step_db");
                    let off = (at - f64::from(level)).abs();
                    assert!(
                        off <= step("level_step_db") / 2.0 + 1e-6 || byte == 2,
                        "{id}: {off} dB"
                    );
                }
                other => panic!("{id}: {other:?}"),
            }
        }
        let outdoor = grids.mask.iter().filter(|kind| **kind != 1).count() as f64;
        let share = shown["hole_share"].as_f64().expect("a share");
        assert!((share - holes as f64 / outdoor).abs() < 1e-4, "{id}: {share}");
    }
}

#[test]
fn the_card_tells_figures_origin_limits_and_licence() {
    let card = String::from_utf8(read(&RELEASE.join("README.md"))).expect("text");
    let manifest = sha256(&read(&HELSINKI.dataset.join("manifest.json")));
    assert!(card.starts_with("---\nlicense: odbl\n"), "front matter first");
    let words = [
        "- n<1K\n",
        "Version 1.2.0",
        &manifest,
        "| train | 8 |",
        "| val | 7 |",
        "15 records: ",
        "GHz",
        "diffraction",
        "| tag `height` |",
        "`holescout verify --rebuild`",
        "`SOURCE_DATE_EPOCH` must be unset",
        "Not for planning or running a network",
        "@misc{helsinki,",
        "ODbL-1.0",
        "© OpenStreetMap contributors",
    ];
    assert_says(&card, &words);
    let notice = String::from_utf8(read(&RELEASE.join("NOTICE"))).expect("text");
    let extract = sha256(&read(&fixture("helsinki/helsinki.osm.pbf")));
    assert_says(&notice, &["ODbL-1.0", "helsinki.osm.pbf", &extract]);
}

#[test]
fn the_configuration_is_the_one_of_the_dataset() {
    let mut command = holescout("config");
    command.arg("--json").arg("--config").arg(RELEASE.join("config.toml"));
    let config: Value = serde_json::from_str(&run(&mut command).succeeds()).expect("JSON");
    let manifest = read_json(&RELEASE.join("manifest.json"));
    let sections = manifest["config"].as_object().expect("a table");
    assert_eq!(sections.len(), 6);
    for (section, keys) in sections {
        assert_eq!(config[section], *keys, "{section}");
    }
}

#[test]
fn the_card_tells_where_holes_lie() {
    let card = String::from_utf8(read(&RELEASE.join("README.md"))).expect("text");
    let rows = card.lines().filter(|line| line.contains(" m") && line.starts_with("| "));
    let cells: u64 = rows
        .filter(|row| row.contains(" to ") || row.contains("or more"))
        .filter_map(|row| row.split('|').nth(2)?.trim().parse::<u64>().ok())
        .sum();
    let manifest = read_json(&RELEASE.join("manifest.json"));
    let outdoor = |split: &str| {
        let cells = &manifest["statistics"][split]["cells"];
        cells["reached"].as_u64().expect("a number") + cells["unreached"].as_u64().expect("one")
    };
    // Every record has a building, so that all outdoor cells have a distance to one.
    assert_eq!(cells, outdoor("train") + outdoor("val"));
}

/// The commands of the card, run as they stand where the inputs lie, give the release again.
#[test]
fn the_commands_of_the_card_build_the_same_release() {
    builds_again(&RELEASE, &["config.toml", "inputs.sha256"]);
}

/// What the makers say is a section of the card, and part of what is built again.
#[test]
fn the_notes_of_the_makers_are_in_the_card() {
    let dir = temporary_dir();
    let (notes, out) = (dir.path().join("said.md"), dir.path().join("out"));
    write(&notes, "Walls are of *concrete*.\n\n\n");
    run(release(&HELSINKI.dataset, VERSION, &out).arg("--notes").arg(&notes)).succeeds();
    let card = String::from_utf8(read(&out.join("README.md"))).expect("text");
    assert_says(&card, &["## From the makers\n\nWalls are of *concrete*.\n\n## Building it again"]);
    builds_again(&out, &["config.toml", "inputs.sha256", "notes.md"]);
    let mut absent = release(&HELSINKI.dataset, VERSION, &dir.path().join("absent"));
    let message = run(absent.arg("--notes").arg(dir.path().join("none.md"))).refused();
    assert_says(&message, &["none.md"]);
}

/// Runs the commands of a release's card where these files of it and the inputs lie.
fn builds_again(release: &Path, files: &[&str]) {
    let dir = temporary_dir();
    fs::copy(fixture("helsinki/helsinki.osm.pbf"), dir.path().join("helsinki.osm.pbf"))
        .expect("copied");
    for (name, bytes) in tree(&fixture("helsinki/rsrp")) {
        write(&dir.path().join("maps").join(name), bytes);
    }
    for name in files {
        fs::copy(release.join(name), dir.path().join(name)).expect("copied");
    }
    let card = String::from_utf8(read(&release.join("README.md"))).expect("text");
    let block = card.split("```sh\n").nth(1).and_then(|rest| rest.split("```").next());
    let block = block.expect("a block of commands");
    assert_eq!(block.lines().count(), 5);
    let program = Path::new(env!("CARGO_BIN_EXE_holescout")).parent().expect("a directory");
    let path = std::env::var("PATH").unwrap_or_default();
    let mut shell = Command::new("sh");
    shell.args(["-e", "-c", block]).current_dir(dir.path()).env_remove("SOURCE_DATE_EPOCH");
    run(shell.env("PATH", format!("{}:{path}", program.display()))).succeeds();
    assert_same_files(&tree(&dir.path().join("helsinki-1.2.0")), &tree(release));
}

// The same bytes -------------------------------------------------------------------------

#[test]
fn the_same_bytes_in_another_directory_and_with_any_number_of_threads() {
    for threads in ["1", "2"] {
        let (dir, dataset, _) = copy_of(&HELSINKI.dataset);
        let out = dir.path().join(format!("elsewhere{threads}"));
        run(release(&dataset, VERSION, &out).args(["--tar", "--threads", threads])).succeeds();
        assert_same_files(&tree(&out), &tree(&RELEASE));
        assert!(read(&archive(&out)) == read(&archive(&RELEASE)), "{threads} threads");
    }
}

#[test]
fn the_archive_holds_the_files_and_nothing_of_this_machine() {
    let dir = temporary_dir();
    let out = dir.path().join("dated");
    let mut command = release(&HELSINKI.dataset, VERSION, &out);
    run(command.arg("--tar").env("SOURCE_DATE_EPOCH", EPOCH.to_string())).succeeds();
    assert_eq!(read_json(&out.join("manifest.json"))["release"]["date"], "2026-07-01");
    for (out, mtime) in [(&out, EPOCH), (&*RELEASE, 0)] {
        let mut found = Tree::new();
        let bytes = read(&archive(out));
        let mut archive = tar::Archive::new(&bytes[..]);
        for entry in archive.entries().expect("an archive") {
            let mut entry = entry.expect("an entry");
            let header = entry.header();
            let owner = (header.uid().expect("a number"), header.gid().expect("a number"));
            assert_eq!((owner, header.mode().expect("a mode")), ((0, 0), 0o644));
            assert_eq!(header.mtime().expect("a time"), mtime);
            let name = entry.path().expect("a path").to_string_lossy().into_owned();
            let mut bytes = Vec::new();
            entry.read_to_end(&mut bytes).expect("read");
            let name = name.strip_prefix("helsinki-1.2.0/").expect("one folder").to_owned();
            assert!(found.keys().next_back().is_none_or(|last| *last < name), "sorted: {name}");
            found.insert(name, bytes);
        }
        assert_same_files(&found, &tree(out));
    }
}

#[test]
fn an_interrupted_release_ends_in_the_same_bytes() {
    let (dir, dataset, files) = copy_of(&HELSINKI.dataset);
    let name = DATASET_FILES[5];
    let out = dir.path().join("out");
    let mut damaged = files[name].clone();
    damaged[100] ^= 1;
    write(&dataset.join(name), &damaged);
    let said = run(&mut release(&dataset, VERSION, &out)).refused();
    assert_says(&said, &[name, "differs from its manifest", &sha256(&damaged)]);
    assert!(!out.join("manifest.json").exists());
    assert!(out.join(DATASET_FILES[4]).exists(), "interrupted after the first shard");
    write(&dataset.join(name), &files[name]);
    run(&mut release(&dataset, VERSION, &out)).succeeds();
    assert_same_files(&tree(&out), &tree(&RELEASE));
}

#[test]
fn a_release_released_anew_is_a_release_of_its_dataset() {
    let dir = temporary_dir();
    let [first, again, direct] = ["first", "again", "direct"].map(|name| dir.path().join(name));
    run(&mut release(&HELSINKI.dataset, "1.0.0", &first)).succeeds();
    run(&mut release(&first, "1.0.1", &again)).succeeds();
    run(&mut release(&HELSINKI.dataset, "1.0.1", &direct)).succeeds();
    assert_same_files(&tree(&again), &tree(&direct));
}

#[test]
fn what_is_said_of_a_release_stands_in_card_croissant_and_commands() {
    let dir = temporary_dir();
    let out = dir.path().join("out");
    let mut command = release(&HELSINKI.dataset, "2.0.0-rc.1", &out);
    command.args(["--name", "hki", "--date", "2026-07-01", "--url", "https://example.org/hki"]);
    run(command.args(["--creator", "Ann O'Neill", "--creator", "Bo"])).succeeds();
    let croissant = read_json(&out.join("croissant.json"));
    let expected = [
        ("/name", json!("hki")),
        ("/version", json!("2.0.0-rc.1")),
        ("/datePublished", json!("2026-07-01")),
        ("/url", json!("https://example.org/hki")),
        ("/creator/1/name", json!("Bo")),
    ];
    for (path, value) in expected {
        assert_eq!(croissant.pointer(path), Some(&value), "{path}");
    }
    let card = String::from_utf8(read(&out.join("README.md"))).expect("text");
    let words = [
        "author = {Ann O'Neill and Bo}",
        "year = {2026}",
        r"--name hki --date 2026-07-01 --url https://example.org/hki --creator 'Ann O'\''Neill'",
    ];
    assert_says(&card, &words);
}

// What is refused ------------------------------------------------------------------------

#[test]
fn what_cannot_be_released_is_refused_and_nothing_is_written() {
    let dir = temporary_dir();
    let out = dir.path().join("out");
    let wrong_usage = [["--version", "1.2"], ["--version", "v1.2.0"], ["--date", "2026-02-30"]];
    for flags in wrong_usage {
        let mut command = holescout("release");
        command.arg(&HELSINKI.dataset).arg("--out").arg(&out).args(flags);
        if flags[0] != "--version" {
            command.args(["--version", VERSION]);
        }
        let run = run(&mut command);
        assert_eq!(run.code, Some(2), "{run:?}");
        assert_says(&run.stderr, &[flags[1]]);
    }
    let invalid: [(&[&str], &[&str]); 3] = [
        (&["--name", "../x"], &["../x", "letters"]),
        (&["--name", ""], &["letters"]),
        (&["--previous", "nowhere"], &["nowhere"]),
    ];
    for (flags, words) in invalid {
        let said = run(release(&HELSINKI.dataset, VERSION, &out).args(flags)).refused();
        assert_says(&said, words);
    }
    let mut command = release(&HELSINKI.dataset, VERSION, &out);
    let said = run(command.env("SOURCE_DATE_EPOCH", "yesterday")).refused();
    assert_says(&said, &["SOURCE_DATE_EPOCH", "yesterday", "seconds"]);
    let said = run(&mut release(&HELSINKI.tiles, VERSION, &out)).refused();
    assert_says(&said, &["tiles.v2", "holescout shard"]);
    assert!(!out.exists());
}

#[test]
fn a_release_is_never_written_into_its_dataset() {
    let (dir, dataset, files) = copy_of(&HELSINKI.dataset);
    let link = dir.path().join("link");
    std::os::unix::fs::symlink(&dataset, &link).expect("linked");
    for out in [dataset.clone(), dataset.join("release"), link.join("a/b"), dataset.join("x/..")] {
        let mut command = release(&dataset, VERSION, &out);
        let said = run(command.arg("--overwrite")).refused();
        assert_says(&said, &["lies in the dataset", "--out"]);
    }
    assert_same_files(&tree(&dataset), &files);
}

#[test]
fn other_files_are_replaced_only_when_that_is_asked_for() {
    let dir = temporary_dir();
    let out = dir.path().join("out");
    run(release(&HELSINKI.dataset, "1.0.0", &out).arg("--tar")).succeeds();
    let before = tree(&out);
    let said = run(&mut release(&HELSINKI.dataset, VERSION, &out)).refused();
    assert_says(&said, &["--overwrite"]);
    let packed = read(&archive(&out));
    run(release(&HELSINKI.dataset, "1.0.0", &out).arg("--tar")).succeeds();
    assert!(read(&archive(&out)) == packed, "the same command, the same bytes");
    let mut other = packed.clone();
    other[1000] ^= 1;
    for other in [other, packed[1..].to_vec(), [&packed[..], b"x"].concat()] {
        write(&archive(&out), &other);
        let said = run(release(&HELSINKI.dataset, "1.0.0", &out).arg("--tar")).refused();
        assert_says(&said, &["out.tar", "--overwrite"]);
        assert!(read(&archive(&out)) == other, "it is left as it was");
    }
    assert_same_files(&tree(&out), &before);
    run(release(&HELSINKI.dataset, VERSION, &out).args(["--tar", "--overwrite"])).succeeds();
    assert_same_files(&tree(&out), &tree(&RELEASE));
    assert!(read(&archive(&out)) == read(&archive(&RELEASE)));
}

/// A copy of the dataset with another manifest, and the list of checksums to it.
fn forged(change: impl FnOnce(&mut Value)) -> (tempfile::TempDir, PathBuf) {
    let (dir, dataset, _) = copy_of(&HELSINKI.dataset);
    let path = dataset.join("manifest.json");
    let before = sha256(&read(&path));
    let mut manifest = read_json(&path);
    change(&mut manifest);
    write(&path, manifest.to_string());
    let sums = String::from_utf8(read(&dataset.join("SHA256SUMS"))).expect("text");
    write(&dataset.join("SHA256SUMS"), sums.replace(&before, &sha256(&read(&path))));
    (dir, dataset)
}

#[test]
fn more_files_than_zenodo_takes_are_refused_with_a_number_that_would_do() {
    let (dir, dataset) = forged(|manifest| {
        let shards = manifest["shards"].as_array_mut().expect("a list");
        for number in 1..=80 {
            let mut shard = shards[0].clone();
            shard["file"] = json!(format!("train/shard-{number:05}.msgpack.zst"));
            shard["records"] = json!(0);
            shards.push(shard);
        }
        manifest["statistics"]["train"]["records"] = json!(80 * 256);
    });
    let out = dir.path().join("out");
    let said = run(&mut release(&dataset, VERSION, &out)).refused();
    let words = ["82 shards", "104 files", "at most 100", "--records-per-shard 266"];
    assert_says(&said, &words);
    assert!(!out.exists());
}

#[test]
fn a_manifest_cannot_lead_out_of_the_directory() {
    for file in ["../shard-00000.msgpack.zst", "train/shard-../../x.msgpack.zst", "/etc/passwd"] {
        let (dir, dataset) = forged(|manifest| {
            let named = manifest["shards"][0]["file"].take();
            manifest["shards"][0]["file"] = json!(file);
            for record in manifest["records"].as_array_mut().expect("a list") {
                if record["shard"] == named {
                    record["shard"] = json!(file);
                }
            }
        });
        let out = dir.path().join("out");
        let said = run(&mut release(&dataset, VERSION, &out)).refused();
        assert_says(&said, &[file]);
        assert!(!out.exists());
    }
}

// What changed ---------------------------------------------------------------------------

fn diff(a: &Path, b: &Path) -> Value {
    let mut command = holescout("diff");
    let stdout = run(command.arg(a).arg(b).arg("--json")).succeeds();
    serde_json::from_str(stdout.trim_end()).expect("one line of JSON")
}

fn lengths(diff: &Value) -> [usize; 4] {
    ["added", "removed", "moved", "changed"]
        .map(|key| diff["records"][key].as_array().map_or(0, Vec::len))
}

fn keys(diff: &Value, part: &str) -> Vec<String> {
    let changes = diff[part].as_array().expect("a list").iter();
    changes.map(|change| change["key"].as_str().expect("a key").to_owned()).collect()
}

#[test]
fn a_dataset_is_the_same_as_its_copy() {
    let (_dir, copy, _) = copy_of(&HELSINKI.dataset);
    let diff = diff(&HELSINKI.dataset, &copy);
    assert_eq!((&diff["step"], &diff["reasons"]), (&json!("none"), &json!([])));
    assert_eq!(lengths(&diff), [0; 4]);
}

#[test]
fn packing_is_a_patch_though_every_shard_differs() {
    let flags = [["--zstd-level", "1"], ["--records-per-shard", "3"]];
    for (name, flags, keys_changed) in
        [("level", &flags[0], "shard.zstd_level"), ("shards", &flags[1], "shard.records_per_shard")]
    {
        let diff = diff(&HELSINKI.dataset, &variant(name, flags));
        assert_eq!((&diff["step"], lengths(&diff)), (&json!("patch"), [0; 4]), "{name}");
        assert_eq!(keys(&diff, "config"), [keys_changed]);
        let changed = diff["files"]["changed"].as_array().expect("a list");
        assert!(changed.contains(&json!(DATASET_FILES[4])), "{changed:?}");
    }
}

#[test]
fn other_order_is_a_patch() {
    let diff = diff(&HELSINKI.dataset, &configured("order", "[shard]\norder_seed = 7"));
    assert_eq!((&diff["step"], lengths(&diff)), (&json!("patch"), [0; 4]));
    assert_eq!(keys(&diff, "config"), ["shard.order_seed"]);
}

#[test]
fn more_records_are_minor_and_fewer_are_major() {
    let first = read_json(&HELSINKI.dataset.join("manifest.json"))["records"][0]["id"].clone();
    let more = diff(&FEWER, &HELSINKI.dataset);
    assert_eq!((&more["step"], lengths(&more)), (&json!("minor"), [1, 0, 0, 0]));
    assert_eq!(more["records"]["added"], json!([first]));
    let fewer = diff(&HELSINKI.dataset, &FEWER);
    assert_eq!((&fewer["step"], lengths(&fewer)), (&json!("major"), [0, 1, 0, 0]));
    assert_eq!(fewer["records"]["removed"], json!([first]));
}

#[test]
fn other_splits_are_major() {
    let moved = diff(&HELSINKI.dataset, &variant("splits", &["--test", "1"]));
    assert_eq!(moved["step"], "major");
    let records = moved["records"]["moved"].as_array().expect("a list");
    assert!(!records.is_empty());
    assert!(records.iter().all(|it| (&it["from"], &it["to"]) == (&json!("train"), &json!("test"))));
    assert_eq!(lengths(&moved)[3], 0, "the same values in another split");
    assert_eq!(keys(&moved, "config"), ["split.test"]);
}

#[test]
fn other_values_are_major_and_named() {
    let nearest = configured("nearest", "[shard]\nrsrp = \"nearest\"");
    let values = diff(&HELSINKI.dataset, &nearest);
    assert_eq!((&values["step"], lengths(&values)), (&json!("major"), [0, 0, 0, 15]));
    let fields = &values["records"]["changed"][0]["fields"];
    assert!(fields.as_array().expect("a list").contains(&json!("rsrp_dbm")), "{fields}");
    assert_eq!(keys(&values, "config"), ["shard.rsrp"]);

    let cells = diff(&HELSINKI.dataset, &variant("cells", &["--downsample", "2"]));
    assert_eq!(cells["step"], "major");
    assert_eq!(keys(&cells, "facts"), ["cell_m", "cells"]);
}

#[test]
fn a_dataset_that_becomes_a_release_gains_files() {
    let gained = diff(&HELSINKI.dataset, &RELEASE);
    assert_eq!((&gained["step"], lengths(&gained)), (&json!("minor"), [0; 4]));
    assert_eq!(diff(&RELEASE, &HELSINKI.dataset)["step"], "major");
}

#[test]
fn versions_are_held_against_the_changes() {
    let dir = temporary_dir();
    let make = |name: &str, dataset: &Path, version: &str| {
        let out = dir.path().join(name);
        run(&mut release(dataset, version, &out)).succeeds();
        out
    };
    let first = make("first", &HELSINKI.dataset, "1.1.0");
    let same = make("same", &HELSINKI.dataset, "1.1.1");
    let small = make("small", &FEWER, "1.2.0");
    let check =
        |a: &Path, b: &Path, flags: &[&str]| run(holescout("diff").arg(a).arg(b).args(flags));
    assert_says(&check(&first, &same, &["--check"]).succeeds(), &["step: patch", "far enough"]);
    let words = ["records removed: 1", "step: major", "1.2.0 should be at least 2.0.0"];
    assert_says(&check(&first, &small, &[]).succeeds(), &words);
    assert_says(&check(&first, &small, &["--check"]).refused(), &words[2..]);
    let said = check(&HELSINKI.dataset, &small, &["--check"]).refused();
    assert_says(&said, &["two releases"]);
    let summary = diff(&first, &small);
    assert_eq!(
        (&summary["least_version"], &summary["version_is_enough"]),
        (&json!("2.0.0"), &json!(false))
    );

    // The same rule, before anything is written.
    let next = |dataset: &Path, version: &str, previous: &Path, name: &str| {
        let mut command = release(dataset, version, &dir.path().join(name));
        run(command.arg("--previous").arg(previous))
    };
    let said = next(&FEWER, "1.2.0", &first, "refused").refused();
    assert_says(&said, &["1.2.0", "1.1.0", "1 records are gone", "2.0.0"]);
    assert!(!dir.path().join("refused").exists());
    next(&FEWER, "2.0.0", &first, "major").succeeds();
    next(&HELSINKI.dataset, "1.1.1", &first, "patch").succeeds();
    next(&HELSINKI.dataset, "1.1.0", &first, "again").refused();
    let said = next(&FEWER, "2.0.0", &HELSINKI.dataset, "no").refused();
    assert_says(&said, &["no release"]);
}

#[test]
fn what_is_no_dataset_cannot_be_compared() {
    let said = run(holescout("diff").arg(&HELSINKI.tiles).arg(&HELSINKI.dataset)).refused();
    assert_says(&said, &["tiles.v2"]);
    let (_dir, copy, _) = copy_of(&HELSINKI.dataset);
    fs::remove_file(copy.join("SHA256SUMS")).expect("removed");
    let said = run(holescout("diff").arg(&copy).arg(&HELSINKI.dataset)).refused();
    assert_says(&said, &["SHA256SUMS"]);
}
