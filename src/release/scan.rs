//! One pass over all records: what the card and the table tell of them.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::walls::WallCounts;
use crate::config::Split;
use crate::dataset::{Dataset, ReadError, hole_share, statistics_of, table_csv, table_row};
use crate::manifest::{IndexEntry, Radio};
use crate::progress::Progress;

/// What was found in the records.
#[derive(Debug, Default)]
pub(super) struct Scan {
    /// `records.csv`.
    pub(super) table: Vec<u8>,
    /// Coverage holes as a share of outdoor cells, of every record.
    pub(super) hole_shares: BTreeMap<Split, Vec<f64>>,
    /// How the maps were computed, in words, with the number of records.
    pub(super) radio: BTreeMap<String, u64>,
    /// Transmit powers per resource element, in dBm: lowest, highest.
    pub(super) power_dbm: [f64; 2],
    /// Coverage holes by distance to the nearest wall.
    pub(super) walls: WallCounts,
}

struct Scanned {
    row: Vec<String>,
    split: Split,
    hole_share: f64,
    radio: String,
    power_dbm: f64,
    walls: WallCounts,
}

/// Reads all records; their values are checked on the way.
pub(super) fn scan(dataset: &Dataset, progress: &dyn Progress) -> Result<Scan, ReadError> {
    let records = &dataset.manifest().records;
    progress.begin("reading records", Some(records.len() as u64));
    let scanned = records.par_iter().map(|entry| {
        let scanned = scan_one(dataset, entry);
        progress.advance(1);
        scanned
    });
    let scanned = scanned.collect::<Result<Vec<_>, _>>()?;
    progress.end();
    let mut scan = Scan { power_dbm: [f64::INFINITY, f64::NEG_INFINITY], ..Scan::default() };
    for one in &scanned {
        scan.hole_shares.entry(one.split).or_default().push(one.hole_share);
        *scan.radio.entry(one.radio.clone()).or_default() += 1;
        let [lowest, highest] = scan.power_dbm;
        scan.power_dbm = [lowest.min(one.power_dbm), highest.max(one.power_dbm)];
        scan.walls.add(&one.walls);
    }
    let rows = scanned.into_iter().map(|one| one.row);
    scan.table = table_csv(dataset.manifest(), rows);
    Ok(scan)
}

fn scan_one(dataset: &Dataset, entry: &IndexEntry) -> Result<Scanned, ReadError> {
    let (record, grids) = dataset.record_with_grids(entry.id)?;
    let statistics = statistics_of(&record, &grids);
    Ok(Scanned {
        row: table_row(entry, &record, &grids, &statistics),
        split: record.split,
        hole_share: hole_share(&statistics),
        radio: in_words(&record.radio),
        power_dbm: record.base_station.power_per_re_dbm.0,
        walls: WallCounts::of(&record, &grids),
    })
}

fn in_words(radio: &Radio) -> String {
    let Radio { frequency_hz, rx_height_m, sionna_version, max_depth, .. } = radio;
    let with = |on: bool| if on { "with" } else { "without" };
    format!(
        "{} GHz, {sionna_version}, receivers at {rx_height_m} m, at most {max_depth} interactions \
         a path, {} diffraction, {} refraction",
        frequency_hz / 1e9,
        with(radio.diffraction),
        with(radio.refraction),
    )
}
