//! Records for people and their tools: JSON with plain lists, a table of all records.

use ndarray::Array2;
use serde::Serialize;
use serde_json::{Value, json};

use super::read::{Dataset, ReadError};
use super::record::{Grids, Record};
use super::statistics::{hole_share, statistics_of};
use crate::manifest::{IndexEntry, SplitStatistics};

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
    value
}

/// Columns of the table of records: name, type of schema.org, meaning.
pub(crate) const COLUMNS: [[&str; 3]; 11] = [
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

/// A line of the table of records, its values in the order of [`COLUMNS`].
pub(crate) fn table_row(
    entry: &IndexEntry,
    record: &Record,
    grids: &Grids,
    statistics: &SplitStatistics,
) -> [String; COLUMNS.len()] {
    let [lon, lat] = record.center_lon_lat;
    [
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
    ]
}

/// Lines of the table below its header, as CSV.
pub(crate) fn table_csv(rows: impl IntoIterator<Item = [String; COLUMNS.len()]>) -> Vec<u8> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    csv.write_record(COLUMNS.map(|[name, ..]| name)).expect("writing to memory cannot fail");
    for row in rows {
        csv.write_record(row).expect("writing to memory cannot fail");
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
    Ok(table_csv(rows.collect::<Result<Vec<_>, ReadError>>()?))
}
