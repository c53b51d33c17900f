//! Which levels to expect, by what stands between a cell and the base station.
//!
//! A table over the classes of [`Shadows`]: mean and standard deviation of the level, the chance of a hole, the
//! chance of a level too low to be told. Classes that few cells were in lean on a line over the logarithm of the distance,
//! which leans on the one of all classes.

use std::sync::Arc;

use rayon::prelude::*;

use super::candidates::{Candidates, StationPlaces};
use super::normal::{NormalTable, quantile};
use super::shadows::{CLASSES, DISTANCES, OBSTACLES, Shadows};
use crate::rl::cell::Cell;
use crate::rl::world::World;

/// Levels further below the threshold than this are not told apart, in dB.
const LOWEST_DB: f32 = 40.0;
/// Cells that a class must have to count as much as what it leans on.
const LEAN: f64 = 200.0;
/// The same of a line over the distance.
const LINE_LEAN: f64 = 30.0;
/// Least standard deviation, in dB.
const LEAST_DEVIATION_DB: f64 = 3.0;
/// Distances up to which residuals are correlated, in cells.
const NEAR: usize = 16;
/// Residuals are never taken for the same.
const MOST_SIMILAR: f64 = 0.9;
/// Middles of the classes of distances, in metres.
const MIDDLE_M: [f64; DISTANCES] =
    [5.0, 12.0, 22.0, 36.0, 54.0, 77.0, 105.0, 137.5, 175.0, 217.5, 265.0, 320.0, 385.0, 460.0];

/// A model of propagation that was fitted on maps whose base stations are known.
#[derive(Debug, Clone)]
pub struct Propagation {
    placement: StationPlaces,
    /// Of each class, in dBm, with the levels too low to be told at the lowest that is.
    pub(super) mean_dbm: Vec<f32>,
    pub(super) deviation_db: Vec<f32>,
    /// The chance of a hole, as standard deviations of a normal distribution.
    pub(super) hole: Vec<f32>,
    /// Logarithm of the chance of a level too low to be told.
    pub(super) log_lowest: Vec<f64>,
    /// Correlation of the residuals of two cells by their distance in cells.
    similarity: Vec<f32>,
    pub(super) normal: NormalTable,
}

/// Sums over cells of a class.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    cells: f64,
    level: f64,
    squared: f64,
    holes: f64,
    lowest: f64,
}

impl Sums {
    fn add(&mut self, more: &Self) {
        self.cells += more.cells;
        self.level += more.level;
        self.squared += more.squared;
        self.holes += more.holes;
        self.lowest += more.lowest;
    }

    /// Sum of the squared residuals from a mean.
    fn residual(&self, mean: f64) -> f64 {
        self.squared - 2.0 * mean * self.level + mean * mean * self.cells
    }
}

/// A map with its base station's cell and what the outdoor cells hold: index, class, level.
struct Seen<'a> {
    world: &'a World,
    station: Cell,
    cells: Vec<(usize, usize, f32)>,
}

impl Propagation {
    /// Of maps whose base stations stand on them; `None` if there is none. The same maps give the same model
    /// at any number of threads.
    #[must_use]
    pub fn fit(maps: &[Arc<World>]) -> Option<Self> {
        let seen: Vec<Seen<'_>> = maps.par_iter().filter_map(see).collect();
        let placement = StationPlaces::of(seen.iter().map(|map| (map.world, map.station)))?;
        let mut classes = vec![Sums::default(); CLASSES];
        for map in &seen {
            for &(index, class, level) in &map.cells {
                let level = f64::from(level);
                classes[class].add(&Sums {
                    cells: 1.0,
                    level,
                    squared: level * level,
                    holes: f64::from(u8::from(map.world.is_hole(map.world.cell(index)))),
                    lowest: f64::from(u8::from(level <= f64::from(lowest_dbm(map.world)))),
                });
            }
        }
        let mut model = Self {
            placement,
            mean_dbm: vec![0.0; CLASSES],
            deviation_db: vec![0.0; CLASSES],
            hole: vec![0.0; CLASSES],
            log_lowest: vec![0.0; CLASSES],
            similarity: Vec::new(),
            normal: NormalTable::new(),
        };
        let of_all = line(&classes, [-60.0, -25.0]);
        for obstacle in 0..OBSTACLES {
            let of_obstacle: Vec<Sums> =
                classes.iter().skip(obstacle).step_by(OBSTACLES).copied().collect();
            model.set(obstacle, &of_obstacle, line(&of_obstacle, of_all));
        }
        model.similarity = model.similarity_of(&seen);
        Some(model)
    }

