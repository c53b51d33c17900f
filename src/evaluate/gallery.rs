//! The gallery of a report: a few maps with every method's flights, as the page draws them.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde::Serialize;

use super::map::{MapResult, Scene};
use super::methods::Flying;
use super::track::Track;
use crate::config::{Method, Split};
use crate::grid::TileId;
use crate::rl::World;

/// A map, its grids packed to a byte a cell, row by row from the north.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct GalleryMap {
    id: TileId,
    split: Split,
    lon: f64,
    lat: f64,
    cells: usize,
    cell_m: f64,
    hole_share: f64,
    /// Metres, rounded up; 255 for more.
    height_m: String,
    /// Half decibels above -160 dBm.
    rsrp: String,
    /// 0 covered, 1 building, 2 coverage hole.
    kind: String,
    /// Row and column.
    base_station: [f64; 2],
    starts: Vec<GalleryStart>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
struct GalleryStart {
    flights: Vec<GalleryFlight>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
struct GalleryFlight {
    method: Method,
    path: Vec<[i32; 2]>,
    predicted: Vec<[f64; 2]>,
    rsrp_dbm: Vec<f32>,
    found: bool,
}

/// Maps for a gallery of a size: evenly spaced in the order of their share of holes, so that easy
/// and hard ones are shown. Positions in the list of maps, in that order.
pub(super) fn choose(maps: &[MapResult], size: u32) -> Vec<usize> {
    let mut order: Vec<usize> =
        (0..maps.len()).filter(|&map| maps[map].outdoor_cells > 0).collect();
    order.sort_by(|&a, &b| maps[a].hole_share().total_cmp(&maps[b].hole_share()).then(a.cmp(&b)));
    let size = (size as usize).min(order.len());
    let spread =
        |at: usize| if size > 1 { at * (order.len() - 1) / (size - 1) } else { order.len() / 2 };
    (0..size).map(|at| order[spread(at)]).collect()
}

/// Flies the first flights over a map once more.
pub(super) fn show(
    scene: &Scene,
    split: Split,
    result: &MapResult,
    flying: Flying<'_>,
) -> GalleryMap {
    let config = flying.config;
    let truth = &scene.truth;
    let shown = config.evaluate.gallery_starts as usize;
    let methods = config.evaluate.methods.iter();
    let tracks: Vec<(Method, Vec<Track>)> =
        methods.map(|&method| (method, scene.tracks(method, flying, shown))).collect();
    let starts = (0..shown)
        .map(|start| {
            let with_start =
                tracks.iter().filter_map(|(method, of)| Some((*method, of.get(start)?)));
            GalleryStart {
                flights: with_start.map(|(method, of)| flight(truth, method, of)).collect(),
            }
        })
        .filter(|start| !start.flights.is_empty());
    let [row, column, _] = truth.base_station();
    let [lon, lat] = truth.id().lon_lat();
    let bytes = |of: &dyn Fn(usize) -> u8| {
        let all: Vec<u8> = (0..truth.cells() * truth.cells()).map(of).collect();
        BASE64_STANDARD.encode(all)
    };
    let heights = truth.heights();
    GalleryMap {
        id: truth.id(),
        split,
        lon: decimals(lon, 6),
        lat: decimals(lat, 6),
        cells: truth.cells(),
        cell_m: truth.cell_m(),
        hole_share: result.hole_share(),
        // A cast of a float saturates.
        height_m: bytes(&|at| heights[at].ceil() as u8),
        rsrp: bytes(&|at| ((truth.rsrp_dbm(truth.cell(at)) + 160.0) * 2.0).round() as u8),
        kind: bytes(&|at| match truth.cell(at) {
            cell if truth.is_occupied(cell) => 1,
            cell if truth.is_hole(cell) => 2,
            _ => 0,
        }),
        base_station: [decimals(row, 2), decimals(column, 2)],
        starts: starts.collect(),
    }
}

fn flight(truth: &World, method: Method, track: &Track) -> GalleryFlight {
    let predicted = track.predicted.iter().map(|point| point.map(|at| decimals(at, 2)));
    GalleryFlight {
        method,
        path: track.path.iter().map(|cell| [cell.row, cell.column]).collect(),
        predicted: predicted.collect(),
        rsrp_dbm: track.rsrp_dbm.iter().map(|&level| decimals(level.into(), 1) as f32).collect(),
        found: truth.is_hole(track.cell_after(u32::MAX)),
    }
}

fn decimals(value: f64, places: i32) -> f64 {
    let scale = 10_f64.powi(places);
    (value * scale).round() / scale
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_are_chosen_from_the_easiest_to_the_hardest() {
        let map = |hole_cells| MapResult { outdoor_cells: 100, hole_cells, ..MapResult::default() };
        let maps: Vec<MapResult> = [50, 10, 40, 20, 30].map(map).to_vec();
        assert_eq!(choose(&maps, 3), [1, 4, 0]);
        assert_eq!(choose(&maps, 9), [1, 3, 4, 2, 0]);
        assert_eq!(choose(&maps, 1), [4]);
        assert_eq!(choose(&[], 3), [0_usize; 0]);
    }
}
