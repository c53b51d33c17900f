//! How sure the holes of one map are, and the most that anybody can find who knows the map as well as
//! its repeats do.
//!
//! A flight is judged by the chance that its last cell is a hole ([`crate::reliability`]). The label
//! ceiling judges the map itself: one half of the repeats chooses, of all cells within reach, the one
//! that is a hole with the greatest chance; the other half says whether it is. What this misses is noise.

use crate::config::RlConfig;
use crate::dataset::{Grids, Record};
use crate::manifest::ErrorGrids;
use crate::manifest::MASK_REACHED;
use crate::reliability::{HoleModel, MAX_STD_ERROR_DB, SURE};
use crate::rl::{ActionSet, Cell, Sight, World};
use crate::units::{Db, Dbm};

/// Chances that cells are holes, row by row; 0 where a cell is not outdoors.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Labels {
    pub(super) repeats: u32,
    chances: Vec<f64>,
    halves: Option<[Half; 2]>,
}

/// What half of the repeats tell.
#[derive(Debug, Clone, PartialEq)]
struct Half {
    chances: Vec<f64>,
    holes: Vec<bool>,
}

/// How sure the outdoor cells of a map are.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LabelsOnMap {
    pub(super) repeats: u32,
    /// Sum of the chances of all outdoor cells.
    pub(super) expected_holes: f64,
    pub(super) sure_holes: u64,
    pub(super) unsure: u64,
    /// The ceiling after each number of steps, if halves are told.
    pub(super) ceiling: Option<Vec<Ceiling>>,
}

/// What the oracle of one half finds by the other, the mean of both ways round.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Ceiling {
    /// Share of starts from which a hole is chosen.
    pub(super) precision: f64,
    /// Mean chance that what is chosen is a hole.
    pub(super) expected: f64,
}

/// Whether a chance makes a cell surely a hole.
pub(super) fn is_sure_hole(chance: f64) -> bool {
    chance >= SURE
}

/// Whether a chance makes a cell surely a hole, or surely none.
pub(super) fn is_sure(chance: f64) -> bool {
    is_sure_hole(chance) || chance <= 1.0 - SURE
}

impl Labels {
    /// Of a record; `None` if its map was traced once.
    pub(super) fn new(
        world: &World,
        record: &Record,
        grids: &Grids,
        config: &RlConfig,
    ) -> Option<Self> {
        let (errors, repeats) = grids.errors.as_ref().zip(record.repeats)?;
        let ErrorGrids { std_error_db, first_half_share } = errors;
        let (model, threshold) = (HoleModel::new(repeats), config.hole_threshold_dbm);
        let n = world.cells();
        let cells = || (0..n * n).map(|at| (world.cell(at), [at / n, at % n]));
        // The level of a reached cell, raised by some decibels, with its error; no level is a hole.
        let chance = |cell: Cell, at: [usize; 2], over: Db, error_db: f64| {
            let is_reached = grids.mask[at] == MASK_REACHED && over.0.is_finite();
            match (world.is_outdoors(cell), is_reached) {
                (false, _) => 0.0,
                (true, false) => 1.0,
                (true, true) => {
                    let level = Dbm(grids.rsrp_dbm[at].into()) + over;
                    model.probability(level, error_db, threshold)
                }
            }
        };
        let of_all =
            |(cell, at): (Cell, [usize; 2])| chance(cell, at, Db(0.0), std_error_db[at].into());
        let half = |share: &dyn Fn([usize; 2]) -> f64| {
            let over = |at| Db::from_linear(2.0 * share(at));
            // The mean of half as many has twice the variance, and no larger an error than any mean.
            let error = |at: [usize; 2]| {
                let error = f64::from(std_error_db[at]) * std::f64::consts::SQRT_2;
                error.min(MAX_STD_ERROR_DB)
            };
            Half {
                chances: cells().map(|(cell, at)| chance(cell, at, over(at), error(at))).collect(),
                holes: cells().map(|(cell, at)| chance(cell, at, over(at), 0.0) > SURE).collect(),
            }
        };
        let halves = first_half_share.as_ref().map(|shares| {
            let share = |at: [usize; 2]| f64::from(shares[at]);
            [half(&share), half(&|at| 1.0 - share(at))]
        });
        Some(Self { repeats, chances: cells().map(of_all).collect(), halves })
    }

