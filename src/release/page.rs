//! `index.html`: all records on a map, and what each holds, in one file that needs no network.
//!
//! Arrays are stored as bytes, in steps that grow until the file is small enough: a page is to be looked at, the
//! shards are the data.

use std::collections::HashMap;
use std::io::Write;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use flate2::Compression;
use flate2::write::DeflateEncoder;
use rayon::prelude::*;
use serde::Serialize;
use serde_json::json;

use crate::config::Split;
use crate::dataset::{
    Dataset, Grids, ReadError, Record, croissant, hole_share, statistics_of, unsure_share,
};
use crate::grid::TileId;
use crate::manifest::{DatasetManifest, MASK_BUILDING, MASK_REACHED, Release};
use crate::progress::Progress;
use crate::reliability::{HOLE_THRESHOLD, HoleModel};
use crate::store::sha256_bytes;
use crate::units::Dbm;

/// The file.
pub(super) const FILE: &str = "index.html";
const TEMPLATE: &str = include_str!("page.html");
/// Most bytes of the file; browsers and reviewers open it at once.
const MAX_BYTES: usize = 4_000_000;
/// Cells along a side of a record's picture on the map.
const THUMBNAIL: usize = 16;
/// The lowest level that is told apart, in dBm.
const LOWEST_DBM: f64 = -140.0;
/// A byte of errors and of chances where there is nothing to tell.
const NOTHING: u8 = 255;
/// The first byte of levels, behind "building" and "no path".
const FIRST_LEVEL: f64 = 2.0;

/// How finely arrays are stored.
#[derive(Debug, Clone, Copy, Serialize)]
struct Detail {
    height_step_m: f64,
    level_low_dbm: f64,
    level_step_db: f64,
    error_step_db: f64,
    hole_step: f64,
}

impl Detail {
    /// From fine to coarse.
    const ALL: [Self; 4] = [
        Self::of(1.0, 1.0, 0.25, 0.05),
        Self::of(2.0, 2.0, 0.5, 0.1),
        Self::of(2.0, 3.0, 1.0, 0.25),
        Self::of(4.0, 5.0, 2.0, 0.5),
    ];

    const fn of(
        height_step_m: f64,
        level_step_db: f64,
        error_step_db: f64,
        hole_step: f64,
    ) -> Self {
        Self { height_step_m, level_low_dbm: LOWEST_DBM, level_step_db, error_step_db, hole_step }
    }
}

/// What the page tells of a record.
#[derive(Debug, Clone, Serialize)]
struct PageRecord {
    id: TileId,
    split: Split,
    center_m: [f64; 2],
    center_lon_lat: [f64; 2],
    base_station_m: [f64; 3],
    hole_share: f64,
    reliability: Option<f64>,
    built: f64,
    max_height_m: f64,
    height_sources: HashMap<&'static str, f64>,
    shard: String,
    frame: u32,
    thumbnail: String,
    planes: Option<String>,
}

/// The page of a release.
pub(super) fn page(
    dataset: &Dataset,
    manifest: &DatasetManifest,
    progress: &dyn Progress,
) -> Result<String, ReadError> {
    let records = &manifest.records;
    progress.begin("drawing records", Some(records.len() as u64));
    let drawn = records.par_iter().map(|entry| {
        let (record, grids) = dataset.record_with_grids(entry.id)?;
        let chances = chances(&record, &grids);
        let planes = Detail::ALL.map(|detail| planes(&grids, chances.as_deref(), detail));
        progress.advance(1);
        Ok((of_record(&record, &grids, &entry.shard, entry.frame), planes))
    });
    let drawn = drawn.collect::<Result<Vec<_>, ReadError>>()?;
    progress.end();
    let (mut shown, planes): (Vec<PageRecord>, Vec<[String; Detail::ALL.len()]>) =
        drawn.into_iter().unzip();
    let size = |detail: usize| planes.iter().map(|planes| planes[detail].len()).sum::<usize>();
    let empty = render(manifest, Detail::ALL[0], &shown);
    let room = MAX_BYTES.saturating_sub(empty.len());
    let fitting = (0..Detail::ALL.len()).find(|&detail| size(detail) <= room);
    let detail = fitting.unwrap_or(Detail::ALL.len() - 1);
    let ids: Vec<TileId> = records.iter().map(|entry| entry.id).collect();
    for at in within(&ids, room, |at| planes[at][detail].len()) {
        shown[at].planes = Some(planes[at][detail].clone());
    }
    Ok(render(manifest, Detail::ALL[detail], &shown))
}

