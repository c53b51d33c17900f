//! Places that a base station may have on a map, with the shadows that each would cast.

use super::shadows::Shadows;
use crate::rl::cell::Cell;
use crate::rl::world::World;

/// Side of the squares that have a candidate on a roof and one on the ground, in metres.
const SQUARE_M: f64 = 32.0;
/// A kind of place that fewer base stations have is not looked at.
const LEAST_SHARE: f64 = 0.02;

/// Where base stations stand, as learned from maps that tell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StationPlaces {
    /// Share of those over occupied cells.
    pub(super) on_roofs: f64,
    /// Median height of the antenna over the roof below it, in metres.
    pub(super) over_roof_m: f32,
    /// Median height of the antenna over open ground, in metres.
    pub(super) over_ground_m: f32,
}

impl StationPlaces {
    /// Of base stations with their cells, on maps that have them; `None` if there are none.
    pub(super) fn of<'a>(stations: impl IntoIterator<Item = (&'a World, Cell)>) -> Option<Self> {
        let (mut roofs, mut ground) = (Vec::new(), Vec::new());
        for (world, cell) in stations {
            let up = world.base_station()[2] as f32;
            if world.is_occupied(cell) {
                roofs.push(up - world.heights()[world.index(cell)]);
            } else {
                ground.push(up);
            }
        }
        let all = roofs.len() + ground.len();
        (all > 0).then(|| Self {
            on_roofs: roofs.len() as f64 / all as f64,
            over_roof_m: median(roofs),
            over_ground_m: median(ground),
        })
    }

    /// On roofs and not, the more common kind first, with their shares.
    fn kinds(&self) -> [(bool, f64); 2] {
        let [roofs, ground] = [(true, self.on_roofs), (false, 1.0 - self.on_roofs)];
        if self.on_roofs >= 0.5 { [roofs, ground] } else { [ground, roofs] }
    }
}

/// 0 of none.
fn median(mut values: Vec<f32>) -> f32 {
    values.sort_by(f32::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

/// The candidates of a map.
#[derive(Debug, Clone)]
pub struct Candidates {
    cells: Vec<Cell>,
    /// The class of each cell of the map and, within it, as seen from each candidate.
    classes: Vec<u16>,
    /// Logarithms of the chances that they have before anything was measured.
    pub(super) log_prior: Vec<f64>,
}

impl Candidates {
    /// In each square of 32 m the roof and the ground nearest to its middle, as far as base stations stand
    /// there; each stands for the cells of its kind in the square.
    pub(super) fn new(world: &World, placement: &StationPlaces) -> Self {
        let side = ((SQUARE_M / world.cell_m()).round() as usize).max(1);
        let mut found: Vec<(Cell, f32, f64)> = Vec::new();
        for (on_roof, share) in placement.kinds() {
            // A map without the common kind has the other one.
            if share < LEAST_SHARE && !found.is_empty() {
                continue;
            }
            let before = found.len();
            for row in (0..world.cells()).step_by(side) {
                for column in (0..world.cells()).step_by(side) {
                    let of_kind = square(world, (row, column), side, on_roof);
                    let middle = Cell::new((row + side / 2) as i32, (column + side / 2) as i32);
                    let nearest =
                        of_kind.iter().min_by_key(|&&cell| (cell - middle).squared_length());
                    let Some(&at) = nearest else { continue };
                    let up_m = if on_roof {
                        world.heights()[world.index(at)] + placement.over_roof_m
                    } else {
                        placement.over_ground_m
                    };
                    found.push((at, up_m, of_kind.len() as f64));
                }
            }
            let cells: f64 = found[before..].iter().map(|candidate| candidate.2).sum();
            for candidate in &mut found[before..] {
                candidate.2 *= share.max(LEAST_SHARE) / cells;
            }
        }
        let all: f64 = found.iter().map(|candidate| candidate.2).sum();
        Self {
            cells: found.iter().map(|candidate| candidate.0).collect(),
            classes: classes(world, &found),
            log_prior: found.iter().map(|candidate| libm::log(candidate.2 / all)).collect(),
        }
    }

    /// The classes of a cell of the map, by its index, as seen from each candidate.
    pub(super) fn classes(&self, index: usize) -> &[u16] {
        let count = self.cells.len();
        &self.classes[index * count..][..count]
    }

    /// Where they stand.
    #[must_use]
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }
}

/// What the candidates see, cell by cell; a few of them at a time, so that what is written lies together.
fn classes(world: &World, found: &[(Cell, f32, f64)]) -> Vec<u16> {
    const TOGETHER: usize = 32;
    if found.is_empty() {
        return Vec::new();
    }
    let mut classes = vec![0; world.cells() * world.cells() * found.len()];
    for (chunk, candidates) in found.chunks(TOGETHER).enumerate() {
        let views = candidates.iter().map(|&(at, up_m, _)| Shadows::new(world, at, up_m));
        let views: Vec<Shadows> = views.collect();
        let rows = classes.chunks_exact_mut(found.len());
        for (index, row) in rows.enumerate() {
            let seen = views.iter().map(|view| view.class(index) as u16);
            row[chunk * TOGETHER..].iter_mut().zip(seen).for_each(|(to, class)| *to = class);
        }
    }
    classes
}

/// The cells of a square that are occupied, or free.
fn square(world: &World, (row, column): (usize, usize), side: usize, occupied: bool) -> Vec<Cell> {
    let end = |from: usize| (from + side).min(world.cells());
    let cells = (row..end(row)).flat_map(|row| {
        (column..end(column)).map(move |column| Cell::new(row as i32, column as i32))
    });
    cells.filter(|&cell| world.is_occupied(cell) == occupied).collect()
}
