//! What trees are fitted on: moves from states on the maps of the train split, and whether they lead to holes.

use std::sync::Arc;

use rayon::prelude::*;

use super::columns::Columns;
use crate::rl::{Cell, Measurement, Random, Sight, World};

const FITTING: u64 = 5;
/// Starts on a map, of many maps fewer.
const STARTS: usize = 24;
/// Starts in all, about.
const STARTS_IN_ALL: usize = 10_000;
/// Moves of a state.
const MOVES: usize = 40;
/// Steps before a state, less than this many.
const STEPS: usize = 4;
/// Cells that a map must have to start from.
const LEAST_CELLS: usize = 50;

/// Rows with what came of them.
#[derive(Debug, Default)]
pub(super) struct Samples {
    /// Number of columns of a row.
    pub(super) columns: usize,
    /// `[rows, columns]`.
    pub(super) rows: Vec<f32>,
    /// 1 for moves to holes.
    pub(super) holes: Vec<f64>,
}

impl Samples {
    /// Of some maps; with `told` the base station's place is a part of each row.
    pub(super) fn draw(maps: &[Arc<World>], sight: &Sight, seed: u64, told: bool) -> Self {
        let starts = (STARTS_IN_ALL / maps.len().max(1)).clamp(1, STARTS);
        let of_maps: Vec<Self> =
            maps.par_iter().map(|world| on_map(world, sight, seed, told, starts)).collect();
        let mut all = Self::default();
        for of_map in of_maps {
            all.columns = all.columns.max(of_map.columns);
            all.rows.extend(of_map.rows);
            all.holes.extend(of_map.holes);
        }
        all
    }
}

/// From random cells that are no holes, after some random steps.
fn on_map(world: &World, sight: &Sight, seed: u64, told: bool, starts: usize) -> Samples {
    let mut random = Random::keyed(&[&[seed][..], &world.key(), &[FITTING]].concat());
    let cells: Vec<Cell> = world
        .free_cells()
        .into_iter()
        .filter(|&cell| world.is_outdoors(cell) && !world.is_hole(cell))
        .collect();
    let mut samples = Samples::default();
    if cells.len() < LEAST_CELLS {
        return samples;
    }
    let columns = Columns::new(world, told);
    let measured = |cell| Measurement { cell, rsrp_dbm: world.rsrp_dbm(cell) };
    for start in random.sample(&cells, starts) {
        let mut measurements = vec![measured(start)];
        for _ in 0..random.below(STEPS) {
            let moves = moves(world, sight, &measurements);
            let to = moves[random.below(moves.len())];
            if !world.is_hole(to) {
                measurements.push(measured(to));
            }
        }
        let moves = random.sample(&moves(world, sight, &measurements), MOVES);
        let before = samples.rows.len();
        columns.rows(world, &measurements, &moves, &mut samples.rows);
        samples.columns = (samples.rows.len() - before) / moves.len();
        samples.holes.extend(moves.iter().map(|&to| f64::from(u8::from(world.is_hole(to)))));
    }
    samples
}

/// Cells that a step may lead to, visited ones left out.
fn moves(world: &World, sight: &Sight, measurements: &[Measurement]) -> Vec<Cell> {
    let visited: Vec<Cell> = measurements.iter().map(|measured| measured.cell).collect();
    let here = visited[visited.len() - 1];
    let actions = sight.actions();
    let set = sight.permissible(world, here).unvisited(actions, &visited);
    set.iter().map(|action| here + actions.offset(action)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::drawn_world;

    #[test]
    fn rows_fit_what_came_of_them() {
        let map = [".........o"; 10].join("\n");
        let maps = [drawn_world(&map, 4), drawn_world("..\n..", 4)].map(Arc::new);
        let samples = Samples::draw(&maps, &Sight::new(4), 1, false);
        assert_eq!(samples.rows.len(), samples.columns * samples.holes.len());
        assert!(samples.holes.len() > 24 * 20 && samples.holes.len() <= 24 * 40);
        let holes = samples.holes.iter().sum::<f64>() / samples.holes.len() as f64;
        assert!(holes > 0.01 && holes < 0.3, "{holes}");
        assert_eq!(samples.rows, Samples::draw(&maps, &Sight::new(4), 1, false).rows);
        assert_ne!(samples.rows, Samples::draw(&maps, &Sight::new(4), 2, false).rows);
    }
}