    /// The classes of an obstacle, by distance.
    fn set(&mut self, obstacle: usize, classes: &[Sums], [intercept, slope]: [f64; 2]) {
        let mut all = Sums::default();
        for class in classes {
            all.add(class);
        }
        let by_line = |at: usize| intercept + slope * libm::log10(MIDDLE_M[at]);
        let mean =
            |at: usize| (classes[at].level + LEAN * by_line(at)) / (classes[at].cells + LEAN);
        let residuals: f64 = (0..classes.len()).map(|at| classes[at].residual(mean(at))).sum();
        // As far off as a level is that nothing is known of, until there are cells.
        let variance = (residuals + LINE_LEAN * 150.0) / (all.cells + LINE_LEAN);
        let [holes, lowest] =
            [(all.holes + 2.0) / (all.cells + 8.0), (all.lowest + 0.5) / (all.cells + 10.0)];
        for (at, sums) in classes.iter().enumerate() {
            let class = at * OBSTACLES + obstacle;
            let share = |count: f64, of_all: f64| (count + LEAN * of_all) / (sums.cells + LEAN);
            let variance = share(sums.residual(mean(at)), variance);
            self.mean_dbm[class] = mean(at) as f32;
            self.deviation_db[class] = variance.sqrt().max(LEAST_DEVIATION_DB) as f32;
            self.hole[class] = quantile(share(sums.holes, holes).clamp(1e-4, 1.0 - 1e-4)) as f32;
            self.log_lowest[class] = libm::log(share(sums.lowest, lowest) + 1e-3);
        }
    }

    /// Correlation of residuals along rows and columns, by distance.
    fn similarity_of(&self, seen: &[Seen<'_>]) -> Vec<f32> {
        let of_maps: Vec<[[f64; 2]; NEAR]> =
            seen.par_iter().map(|map| self.products(map)).collect();
        let similarity = |by: usize| {
            let [products, squares] =
                [0, 1].map(|which| of_maps.iter().map(|map| map[by][which]).sum::<f64>());
            (products / squares.max(1e-9)).clamp(0.0, MOST_SIMILAR) as f32
        };
        [MOST_SIMILAR as f32].into_iter().chain((1..NEAR).map(similarity)).collect()
    }

    /// Sums of products and of mean squares of residuals so many cells apart.
    fn products(&self, map: &Seen<'_>) -> [[f64; 2]; NEAR] {
        let n = map.world.cells();
        let mut residuals = vec![None; n * n];
        for &(index, class, level) in &map.cells {
            residuals[index] = Some(self.residual(class, level));
        }
        let mut sums = [[0.0; 2]; NEAR];
        for (index, one) in residuals.iter().enumerate() {
            let Some(one) = one else { continue };
            for (by, sum) in sums.iter_mut().enumerate().skip(1) {
                let right = (index % n + by < n).then(|| residuals[index + by]).flatten();
                let below = residuals.get(index + by * n).copied().flatten();
                for other in right.into_iter().chain(below) {
                    sum[0] += f64::from(one * other);
                    sum[1] += f64::from(one * one + other * other) / 2.0;
                }
            }
        }
        sums
    }

    /// How far a level is from what its class has, in standard deviations.
    pub(super) fn residual(&self, class: usize, level_dbm: f32) -> f32 {
        (level_dbm - self.mean_dbm[class]) / self.deviation_db[class]
    }

    /// Correlation of the residuals of two cells.
    pub(super) fn similarity(&self, by: Cell) -> f32 {
        let distance = libm::round(libm::sqrt(f64::from(by.squared_length()))) as usize;
        self.similarity.get(distance).copied().unwrap_or_default()
    }

    /// Where base stations may stand on a map, as on those that the model was fitted on.
    #[must_use]
    pub fn candidates(&self, world: &World) -> Candidates {
        Candidates::new(world, &self.placement)
    }
}

/// The lowest level that is told apart.
pub(super) fn lowest_dbm(world: &World) -> f32 {
    world.threshold_dbm() - LOWEST_DB
}

fn see(world: &Arc<World>) -> Option<Seen<'_>> {
    let [row, column, up_m] = world.base_station();
    let station = Cell::at([row, column]);
    if !world.contains(station) {
        return None;
    }
    let shadows = Shadows::new(world, station, up_m as f32);
    let outdoors = world.free_cells().into_iter().filter(|&cell| world.is_outdoors(cell));
    let cells = outdoors.map(|cell| {
        let index = world.index(cell);
        (index, shadows.class(index), world.rsrp_dbm(cell).max(lowest_dbm(world)))
    });
    Some(Seen { world, station, cells: cells.collect() })
}

/// Intercept and slope of the level over the logarithm of the distance, of classes by distance (repeated, for those
/// of all obstacles); drawn to others by the weight of some cells.
fn line(classes: &[Sums], [intercept, slope]: [f64; 2]) -> [f64; 2] {
    let per_distance = classes.len() / DISTANCES;
    let (mut n, mut x, mut xx) = (LINE_LEAN, 0.0, LINE_LEAN);
    let (mut y, mut xy) = (LINE_LEAN * intercept, LINE_LEAN * slope);
    for (at, sums) in classes.iter().enumerate() {
        let distance = libm::log10(MIDDLE_M[at / per_distance]);
        n += sums.cells;
        x += distance * sums.cells;
        xx += distance * distance * sums.cells;
        y += sums.level;
        xy += distance * sums.level;
    }
    let determinant = n * xx - x * x;
    [(xx * y - x * xy) / determinant, (n * xy - x * y) / determinant]
}
