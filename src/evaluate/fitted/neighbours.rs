//! `leave-one-out`: the levels of all cells but the target, by a table that is learned from the train split.
//!
//! A cell is described by what surrounds it, itself left out: the share of holes in 3 × 3 and in 7 × 7
//! cells, and the mean level in 3 × 3. The share of holes among the training cells of a like description is
//! the chance that it is one. It bounds what any interpolation of measurements can do.

use std::sync::Arc;

use super::moves::moves;
use super::surroundings::ColumnSums;
use crate::rl::policy::{Policy, View};
use crate::rl::{Cell, World};

const NEAR: usize = 3;
const WIDE: usize = 7;
/// Steps of the share of holes in the two squares, and of the mean level.
const SHARES: [usize; 2] = [9, 10];
const LEVELS: usize = 24;
/// Width of a step of the mean level, in dB.
const STEP_DB: f64 = 4.0;
/// The lowest mean level that has a step of its own, in dB below the threshold.
const LOWEST_DB: f64 = 40.0;

/// How many training cells of each description there were, and how many of them are holes.
#[derive(Debug)]
pub(super) struct Neighbours {
    seen: Vec<f64>,
    holes: Vec<f64>,
}

impl Neighbours {
    /// Of the free cells of some maps.
    pub(super) fn fit(maps: &[Arc<World>]) -> Self {
        let count = SHARES[0] * SHARES[1] * LEVELS;
        // A description that was never seen is as likely as not.
        let mut table = Self { seen: vec![2.0; count], holes: vec![1.0; count] };
        for world in maps {
            let around = Around::new(world);
            for cell in world.free_cells() {
                let key = around.key(world, cell);
                table.seen[key] += 1.0;
                table.holes[key] += f64::from(u8::from(world.is_hole(cell)));
            }
        }
        table
    }

    /// The policy on a map of which it knows the levels.
    pub(super) fn policy(&self, known: &World) -> LeaveOneOut {
        let around = Around::new(known);
        let mut chances = vec![0.0; known.cells() * known.cells()];
        for cell in known.free_cells() {
            let key = around.key(known, cell);
            chances[known.index(cell)] = self.holes[key] / self.seen[key];
        }
        LeaveOneOut { chances }
    }
}

/// Sums over free cells.
struct Around {
    free: ColumnSums,
    holes: ColumnSums,
    levels: ColumnSums,
}

impl Around {
    fn new(world: &World) -> Self {
        let n = world.cells();
        let sums = |value: &dyn Fn(Cell) -> f64| {
            let of = |at| world.cell(at);
            let values =
                (0..n * n).map(of).map(|cell| if world.is_free(cell) { value(cell) } else { 0.0 });
            ColumnSums::new(&values.collect::<Vec<_>>(), n)
        };
        Self {
            free: sums(&|_| 1.0),
            holes: sums(&|cell| f64::from(u8::from(is_hole(world, cell)))),
            levels: sums(&|cell| level(world, cell)),
        }
    }

    /// The number of a free cell's description.
    fn key(&self, world: &World, cell: Cell) -> usize {
        let [hole, above] = [f64::from(u8::from(is_hole(world, cell))), level(world, cell)];
        let count = |side| (self.free.around(cell, side) - 1.0).max(1.0);
        let share = |side, steps: usize| {
            let share = (self.holes.around(cell, side) - hole) / count(side);
            ((share * steps as f64 + 1e-6) as usize).min(steps - 1)
        };
        // The first has a step for each number of holes among eight neighbours.
        let near = (self.holes.around(cell, NEAR) - hole) / count(NEAR);
        let near = (near * (SHARES[0] - 1) as f64 + 1e-6) as usize;
        let mean = (self.levels.around(cell, NEAR) - above) / count(NEAR);
        let mean = (mean / STEP_DB).clamp(0.0, (LEVELS - 1) as f64) as usize;
        (near.min(SHARES[0] - 1) * SHARES[1] + share(WIDE, SHARES[1])) * LEVELS + mean
    }
}

/// Whether the levels that a UAV knows make a cell a hole.
fn is_hole(world: &World, cell: Cell) -> bool {
    world.is_outdoors(cell) && world.rsrp_dbm(cell) < world.threshold_dbm()
}

/// The level above the lowest one that has a step.
fn level(world: &World, cell: Cell) -> f64 {
    f64::from(world.rsrp_dbm(cell) - world.threshold_dbm()) + LOWEST_DB
}

/// Flies to where the neighbourhood makes a hole most likely.
#[derive(Debug)]
pub(super) struct LeaveOneOut {
    chances: Vec<f64>,
}

impl Policy for LeaveOneOut {
    fn predict(&self, views: &mut [View<'_, '_>]) -> Vec<[f64; 2]> {
        let best = |view: &mut View<'_, '_>| {
            let cells = moves(view);
            let chance = |cell: &Cell| self.chances[view.known.index(*cell)];
            let most = cells.iter().map(chance).fold(f64::NEG_INFINITY, f64::max);
            // Many cells have the same description: one of them at random.
            let best: Vec<Cell> =
                cells.iter().copied().filter(|cell| chance(cell) >= most).collect();
            best[view.random.below(best.len())].center()
        };
        views.iter_mut().map(best).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::drawn_world as world;

    /// In training holes lie together, so a cell among holes is flown to, whatever it is itself.
    #[test]
    fn a_cell_is_judged_by_those_around_it() {
        let train = world("ooo..\nooo..\nooo..\n.....\n.....", 4);
        let table = Neighbours::fit(&[Arc::new(train)]);
        let map = world(".....\n.....\n..ooo\n..o.o\n..ooo", 4);
        let policy = table.policy(&map);
        let chance = |row, column| policy.chances[map.index(Cell::new(row, column))];
        assert!(chance(3, 3) > 0.6, "not a hole, but all around it are: {}", chance(3, 3));
        assert!(chance(0, 0) < 0.4, "{}", chance(0, 0));
    }

    /// The cell itself does not count: its own level must not change its description.
    #[test]
    fn the_target_is_left_out() {
        let maps = [".....\n.....\n..o..\n.....\n.....", ".....\n.....\n.....\n.....\n....."];
        let keys = maps.map(|map| {
            let world = world(map, 4);
            Around::new(&world).key(&world, Cell::new(2, 2))
        });
        assert_eq!(keys[0], keys[1]);
    }
}
