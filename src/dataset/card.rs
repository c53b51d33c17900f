//! The texts that lie beside the shards: a card for people and the licence notice.

use std::fmt::Write;

use super::statistics::hole_share;
use crate::manifest::{DatasetManifest, SplitStatistics};

const READ_IN_PYTHON: &str = r#"import io, msgpack, numpy as np, zstandard

def records(shard):
    with open(shard, "rb") as file:
        stream = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
        for record in msgpack.Unpacker(stream, max_buffer_size=2**28):
            for key in ("height_m", "rsrp_dbm", "mask"):
                record[key] = np.load(io.BytesIO(record[key]))
            yield record
"#;

/// `NOTICE`: what must stay with the data.
pub(super) fn notice(manifest: &DatasetManifest) -> String {
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
    let DatasetManifest { cells, cell_m, .. } = manifest;
    let records = manifest.records.len();
    let mut text = format!(
        "# Coverage-hole dataset: {records} places in EPSG:{}\n\n\
         Building heights and RSRP maps of {cells} × {cells} cells of {cell_m} m, made by {} {}.\n\
         Licence: {} (see NOTICE). {}.\n\n\
         | split | records | outdoor cells | coverage holes | unreached | built up |\n\
         |---|---|---|---|---|---|\n",
        manifest.epsg,
        manifest.software.name,
        manifest.software.version,
        manifest.licence,
        manifest.attribution,
    );
    for (split, statistics) in &manifest.statistics {
        text.push_str(&row(split.name(), statistics));
    }
    let built = manifest.statistics.values().map(|statistics| statistics.built_cells);
    let (mut tagged, mut levels, mut guessed) = (0, 0, 0);
    for cells in built {
        tagged += cells.height;
        levels += cells.levels;
        guessed += cells.default;
    }
    let share = |part: u64| 100.0 * part as f64 / (tagged + levels + guessed).max(1) as f64;
    write!(
        text,
        "\nA coverage hole is an outdoor cell with RSRP below −100 dBm; unreached cells are holes.\n\
         Of the built-up area, {:.1} % has a tagged height, {:.1} % a number of levels, {:.1} % \
         a guessed height.\n\n\
         ## Records\n\n\
         `<split>/shard-*.msgpack.zst` is the Zstandard seekable format, one MessagePack record \
         a frame; any Zstandard decoder reads it as one stream:\n\n```python\n{READ_IN_PYTHON}```\n\n\
         Arrays are `[row, column]`, row 0 north, column 0 west: `height_m` float32 in metres; \
         `rsrp_dbm` float32 in dBm per resource element ({} dBm where no path arrives); `mask` \
         uint8 with 0 outdoor, 1 building, 2 outdoor without a path. All fields are described \
         in the JSON Schema `record.v1`.\n\n\
         ## Splits\n\n\
         Places are assigned by blocks of {} m, not one by one. No cell of one split lies in a \
         record of another; {} records were left out for that. {} pairs of records of different \
         splits have whole tiles of {} m that overlap.\n\n\
         ## What was left out\n\n\
         {} tiles have no radio map, {} maps were rejected. `manifest.json` counts every object \
         of OpenStreetMap that was skipped or repaired, by reason, and records the configuration \
         and the SHA-256 of all inputs.\n",
        share(tagged),
        share(levels),
        share(guessed),
        manifest.config.rsrp.floor_dbm.0,
        manifest.config.split.block_m,
        manifest.dropped.overlapping_another_split.len(),
        manifest.overlapping_tile_pairs,
        manifest.config.grid.side_m,
        manifest.dropped.tiles_without_map,
        manifest.dropped.rejected_maps.values().sum::<u64>(),
    )
    .expect("writing to a string cannot fail");
    text
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
