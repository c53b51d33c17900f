//! The card of a release: what somebody needs to know who has nothing but its directory.
//!
//! Figures come from the manifest and the records; the limits hold for every dataset of this
//! program, and name the settings that they depend on.

use super::charts::FOLDER;
use super::page;
use super::rebuild::{AREA, CONFIG, INPUTS, NOTES, SCENES, commands};
use super::scan::Scan;
use crate::config::Split;
use crate::dataset::{card, croissant, reliability_of};
use crate::grid::TileId;
use crate::manifest::{BuiltBySource, DatasetManifest, Release};

/// Kinds of radio maps that are named; rarer ones are counted.
const MOST_KINDS: usize = 5;

/// `README.md`; `shown` are the records of which there are pictures.
pub(super) fn readme(manifest: &DatasetManifest, scan: &Scan, shown: &[(TileId, Split)]) -> String {
    let section = card::section;
    let title = croissant::title(manifest);
    let sections = [
        front_matter(manifest, &title),
        format!("# {title}\n"),
        card::summary(manifest),
        published(manifest),
        section("Figures", &figures(manifest)),
        section("Pictures", &pictures(shown)),
        section("Records", &records(manifest)),
        section("Radio maps", &radio_maps(scan)),
        section("Holes and walls", &walls(scan)),
        section("Heights", &heights(manifest)),
        section("Splits", &card::splits(manifest)),
        section("What was left out", &card::left_out(manifest)),
        section("What it is for", INTENDED_USE),
        section("Limits", &limits(manifest)),
        notes(manifest),
        section("Building it again", &rebuilding(manifest)),
        section("Citing it", &format!("```bibtex\n{}\n```\n", croissant::citation(manifest))),
        section("Licence", &licence(manifest)),
    ];
    let there = sections.into_iter().filter(|section| !section.is_empty());
    there.collect::<Vec<_>>().join("\n")
}

/// `NOTICE`: that of the dataset, and where the radio maps are listed.
pub(super) fn notice(manifest: &DatasetManifest) -> String {
    format!(
        "{}\nRadio maps of these buildings were taken from {} files; `{INPUTS}` names each with its \
         SHA-256.\n",
        card::notice(manifest),
        manifest.import.maps.len()
    )
}

/// The metadata that Hugging Face reads from a card.
fn front_matter(manifest: &DatasetManifest, title: &str) -> String {
    let size = match manifest.records.len() {
        0..1_000 => "n<1K",
        1_000..10_000 => "1K<n<10K",
        10_000..100_000 => "10K<n<100K",
        100_000..1_000_000 => "100K<n<1M",
        _ => "n>1M",
    };
    let licence = match manifest.licence.as_str() {
        "ODbL-1.0" => "license: odbl\n".to_owned(),
        other => format!("license: other\nlicense_name: {}\nlicense_link: NOTICE\n", text(other)),
    };
    format!(
        "---\n{licence}pretty_name: {}\nsize_categories:\n- {size}\n\
         task_categories:\n- reinforcement-learning\n\
         tags:\n- radio-map\n- rsrp\n- coverage-hole\n- ray-tracing\n- openstreetmap\n- geospatial\n\
         - uav\n---\n",
        text(title),
    )
}