    /// The chance that a cell, by its index, is a hole.
    pub(super) fn chance(&self, index: usize) -> f64 {
        self.chances[index]
    }

    /// How sure a map's outdoor cells are, and its ceiling from some starts.
    pub(super) fn on_map(
        &self,
        world: &World,
        sight: &Sight,
        outdoors: &[Cell],
        starts: &[Cell],
        steps: &[u32],
    ) -> LabelsOnMap {
        let chances = || outdoors.iter().map(|&cell| self.chance(world.index(cell)));
        let count = |holds: &dyn Fn(f64) -> bool| chances().filter(|&chance| holds(chance)).count();
        let halves = self.halves.as_ref().filter(|_| !starts.is_empty());
        LabelsOnMap {
            repeats: self.repeats,
            expected_holes: chances().sum(),
            sure_holes: count(&is_sure_hole) as u64,
            unsure: count(&|chance| !is_sure(chance)) as u64,
            ceiling: halves.map(|halves| ceiling(world, sight, halves, starts, steps)),
        }
    }
}

fn ceiling(
    world: &World,
    sight: &Sight,
    [a, b]: &[Half; 2],
    starts: &[Cell],
    steps: &[u32],
) -> Vec<Ceiling> {
    let moves = Moves::new(world, sight);
    let mut sums = vec![Ceiling::default(); steps.len()];
    for (chooses, judges) in [(a, b), (b, a)] {
        let mut targets: Vec<u32> = (0..chooses.chances.len() as u32).collect();
        let mut flown = 0;
        for (sum, &k) in sums.iter_mut().zip(steps) {
            while flown < k && moves.widen(&mut targets, &chooses.chances) {
                flown += 1;
            }
            for start in starts {
                let target = targets[world.index(*start)] as usize;
                sum.precision += f64::from(u8::from(judges.holes[target]));
                sum.expected += judges.chances[target];
            }
        }
    }
    let flights = 2.0 * starts.len() as f64;
    let mean = |sum: Ceiling| Ceiling {
        precision: sum.precision / flights,
        expected: sum.expected / flights,
    };
    sums.into_iter().map(mean).collect()
}

/// Where one step may lead from each free cell.
struct Moves<'a> {
    world: &'a World,
    sight: &'a Sight,
    permissible: Vec<Option<ActionSet>>,
}

impl<'a> Moves<'a> {
    fn new(world: &'a World, sight: &'a Sight) -> Self {
        let cells = (0..world.cells() * world.cells()).map(|at| world.cell(at));
        let permissible =
            cells.map(|cell| world.is_free(cell).then(|| sight.permissible(world, cell)));
        Self { world, sight, permissible: permissible.collect() }
    }

