//! Records for people and their tools: JSON with plain lists, a table of all records.

use ndarray::Array2;
use serde::Serialize;
use serde_json::{Value, json};

use super::error::ReadError;
use super::grids::Grids;
use super::read::Dataset;
use super::record::Record;
use super::statistics::{hole_share, reliability_of, statistics_of, unsure_share};
use crate::manifest::{DatasetManifest, ErrorGrids, IndexEntry, SplitStatistics};

/// A record with its arrays as nested lists, rows from north to south, instead of `.npy` bytes.
#[must_use]
pub fn record_json(record: &Record, grids: &Grids) -> Value {
    fn rows<T: Copy + Serialize>(array: &Array2<T>) -> Value {
        json!(array.rows().into_iter().map(|row| row.to_vec()).collect::<Vec<_>>())
    }
    let mut value = json!(record);
    value["height_m"] = rows(&grids.height_m);
    value["rsrp_dbm"] = rows(&grids.rsrp_dbm);
    value["mask"] = rows(&grids.mask);
    if let Some(ErrorGrids { std_error_db, first_half_share }) = &grids.errors {
        value["std_error_db"] = rows(std_error_db);
        if let Some(shares) = first_half_share {
            value["first_half_share"] = rows(shares);
        }
    }
    value
}

/// Columns of the table of records: name, type of schema.org, meaning.
const COLUMNS: [[&str; 3]; 11] = [
    ["id", "sc:Text", "Name of the place: UTM zone, easting and northing of its centre in metres."],
    ["split", "sc:Text", "train, val or test."],
    ["lon", "sc:Float", "Longitude of the centre, in degrees (WGS 84)."],
    ["lat", "sc:Float", "Latitude of the centre, in degrees (WGS 84)."],
    ["reached", "sc:Integer", "Outdoor cells that a path reaches."],
    ["unreached", "sc:Integer", "Outdoor cells without a path."],
    ["building", "sc:Integer", "Cells that a building covers."],
    ["hole_share", "sc:Float", "Coverage holes as a share of outdoor cells, 0 to 1."],
    ["max_height_m", "sc:Float", "Height of the highest building, in metres."],
    ["shard", "sc:Text", "Path of the shard that holds the record."],
    ["frame", "sc:Integer", "Index of the record's frame in the shard, from 0."],
];

/// Further columns where some records have errors.
const COLUMNS_OF_ERRORS: [[&str; 3]; 2] = [
    ["repeats", "sc:Integer", "Independent traces that levels are the mean of."],
    [
        "unsure_share",
        "sc:Float",
        "Outdoor cells that are holes with a chance of 5 to 95 %, as a share of all, 0 to 1.",
    ],
];

/// The columns of a dataset's table of records.
pub(crate) fn columns(manifest: &DatasetManifest) -> Vec<[&'static str; 3]> {
    let mut columns = COLUMNS.to_vec();
    if reliability_of(manifest).is_some() {
        columns.extend(COLUMNS_OF_ERRORS);
    }
    columns
}

/// A line of the table of records, its values in the order of [`columns`]; those of errors are
/// empty in a record that has none.
pub(crate) fn table_row(
    entry: &IndexEntry,
    record: &Record,
    grids: &Grids,
    statistics: &SplitStatistics,
) -> Vec<String> {
    let [lon, lat] = record.center_lon_lat;
    let unsure = statistics.reliability.as_ref().map(unsure_share);
    vec![
        entry.id.to_string(),
        record.split.to_string(),
        format!("{lon:.7}"),
        format!("{lat:.7}"),
        statistics.cells.reached.to_string(),
        statistics.cells.unreached.to_string(),
        statistics.cells.building.to_string(),
        format!("{:.6}", hole_share(statistics)),
        grids.height_m.iter().copied().fold(0.0, f32::max).to_string(),
        entry.shard.clone(),
        entry.frame.to_string(),
        record.repeats.unwrap_or(1).to_string(),
        unsure.map_or_else(String::new, |share| format!("{share:.6}")),
    ]
}

/// Lines of the table below its header, as CSV.
pub(crate) fn table_csv(
    manifest: &DatasetManifest,
    rows: impl IntoIterator<Item = Vec<String>>,
) -> Vec<u8> {
    let columns = columns(manifest);
    let mut csv = csv::Writer::from_writer(Vec::new());
    let header = columns.iter().map(|[name, ..]| name);
    csv.write_record(header).expect("writing to memory cannot fail");
    for row in rows {
        csv.write_record(row.iter().take(columns.len())).expect("writing to memory cannot fail");
    }
    csv.into_inner().expect("writing to memory cannot fail")
}

/// A CSV table with a line for each record: what one would sort and filter by.
///
/// # Errors
/// When a record cannot be read.
pub fn records_csv(dataset: &Dataset) -> Result<Vec<u8>, ReadError> {
    let rows = dataset.manifest().records.iter().map(|entry| {
        let (record, grids) = dataset.record_with_grids(entry.id)?;
        Ok(table_row(entry, &record, &grids, &statistics_of(&record, &grids)))
    });
    let rows = rows.collect::<Result<Vec<_>, ReadError>>()?;
    Ok(table_csv(dataset.manifest(), rows))
}