/// A string of YAML: JSON's are.
fn text(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

fn published(manifest: &DatasetManifest) -> String {
    let Some(Release { version, date, url, software, dataset_manifest_sha256, .. }) =
        &manifest.release
    else {
        return String::new();
    };
    let date = date.as_ref().map_or_else(String::new, |date| format!(" of {date}"));
    let url = url.as_ref().map_or_else(String::new, |url| format!(", published at <{url}>"));
    format!(
        "Version {version}{date}{url}. Released with {} {} from the dataset whose manifest has \
         SHA-256 `{dataset_manifest_sha256}`. `sha256sum -c SHA256SUMS` checks every file; \
         `holescout verify` every record too.\n",
        software.name, software.version,
    )
}

fn figures(manifest: &DatasetManifest) -> String {
    format!(
        "{}\n![Histogram of RSRP]({FOLDER}/rsrp.png)\n\n\
         ![Histogram of the share of coverage holes]({FOLDER}/hole-share.png)\n",
        card::figures(manifest)
    )
}

fn pictures(shown: &[(TileId, Split)]) -> String {
    let list: Vec<String> = shown
        .iter()
        .map(|(id, split)| format!("\n![{id} ({split})]({FOLDER}/{id}.png)\n"))
        .collect();
    format!(
        "{} records, of each split in turn by a hash of their names: heights, RSRP, coverage holes; \
         north is up, the cross is the base station. `{}` shows all of them: open it in a browser, no \
         network is needed.\n{}",
        shown.len(),
        page::FILE,
        list.concat()
    )
}

fn records(manifest: &DatasetManifest) -> String {
    let schemas = if reliability_of(manifest).is_some() {
        "`record.v1.json` and `record.v2.json` are these schemas"
    } else {
        "`record.v1.json` is that schema"
    };
    format!(
        "{}\n\
         {schemas}. `records.csv` has a line for each record, `manifest.json` \
         its shard and frame, `croissant.json` all this for machines (Croissant 1.1, GeoCroissant \
         1.0).\n",
        card::records_in_words(manifest)
    )
}

fn radio_maps(scan: &Scan) -> String {
    let mut kinds: Vec<(&String, &u64)> = scan.radio.iter().collect();
    kinds.sort_by_key(|(_, records)| std::cmp::Reverse(**records));
    let named = kinds.iter().take(MOST_KINDS);
    let mut lines: Vec<String> =
        named.map(|(kind, records)| format!("- {records} records: {kind}\n")).collect();
    if kinds.len() > MOST_KINDS {
        lines.push(format!("- {} more kinds\n", kinds.len() - MOST_KINDS));
    }
    let [lowest, highest] = scan.power_dbm;
    let power = if lowest == highest {
        format!("{lowest} dBm")
    } else {
        format!("{lowest} to {highest} dBm")
    };
    format!(
        "Levels were ray-traced, one base station a record, {power} per resource element:\n\n{}\n\
         Each record tells its base station, its radio parameters, and the file that its map came \
         from with its SHA-256.\n",
        lines.concat()
    )
}

fn walls(scan: &Scan) -> String {
    format!(
        "Shadows lie behind walls: outdoor cells of all records that have a building, by the distance of \
         their centres to the nearest one that is as high as the UAV flies.\n\n{}",
        scan.walls.table()
    )
}

/// What its makers say of the data, if they do.
fn notes(manifest: &DatasetManifest) -> String {
    let notes = manifest.release.as_ref().and_then(|release| release.notes.as_deref());
    let section =
        |notes: &str| card::section("From the makers", &format!("{}\n", notes.trim_end()));
    notes.map_or_else(String::new, section)
}

fn heights(manifest: &DatasetManifest) -> String {
    let BuiltBySource { height, levels, default } = card::built_cells(manifest);
    let total = (height + levels + default).max(1) as f64;
    let row = |source: &str, cells: u64| {
        format!("| {source} | {cells} | {:.1} % |\n", 100.0 * cells as f64 / total)
    };
    let buildings = &manifest.config.buildings;
    format!(
        "| height from | built-up cells | share |\n|---|---|---|\n{}{}{}\n\
         A level counts {} m. A guess is {} m, or by type of building what `{CONFIG}` says. Cells are \
         those of the height grids of {} m before downsampling; every record has its own counts in \
         `provenance.built_cells`.\n",
        row("tag `height`", height),
        row("number of levels", levels),
        row("guess", default),
        buildings.level_height_m,
        buildings.default_height_m,
        manifest.config.grid.cell_m,
    )
}

const INTENDED_USE: &str = "\
Research on finding coverage holes with UAVs and on predicting radio maps: training and comparing \
methods under the same conditions. Train on `train`, choose on `val`, report `test` once.\n";

fn limits(manifest: &DatasetManifest) -> String {
    let BuiltBySource { height, levels, default } = card::built_cells(manifest);
    let guessed = 100.0 * default as f64 / (height + levels + default).max(1) as f64;
    let lacking = match manifest.dropped.tiles_without_map {
        0 => "Every tile that passed the filter has a map.".to_owned(),
        tiles => format!(
            "{tiles} tiles of the area have no map: whoever chose which to trace chose what is here."
        ),
    };
    let grid = &manifest.config.grid;
    format!(
        "- Not for planning or running a network, nor for saying where somebody has service: nothing \
           here was measured.\n\
         - Ray tracing knows the materials that it was given, one for all walls as a rule, and no \
           vegetation, vehicles, people, terrain or weather.\n\
         - One base station a record. In a network a hole of one is covered by another.\n\
         - {guessed:.1} % of the built-up area has a guessed height; a guess moves shadows.\n\
         - Buildings are as OpenStreetMap had them in the extract: some are missing, some are gone.\n\
         - A cell is {cell_m} m wide: alleys narrower than that may be closed.\n\
         - All places lie in one area (EPSG:{epsg}) and have at least {buildings} buildings in \
           {side} m: what holds here need not hold in other cities, nor in the country. {lacking}\n\
         - Splits are apart by their windows of {crop} m. Radio and buildings beyond a window are \
           shared by neighbours of different splits ({pairs} pairs of tiles overlap).\n",
        cell_m = manifest.cell_m,
        epsg = manifest.epsg,
        buildings = manifest.config.filter.min_buildings,
        side = grid.side_m,
        crop = grid.crop_m,
        pairs = manifest.overlapping_tile_pairs,
    )
}

fn rebuilding(manifest: &DatasetManifest) -> String {
    let made = &manifest.software;
    let released = manifest.release.as_ref().map_or(made, |release| &release.software);
    let area = if manifest.area.is_some() { format!(", `{AREA}`") } else { String::new() };
    let versions = if made == released {
        format!("{} {}", made.name, made.version)
    } else {
        format!("{} {} (the last command with {})", made.name, made.version, released.version)
    };
    let scenes = manifest.import.scenes_manifest_sha256.as_ref().map_or_else(String::new, |sha256| {
        format!(
            " The import also needs, in `{SCENES}/`, the scenes whose manifest has SHA-256 {sha256}."
        )
    });
    let has_notes = manifest.release.as_ref().is_some_and(|release| release.notes.is_some());
    let notes = if has_notes { format!(", `{NOTES}`") } else { String::new() };
    let dated = manifest.release.as_ref().is_some_and(|release| release.date.is_some());
    let epoch = if dated { "" } else { " `SOURCE_DATE_EPOCH` must be unset." };
    format!(
        "With {versions}, in a directory that holds `{CONFIG}`{area}{notes}, the extracts and, in `maps/`, the \
         radio maps:\n\n```sh\n{}```\n\n\
         `{INPUTS}` names every extract and every map by its SHA-256.{scenes}{epoch} \
         `holescout verify --rebuild` does the same elsewhere and compares every file.\n",
        commands(manifest)
    )
}

fn licence(manifest: &DatasetManifest) -> String {
    format!(
        "{}: <https://opendatacommons.org/licenses/odbl/1-0/>. {}. Who publishes the dataset or \
         something derived from it must keep `NOTICE`, which names every source.\n",
        manifest.licence, manifest.attribution
    )
}