    /// One step more: each cell's target becomes the best of those of the cells that a step may lead to,
    /// where that is better. Returns whether any did.
    fn widen(&self, targets: &mut [u32], chances: &[f64]) -> bool {
        let best = chances.iter().copied().fold(0.0, f64::max);
        let values: Vec<f64> = targets.iter().map(|&target| chances[target as usize]).collect();
        let before = targets.to_vec();
        let mut changed = false;
        for (at, target) in targets.iter_mut().enumerate() {
            let Some(set) = self.permissible[at].as_ref().filter(|_| values[at] < best) else {
                continue;
            };
            let (from, mut value) = (self.world.cell(at), values[at]);
            for action in set.iter() {
                let next = self.world.index(from + self.sight.actions().offset(action));
                if values[next] > value {
                    (value, *target, changed) = (values[next], before[next], true);
                }
            }
        }
        changed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::example;
    use crate::manifest::{MASK_BUILDING, MASK_UNREACHED};
    use ndarray::{Array2, array};

    /// Four cells in a row, a building behind them, cells that nothing reaches below: an error of 1 dB,
    /// at 8 repeats.
    fn map(levels: [f32; 4], shares: [f32; 4]) -> (World, Labels) {
        let (mut record, _) = example();
        record.repeats = Some(8);
        let row = |at: usize| Array2::from_shape_fn((4, 4), |(row, _)| row == at);
        let first = |values: [f32; 4], other: f32| {
            Array2::from_shape_fn(
                (4, 4),
                |(row, column)| if row == 0 { values[column] } else { other },
            )
        };
        let mask = Array2::from_shape_fn((4, 4), |(row, _)| {
            [0, MASK_BUILDING, MASK_UNREACHED, MASK_UNREACHED][row]
        });
        let grids = Grids {
            height_m: row(1).mapv(|built| if built { 10.0 } else { 0.0 }),
            rsrp_dbm: first(levels, -160.0),
            mask,
            errors: Some(ErrorGrids {
                std_error_db: first([1.0; 4], 0.0),
                first_half_share: Some(first(shares, 0.0)),
            }),
        };
        let config = RlConfig { reach_cells: 1, ..RlConfig::default() };
        let world = World::new(&record, &grids, &config);
        let labels = Labels::new(&world, &record, &grids, &config).expect("errors");
        (world, labels)
    }

    /// `scipy.stats.t.cdf([-2, 0, 1, 3], 7)`.
    #[test]
    fn chances_are_those_of_levels_and_no_path_is_a_hole() {
        let (world, labels) = map([-98.0, -100.0, -101.0, -103.0], [0.5; 4]);
        let expected = [0.042_809_664, 0.5, 0.824_691_669, 0.990_028_937];
        for (at, expected) in expected.into_iter().enumerate() {
            assert!((labels.chance(at) - expected).abs() < 1e-8, "{}", labels.chance(at));
        }
        assert_eq!([labels.chance(4), labels.chance(8)], [0.0, 1.0], "a building, no path");
        let outdoors: Vec<Cell> = (0..4).map(|at| world.cell(at)).collect();
        let on_map = labels.on_map(&world, &Sight::new(1), &outdoors, &[], &[0]);
        assert_eq!((on_map.sure_holes, on_map.unsure, on_map.ceiling), (1, 2, None));
        assert!((on_map.expected_holes - 2.357_530_27).abs() < 1e-7);
    }

    /// The first half sees a hole in the west, the second one in the east; both are 3 dB apart, and
    /// levels of all repeats are 1 dB over the threshold.
    #[test]
    fn one_half_chooses_and_the_other_judges() {
        let (world, labels) = map([-99.0; 4], [0.25, 0.5, 0.5, 0.75]);
        let sight = Sight::new(1);
        let starts = [Cell::new(0, 0), Cell::new(0, 3)];
        let all: Vec<Cell> = (0..4).map(|at| world.cell(at)).collect();
        let on_map = labels.on_map(&world, &sight, &all, &starts, &[0, 1, 3]);
        let ceiling = on_map.ceiling.expect("halves");
        // A half at 0.25 has 3 dB less than the mean: -102.01 dBm. Where the one starts, the other has none.
        assert_eq!(ceiling[0].precision, 0.5, "each start is a hole of one half");
        // With three steps each half flies to its own hole, which the other does not see.
        assert_eq!(ceiling[2].precision, 0.0);
        assert!(ceiling[2].expected < 0.05 && ceiling[1].expected < ceiling[0].expected);
    }

    #[test]
    fn a_hole_of_both_halves_is_found_within_reach() {
        let (world, labels) = map([-80.0, -80.0, -80.0, -120.0], [0.5; 4]);
        let (sight, starts) = (Sight::new(1), [Cell::new(0, 0)]);
        let all: Vec<Cell> = (0..4).map(|at| world.cell(at)).collect();
        let on_map = labels.on_map(&world, &sight, &all, &starts, &[0, 1, 2, 3, 8]);
        let precision: Vec<f64> =
            on_map.ceiling.expect("halves").iter().map(|at| at.precision).collect();
        assert_eq!(array![0.0, 0.0, 0.0, 1.0, 1.0].to_vec(), precision);
    }

    #[test]
    fn a_half_without_a_path_sees_a_hole() {
        let (_, labels) = map([-80.0; 4], [0.0, 0.5, 0.5, 1.0]);
        let [a, b] = labels.halves.expect("halves");
        assert_eq!(
            (&a.holes[..4], &b.holes[..4]),
            (&[true, false, false, false][..], &[false, false, false, true][..])
        );
        assert_eq!((a.chances[0], b.chances[3]), (1.0, 1.0));
    }
}
