//! The texts that lie beside the shards: a card for people and the licence notice.
//!
//! A release has a longer card; what both say is said here, section by section.

use std::fmt::Write;

use super::statistics::{hole_share, reliability_of, unsure_share};
use crate::manifest::{
    BuiltBySource, DatasetManifest, Reliability, ShiftHistogram, SplitStatistics,
};

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

/// The same where some records have errors: their levels and errors are integers.
const READ_ERRORS_IN_PYTHON: &str = r#"import glob, io, msgpack, numpy as np, zstandard

def records(shard):
    with open(shard, "rb") as file:
        stream = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
        for record in msgpack.Unpacker(stream, max_buffer_size=2**28):
            for key in ("height_m", "rsrp_dbm", "mask", "std_error_db", "first_half_share"):
                if key in record:
                    record[key] = np.load(io.BytesIO(record[key]))
            if record["schema"] == "record.v2":
                level = record["rsrp_dbm"]
                record["rsrp_dbm"] = np.where(level == -32768, record["floor_dbm"], level / 100).astype("f4")
                record["std_error_db"] = (record["std_error_db"] / 100).astype("f4")
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
    let reliability = reliability_of(manifest).map_or_else(String::new, |reliability| {
        format!("\n{}\n", reliability_in_words(manifest, &reliability))
    });
    format!(
        "| split | records | outdoor cells | coverage holes | unreached | built up |\n\
         |---|---|---|---|---|---|\n{rows}\n\
         A coverage hole is an outdoor cell with RSRP below −{} dBm; unreached cells are holes.\n\
         Of the built-up area, {:.1} % has a tagged height, {:.1} % a number of levels, {:.1} % \
         a guessed height.\n{reliability}",
        -threshold,
        share(height),
        share(levels),
        share(default),
    )
}

/// How sure the holes of a dataset are.
pub(crate) fn reliability_in_words(
    manifest: &DatasetManifest,
    reliability: &Reliability,
) -> String {
    let threshold =
        manifest.statistics.values().next().map_or(-100.0, |figures| figures.hole_threshold_dbm.0);
    let share = |part: u64| 100.0 * part as f64 / reliability.outdoor.max(1) as f64;
    let records = manifest.records.len() as u64;
    let single = match records.saturating_sub(reliability.records) {
        0 => String::new(),
        single => {
            format!(" {single} records were traced once: how sure their holes are is unknown.")
        }
    };
    let within = |part| match shift_db(&reliability.threshold_shift, part) {
        Some(shift) => format!("at most {shift} dB"),
        None => "some dB".to_owned(),
    };
    format!(
        "Levels of {} records are means of independent traces and have standard errors. {:.1} % of \
         their outdoor cells are unsure, holes at -{} dBm with a chance of 5 to 95 %; {:.1} % are \
         surely holes. A threshold {} away makes half of the unsure cells sure, one {} away nine \
         tenths.{single}",
        reliability.records,
        100.0 * unsure_share(reliability),
        -threshold,
        share(reliability.sure_holes),
        within(0.5),
        within(0.9),
    )
}

/// The end of the bin that completes a share of a histogram, in dB; `None` if that is the last, which
/// has no end, or nothing is counted.
fn shift_db(histogram: &ShiftHistogram, share: f64) -> Option<f64> {
    let total: u64 = histogram.counts.iter().sum();
    let mut below = 0;
    let bin = histogram.counts.iter().position(|count| {
        below += count;
        total > 0 && below as f64 >= share * total as f64
    });
    let bin = bin.filter(|&bin| bin + 1 < histogram.counts.len())?;
    Some((bin + 1) as f64 * histogram.step_db)
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
    let floor = manifest.config.rsrp.floor_dbm.0;
    let has_errors = reliability_of(manifest).is_some();
    let snippet = if has_errors { READ_ERRORS_IN_PYTHON } else { READ_IN_PYTHON };
    let schema = if has_errors {
        "All fields are described in the JSON Schemas `record.v1` and `record.v2`.\n\n\
         Records of schema `record.v2` have errors: `repeats` independent traces, their standard error \
         `std_error_db` in dB (stored in hundredths, as levels are), and `first_half_share`, in 250ths: what \
         the first half of the traces received of the power of all. The chance that a cell lies below \
         a threshold is `scipy.stats.t.cdf((threshold - rsrp_dbm) / std_error_db, repeats - 1)`, and \
         1 where `mask` is 2"
    } else {
        "All fields are described in the JSON Schema `record.v1`"
    };
    format!(
        "`<split>/shard-*.msgpack.zst` is the Zstandard seekable format, one MessagePack record \
         a frame; any Zstandard decoder reads it as one stream (`pip install msgpack numpy \
         zstandard`):\n\n```python\n{snippet}```\n\n\
         Arrays are `[row, column]`, row 0 north, column 0 west: `height_m` float32 in metres; \
         `rsrp_dbm` float32 in dBm per resource element ({floor} dBm where no path arrives); `mask` \
         uint8 with 0 outdoor, 1 building, 2 outdoor without a path. {schema}.\n",
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shifts_are_told_by_the_end_of_their_bin() {
        let shift = |counts: &[u64], share| {
            shift_db(&ShiftHistogram { step_db: 0.25, counts: counts.to_vec() }, share)
        };
        assert_eq!(shift(&[5, 3, 2, 0], 0.5), Some(0.25));
        assert_eq!(shift(&[5, 3, 2, 0], 0.9), Some(0.75));
        assert_eq!(shift(&[1, 0, 0, 9], 0.5), None, "the last bin has no end");
        assert_eq!(shift(&[0; 4], 0.5), None);
    }
}
