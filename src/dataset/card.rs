//! The texts that lie beside the shards: a card for people and the licence notice.
//!
//! A release has a longer card; what both say is said here, section by section.

use std::fmt::Write;

use super::statistics::hole_share;
use crate::manifest::{BuiltBySource, DatasetManifest, SplitStatistics};

/// Reads shards in Python without code of ours; a person runs it in the dataset's directory.
const READ_IN_PYTHON: &str = r#"import glob, io, msgpack, numpy as np, zstandard

def records(shard):
    with open(shard, "rb") as file:
        stream = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
        for record in msgpack.Unpacker(stream, max_buffer_size=2**28):
            for key in ("height_m", "rsrp_dbm", "mask"):
                record[key] = np.load(io.BytesIO(record[key]))
            yield record

for shard in sorted(glob.glob("*/shard-*.msgpack.zst")):
    for record in records(shard):
        print(record["id"], record["split"], record["rsrp_dbm"].shape)
"#;

/// `NOTICE`: what must stay with the data.
pub(crate) fn notice(manifest: &DatasetManifest) -> String {
    let mut text = format!(
        "This dataset is derived from OpenStreetMap and is licensed {}.\n{}\n\
         https://www.openstreetmap.org/copyright\n\
         https://opendatacommons.org/licenses/odbl/1-0/\n\nBuildings were taken from:\n",
        manifest.licence, manifest.attribution,
    );
    for input in &manifest.inputs {
        let crate::store::Digest { bytes, sha256 } = &input.digest;
        writeln!(
            text,
            "- {} ({bytes} bytes, SHA-256 {sha256}), {}, {}",
            input.file, input.licence, input.attribution
        )
        .expect("writing to a string cannot fail");
    }
    text.push_str(
        "\nWho publishes the dataset or something derived from it must keep this notice.\n",
    );
    text
}

/// `README.md`: the dataset card.
pub(super) fn readme(manifest: &DatasetManifest) -> String {
    let records = manifest.records.len();
    let sections = [
        format!("# Coverage-hole dataset: {records} places in EPSG:{}\n", manifest.epsg),
        summary(manifest),
        figures(manifest),
        section("Records", &records_in_words(manifest)),
        section("Splits", &splits(manifest)),
        section("What was left out", &left_out(manifest)),
    ];
    sections.join("\n")
}

/// A section of a card.
pub(crate) fn section(title: &str, text: &str) -> String {
    format!("## {title}\n\n{text}")
}

/// What it is, in two lines.
pub(crate) fn summary(manifest: &DatasetManifest) -> String {
    let DatasetManifest { cells, cell_m, software, licence, attribution, .. } = manifest;
    format!(
        "Building heights and RSRP maps of {cells} × {cells} cells of {cell_m} m, made by {} {}.\n\
         Licence: {licence} (see NOTICE). {attribution}.\n",
        software.name, software.version,
    )
}

/// The figures of each split, what a hole is, and how many heights are known.
pub(crate) fn figures(manifest: &DatasetManifest) -> String {
    let rows: String =
        manifest.statistics.iter().map(|(split, figures)| row(split.name(), figures)).collect();
    let BuiltBySource { height, levels, default } = built_cells(manifest);
    let share = |part: u64| 100.0 * part as f64 / (height + levels + default).max(1) as f64;
    let threshold =
        manifest.statistics.values().next().map_or(-100.0, |figures| figures.hole_threshold_dbm.0);
    format!(
        "| split | records | outdoor cells | coverage holes | unreached | built up |\n\
         |---|---|---|---|---|---|\n{rows}\n\
         A coverage hole is an outdoor cell with RSRP below −{} dBm; unreached cells are holes.\n\
         Of the built-up area, {:.1} % has a tagged height, {:.1} % a number of levels, {:.1} % \
         a guessed height.\n",
        -threshold,
        share(height),
        share(levels),
        share(default),
    )
}

/// Built-up cells of all splits by the source of their height.
pub(crate) fn built_cells(manifest: &DatasetManifest) -> BuiltBySource {
    let mut sum = BuiltBySource::default();
    for SplitStatistics { built_cells, .. } in manifest.statistics.values() {
        sum.height += built_cells.height;
        sum.levels += built_cells.levels;
        sum.default += built_cells.default;
    }
    sum
}

/// The format of shards and records, with the lines of Python that read them.
pub(crate) fn records_in_words(manifest: &DatasetManifest) -> String {
    format!(
        "`<split>/shard-*.msgpack.zst` is the Zstandard seekable format, one MessagePack record \
         a frame; any Zstandard decoder reads it as one stream (`pip install msgpack numpy \
         zstandard`):\n\n```python\n{READ_IN_PYTHON}```\n\n\
         Arrays are `[row, column]`, row 0 north, column 0 west: `height_m` float32 in metres; \
         `rsrp_dbm` float32 in dBm per resource element ({} dBm where no path arrives); `mask` \
         uint8 with 0 outdoor, 1 building, 2 outdoor without a path. All fields are described \
         in the JSON Schema `record.v1`.\n",
        manifest.config.rsrp.floor_dbm.0,
    )
}

/// How the splits were drawn.
pub(crate) fn splits(manifest: &DatasetManifest) -> String {
    format!(
        "Places are assigned by blocks of {} m, not one by one. No cell of one split lies in a \
         record of another; {} records were left out for that. {} pairs of records of different \
         splits have whole tiles of {} m that overlap.\n",
        manifest.config.split.block_m,
        manifest.dropped.overlapping_another_split.len(),
        manifest.overlapping_tile_pairs,
        manifest.config.grid.side_m,
    )
}

/// What did not become a record.
pub(crate) fn left_out(manifest: &DatasetManifest) -> String {
    format!(
        "{} tiles have no radio map, {} maps were rejected. `manifest.json` counts every object \
         of OpenStreetMap that was skipped or repaired, by reason, and records the configuration \
         and the SHA-256 of all inputs.\n",
        manifest.dropped.tiles_without_map,
        manifest.dropped.rejected_maps.values().sum::<u64>(),
    )
}

fn row(split: &str, statistics: &SplitStatistics) -> String {
    let cells = statistics.cells;
    let outdoor = cells.reached + cells.unreached;
    let percent = |part: u64, whole: u64| 100.0 * part as f64 / whole.max(1) as f64;
    format!(
        "| {split} | {} | {outdoor} | {:.1} % | {:.1} % | {:.1} % |\n",
        statistics.records,
        100.0 * hole_share(statistics),
        percent(cells.unreached, outdoor),
        percent(cells.building, outdoor + cells.building),
    )
}