/// Records of which there is room for the arrays, in the order of a hash of their names, so that all districts
/// have some.
fn within(ids: &[TileId], room: usize, size: impl Fn(usize) -> usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..ids.len()).collect();
    order.sort_by_cached_key(|&at| sha256_bytes(format!("page {}", ids[at]).as_bytes()).sha256);
    let mut left = room;
    let fits = |at: &usize| left.checked_sub(size(*at)).map(|rest| left = rest).is_some();
    order.into_iter().take_while(fits).collect()
}

fn render(manifest: &DatasetManifest, detail: Detail, records: &[PageRecord]) -> String {
    let has_errors = records.iter().any(|record| record.reliability.is_some());
    let planes: &[&str] =
        if has_errors { &["heights", "levels", "errors", "holes"] } else { &["heights", "levels"] };
    let mut steps = json!(detail);
    steps["cells"] = json!(manifest.cells);
    steps["planes"] = json!(planes);
    let (name, version) = match &manifest.release {
        Some(Release { name, version, .. }) => (name.clone(), version.clone()),
        None => (croissant::default_name(manifest), String::new()),
    };
    let data = json!({
        "name": name,
        "version": version,
        "description": "Building heights from OpenStreetMap and ray-traced RSRP, for finding coverage holes.",
        "licence": manifest.licence,
        "attribution": manifest.attribution,
        "epsg": manifest.epsg,
        "cells": manifest.cells,
        "cell_m": manifest.cell_m,
        "hole_threshold_dbm": HOLE_THRESHOLD,
        "floor_dbm": manifest.config.rsrp.floor_dbm,
        "flight_height_m": manifest.config.buildings.flight_height_m,
        "detail": steps,
        "thumbnail_cells": THUMBNAIL,
        "records": records,
    });
    // Within a script element only `</` and `<!--` have a meaning to HTML.
    let data = data.to_string().replace('<', "\\u003c");
    // Data last: what they say must not be taken for a placeholder.
    TEMPLATE.replace("{{title}}", &escaped(&croissant::title(manifest))).replace("{{data}}", &data)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

fn of_record(record: &Record, grids: &Grids, shard: &str, frame: u32) -> PageRecord {
    let statistics = statistics_of(record, grids);
    let built = record.provenance.built_cells;
    let total = built.total().max(1) as f64;
    let sources = [("height", built.height), ("levels", built.levels), ("default", built.default)];
    let [x, y, z] = record.base_station.position_m;
    let share = grids.height_m.iter().filter(|height| **height > 0.0).count();
    PageRecord {
        id: record.id,
        split: record.split,
        center_m: record.center_m,
        center_lon_lat: record.center_lon_lat,
        base_station_m: [x, y, z],
        hole_share: rounded(hole_share(&statistics)),
        reliability: statistics.reliability.as_ref().map(|it| rounded(1.0 - unsure_share(it))),
        built: rounded(share as f64 / grids.height_m.len() as f64),
        max_height_m: grids.height_m.iter().copied().fold(0.0, f32::max).into(),
        height_sources: sources.map(|(name, cells)| (name, rounded(cells as f64 / total))).into(),
        shard: shard.to_owned(),
        frame,
        thumbnail: thumbnail(grids),
        planes: None,
    }
}

fn rounded(share: f64) -> f64 {
    (share * 1e4).round() / 1e4
}

/// The chance that a cell is a hole, by row and column; `None` in buildings.
fn chances(record: &Record, grids: &Grids) -> Option<Vec<Option<f64>>> {
    let errors = &grids.errors.as_ref()?.std_error_db;
    let model = HoleModel::new(record.repeats?);
    let cells = grids.mask.iter().zip(&grids.rsrp_dbm).zip(errors);
    let chance = |((&kind, &level), &error): ((&u8, &f32), &f32)| match kind {
        MASK_BUILDING => None,
        MASK_REACHED => Some(model.probability(Dbm(level.into()), error.into(), HOLE_THRESHOLD)),
        _ => Some(1.0),
    };
    Some(cells.map(chance).collect())
}

/// How much of each part of the record is built, in 15ths, two parts a byte.
fn thumbnail(grids: &Grids) -> String {
    let cells = grids.height_m.nrows();
    let part = |index: usize| index * cells / THUMBNAIL..((index + 1) * cells).div_ceil(THUMBNAIL);
    let shade = |at: usize| {
        let inside = ndarray::s![part(at / THUMBNAIL), part(at % THUMBNAIL)];
        let heights = grids.height_m.slice(inside);
        let built = heights.iter().filter(|height| **height > 0.0).count();
        (15 * built).div_ceil(heights.len().max(1)) as u8
    };
    let shades: Vec<u8> = (0..THUMBNAIL * THUMBNAIL).map(shade).collect();
    BASE64_STANDARD.encode(shades.chunks(2).map(|two| two[0] << 4 | two[1]).collect::<Vec<u8>>())
}

/// A value in steps, of which the highest stands for all beyond.
fn in_steps(value: f64, step: f64, highest: u8) -> u8 {
    (value / step).round().clamp(0.0, highest.into()) as u8
}

/// The arrays, one after the other, deflated.
fn planes(grids: &Grids, chances: Option<&[Option<f64>]>, detail: Detail) -> String {
    let heights = grids.height_m.iter();
    let mut bytes: Vec<u8> =
        heights.map(|&height| in_steps(height.into(), detail.height_step_m, u8::MAX)).collect();
    bytes.extend(grids.mask.iter().zip(&grids.rsrp_dbm).map(|(&kind, &level)| match kind {
        MASK_BUILDING => 0,
        MASK_REACHED => {
            let above = f64::from(level) - detail.level_low_dbm;
            in_steps(above + FIRST_LEVEL * detail.level_step_db, detail.level_step_db, u8::MAX)
                .max(FIRST_LEVEL as u8)
        }
        _ => 1,
    }));
    if let (Some(errors), Some(chances)) = (&grids.errors, chances) {
        let errors = grids.mask.iter().zip(&errors.std_error_db);
        bytes.extend(errors.map(|(&kind, &error)| match kind {
            MASK_REACHED => in_steps(error.into(), detail.error_step_db, NOTHING - 1),
            _ => NOTHING,
        }));
        bytes.extend(chances.iter().map(|chance| {
            chance.map_or(NOTHING, |chance| in_steps(chance, detail.hole_step, NOTHING - 1))
        }));
    }
    let mut encoder = DeflateEncoder::new(Vec::new(), Compression::best());
    let packed = encoder.write_all(&bytes).and_then(|()| encoder.finish());
    BASE64_STANDARD.encode(packed.expect("writing to memory cannot fail"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_room_is_left_out_wherever_it_lies() {
        let id = |column: i64| format!("utm10n_e{}_n4000256", 500_224 + 512 * column);
        let ids: Vec<TileId> = (0..40).map(|column| id(column).parse().expect("an id")).collect();
        let kept = within(&ids, 1_000, |_| 100);
        assert_eq!(kept.len(), 10);
        assert!(kept.iter().any(|at| *at < 20) && kept.iter().any(|at| *at >= 20), "{kept:?}");
        assert_eq!(within(&ids, 4_000, |_| 100).len(), 40);
        assert!(within(&ids, 99, |_| 100).is_empty());
    }

    #[test]
    fn values_are_the_nearest_step() {
        assert_eq!([0.0, 0.9, 1.1, 600.0].map(|value| in_steps(value, 2.0, 255)), [0, 0, 1, 255]);
        assert_eq!(in_steps(-3.0, 2.0, 255), 0);
    }

    #[test]
    fn the_template_takes_what_is_filled_in() {
        assert!(TEMPLATE.contains("{{title}}"));
        assert_eq!(TEMPLATE.matches("{{data}}").count(), 1);
        assert_eq!(escaped("a < b & c"), "a &lt; b &amp; c");
    }
}
