//! Records for people and their tools: JSON with plain lists, a table of all records.

use ndarray::Array2;
use serde::Serialize;
use serde_json::{Value, json};

use super::read::{Dataset, ReadError};
use super::record::{Grids, Record};
use super::statistics::{hole_share, statistics_of};

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

/// A CSV table with a line for each record: what one would sort and filter by.
///
/// # Errors
/// When a record cannot be read.
pub fn records_csv(dataset: &Dataset) -> Result<Vec<u8>, ReadError> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    let header = [
        "id",
        "split",
        "lon",
        "lat",
        "reached",
        "unreached",
        "building",
        "hole_share",
        "max_height_m",
        "shard",
        "frame",
    ];
    csv.write_record(header).expect("writing to memory cannot fail");
    for entry in &dataset.manifest().records {
        let (record, grids) = dataset.record_with_grids(entry.id)?;
        let statistics = statistics_of(&record, &grids);
        let [lon, lat] = record.center_lon_lat;
        let row = [
            entry.id.to_string(),
            record.split.to_string(),
            format!("{lon:.7}"),
            format!("{lat:.7}"),
            statistics.cells.reached.to_string(),
            statistics.cells.unreached.to_string(),
            statistics.cells.building.to_string(),
            format!("{:.6}", hole_share(&statistics)),
            grids.height_m.iter().copied().fold(0.0, f32::max).to_string(),
            entry.shard.clone(),
            entry.frame.to_string(),
        ];
        csv.write_record(row).expect("writing to memory cannot fail");
    }
    Ok(csv.into_inner().expect("writing to memory cannot fail"))
}
