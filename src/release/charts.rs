//! The pictures of a card: two histograms and ten records.

use std::collections::BTreeMap;

use super::scan::Scan;
use crate::config::Split;
use crate::dataset::{Dataset, PanelStyle, ReadError, panels_png};
use crate::evaluate::{LineChart, Point, Series, svg_to_png};
use crate::grid::TileId;
use crate::manifest::DatasetManifest;
use crate::store::sha256_bytes;

/// Pictures of records on a card.
pub(super) const RECORDS: usize = 10;
/// Where the pictures lie.
pub(super) const FOLDER: &str = "card";
/// Bins of the shares of coverage holes.
const BINS: usize = 20;

/// The records that are shown: of each split in turn, in the order of a hash of their names.
pub(super) fn chosen(dataset: &Dataset) -> Vec<(TileId, Split)> {
    let mut by_split: BTreeMap<Split, Vec<TileId>> = BTreeMap::new();
    for (id, split) in dataset.ids() {
        by_split.entry(split).or_default().push(id);
    }
    for ids in by_split.values_mut() {
        ids.sort_by_cached_key(|id| sha256_bytes(format!("card {id}").as_bytes()).sha256);
    }
    let longest = by_split.values().map(Vec::len).max().unwrap_or(0);
    let turns = (0..longest).flat_map(|turn| {
        by_split.iter().filter_map(move |(split, ids)| Some((*ids.get(turn)?, *split)))
    });
    let mut chosen: Vec<_> = turns.take(RECORDS).collect();
    chosen.sort_by_key(|(id, split)| (*split, *id));
    chosen
}

/// The picture of a record.
pub(super) fn of_record(dataset: &Dataset, id: TileId) -> Result<Vec<u8>, ReadError> {
    let (record, grids) = dataset.record_with_grids(id)?;
    Ok(panels_png(&record, &grids, PanelStyle::default()))
}

/// Histograms of RSRP and of the share of coverage holes, by file name.
pub(super) fn histograms(manifest: &DatasetManifest, scan: &Scan) -> [(String, Vec<u8>); 2] {
    [("rsrp", rsrp(manifest)), ("hole-share", hole_shares(scan))]
        .map(|(name, chart)| (format!("{FOLDER}/{name}.png"), svg_to_png(&chart.to_svg(), 1.5)))
}

fn rsrp(manifest: &DatasetManifest) -> LineChart {
    let splits = manifest.statistics.iter();
    let lines = splits.map(|(split, statistics)| {
        let histogram = &statistics.rsrp;
        let total = histogram.counts.iter().sum::<u64>().max(1) as f64;
        let step = f64::from(histogram.step_db);
        let center = |bin: usize| f64::from(histogram.first_dbm) + (bin as f64 + 0.5) * step;
        let counts = histogram.counts.iter().enumerate();
        let points = counts.map(|(bin, &count)| point(center(bin), 100.0 * count as f64 / total));
        series(*split, points.collect())
    });
    chart(
        "RSRP of reached outdoor cells",
        "RSRP in dBm per resource element",
        "% of the reached cells in each 5 dB",
        lines.collect(),
    )
}

fn hole_shares(scan: &Scan) -> LineChart {
    let lines = scan.hole_shares.iter().map(|(split, shares)| {
        let mut counts = [0_u64; BINS];
        for share in shares {
            counts[((share * BINS as f64) as usize).min(BINS - 1)] += 1;
        }
        let width = 100.0 / BINS as f64;
        let points = counts.iter().enumerate().map(|(bin, &count)| {
            point((bin as f64 + 0.5) * width, 100.0 * count as f64 / shares.len() as f64)
        });
        series(*split, points.collect())
    });
    chart(
        "Share of coverage holes in the outdoor cells of a record",
        "coverage holes in % of the outdoor cells",
        "% of the records in each 5 %",
        lines.collect(),
    )
}

fn point(x: f64, mean: f64) -> Point {
    Point { x, mean, low: mean, high: mean }
}

fn series(split: Split, points: Vec<Point>) -> Series {
    Series { label: split.to_string(), points, family: split as usize, variant: 0 }
}

fn chart(title: &str, x_label: &str, y_label: &str, series: Vec<Series>) -> LineChart {
    LineChart {
        title: title.to_owned(),
        x_label: x_label.to_owned(),
        y_label: y_label.to_owned(),
        y_max: None,
        log_x: false,
        steps: true,
        series,
    }
}
