//! The weights of the candidates, and what they say together.

use super::candidates::Candidates;
use super::propagation::{Propagation, lowest_dbm};
use crate::rl::cell::Cell;
use crate::rl::flight::Measurement;
use crate::rl::world::World;

/// Degrees of freedom of the t distribution that levels have about what is expected: now and then they are far off.
const DEGREES: f64 = 4.0;
/// Residuals beyond this are no farther off, in standard deviations.
const FAR_OFF: f32 = 2.5;
/// Candidates with less than this share of the greatest weight are not asked.
const LEAST_WEIGHT: f64 = 1e-3;

/// What the measurements of a flight say of where the base station stands.
#[derive(Debug, Clone)]
pub struct Belief<'a> {
    model: &'a Propagation,
    candidates: &'a Candidates,
    world: &'a World,
    log_weights: Vec<f64>,
    measured: Vec<Cell>,
    /// Of each measurement and, within it, each candidate.
    residuals: Vec<Vec<f32>>,
}

impl<'a> Belief<'a> {
    /// Before anything was measured.
    #[must_use]
    pub fn new(model: &'a Propagation, candidates: &'a Candidates, world: &'a World) -> Self {
        let log_weights = candidates.log_prior.clone();
        let (measured, residuals) = (Vec::new(), Vec::new());
        Self { model, candidates, world, log_weights, measured, residuals }
    }

    /// Weighs the candidates by a measurement.
    pub fn measure(&mut self, measurement: &Measurement) {
        let index = self.world.index(measurement.cell);
        let lowest = lowest_dbm(self.world);
        let level = measurement.rsrp_dbm.max(lowest);
        let nearest = self.nearest(measurement.cell);
        let mut residuals = Vec::with_capacity(self.log_weights.len());
        for (at, &class) in self.candidates.classes(index).iter().enumerate() {
            let class = usize::from(class);
            let residual = self.model.residual(class, level);
            residuals.push(residual.clamp(-FAR_OFF, FAR_OFF));
            self.log_weights[at] += if level <= lowest {
                self.model.log_lowest[class]
            } else {
                // What the nearest measurement told already is not told again.
                let (expected, spread) = nearest.map_or((0.0, 1.0), |(which, similarity)| {
                    (similarity * self.residuals[which][at], (1.0 - similarity * similarity).sqrt())
                });
                let off = f64::from((residual - expected) / spread);
                let deviation = f64::from(self.model.deviation_db[class] * spread);
                -(DEGREES + 1.0) / 2.0 * libm::log1p(off * off / DEGREES) - libm::log(deviation)
            };
        }
        self.measured.push(measurement.cell);
        self.residuals.push(residuals);
    }

    /// The weights of the candidates, in their order; their sum is 1.
    #[must_use]
    pub fn weights(&self) -> Vec<f64> {
        let most = self.log_weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> =
            self.log_weights.iter().map(|&weight| libm::exp(weight - most)).collect();
        let sum: f64 = weights.iter().sum();
        weights.into_iter().map(|weight| weight / sum).collect()
    }

    /// The chance of each of some cells to be a coverage hole, if it is outdoors.
    #[must_use]
    pub fn hole_chances(&self, cells: &[Cell]) -> Vec<f32> {
        let weights = self.weights();
        let most = weights.iter().copied().fold(0.0, f64::max);
        let asked = || (0..weights.len()).filter(|&at| weights[at] >= LEAST_WEIGHT * most);
        let sum: f64 = asked().map(|at| weights[at]).sum();
        let asked: Vec<(usize, f32)> = asked().map(|at| (at, (weights[at] / sum) as f32)).collect();
        let chance = |&cell: &Cell| {
            let classes = self.candidates.classes(self.world.index(cell));
            let hole = |at: usize| self.model.hole[usize::from(classes[at])];
            let below = |deviations| self.model.normal.below(deviations);
            let chance: f32 = if let Some((which, similarity)) = self.nearest(cell) {
                let (residuals, narrower) =
                    (&self.residuals[which], 1.0 / (1.0 - similarity * similarity).sqrt());
                let of = |&(at, weight): &(usize, f32)| {
                    weight * below((hole(at) - similarity * residuals[at]) * narrower)
                };
                asked.iter().map(of).sum()
            } else {
                asked.iter().map(|&(at, weight)| weight * below(hole(at))).sum()
            };
            chance.clamp(0.0, 1.0)
        };
        cells.iter().map(chance).collect()
    }

    /// The measurement that is nearest to a cell, the last of equals, and how similar residuals are there.
    fn nearest(&self, cell: Cell) -> Option<(usize, f32)> {
        let measured = self.measured.iter().enumerate().rev();
        let (which, &other) =
            measured.min_by_key(|&(_, &other)| (cell - other).squared_length())?;
        Some((which, self.model.similarity(cell - other)))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use proptest::prelude::*;

    use super::*;
    use crate::rl::world::tests::world;

    /// A city of blocks with holes in the north of each, as if the base station stood in the south.
    fn city() -> Arc<World> {
        let row = |row: usize| -> String {
            let letter = |column: usize| match (row % 6, column % 5) {
                (3 | 4, 1..=3) => '#',
                (2, 1..=3) => 'o',
                _ => '.',
            };
            (0..30).map(letter).collect()
        };
        Arc::new(world(&(0..30).map(row).collect::<Vec<_>>().join("\n"), 6))
    }

    fn measurement(world: &World, cell: Cell) -> Measurement {
        Measurement { cell, rsrp_dbm: world.rsrp_dbm(cell) }
    }

    #[test]
    fn maps_without_a_base_station_teach_nothing() {
        assert!(Propagation::fit(&[]).is_none());
    }

    #[test]
    fn the_same_model_at_any_number_of_threads() {
        let maps = vec![city(); 5];
        let fit = |threads: usize| {
            let pool =
                rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| Propagation::fit(&maps)).expect("a model")
        };
        let (one, three) = (fit(1), fit(3));
        assert_eq!(one.mean_dbm, three.mean_dbm);
        assert_eq!(one.hole, three.hole);
        assert_eq!(
            one.similarity(Cell::new(0, 2)).to_bits(),
            three.similarity(Cell::new(2, 0)).to_bits()
        );
    }

    /// What holds levels of a place is likelier a hole beside a hole than beside a strong level.
    #[test]
    fn a_weak_level_makes_holes_beside_it_likelier() {
        let map = city();
        let model = Propagation::fit(std::slice::from_ref(&map)).expect("a model");
        let candidates = model.candidates(&map);
        let beside = |rsrp_dbm| {
            let mut belief = Belief::new(&model, &candidates, &map);
            belief.measure(&Measurement { cell: Cell::new(8, 7), rsrp_dbm });
            belief.hole_chances(&[Cell::new(8, 8)])[0]
        };
        assert!(beside(-125.0) > beside(-80.0));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        /// Weights sum to one, chances are chances, and the candidate that finds a measurement likeliest never loses.
        #[test]
        fn weights_are_those_of_bayes(cells in prop::collection::vec((0..30, 0..30), 1..6)) {
            let map = city();
            let model = Propagation::fit(std::slice::from_ref(&map)).expect("a model");
            let candidates = model.candidates(&map);
            let mut belief = Belief::new(&model, &candidates, &map);
            for (row, column) in cells {
                let cell = Cell::new(row, column);
                if !map.is_free(cell) {
                    continue;
                }
                let (before, logs) = (belief.weights(), belief.log_weights.clone());
                belief.measure(&measurement(&map, cell));
                let after = belief.weights();
                prop_assert!((after.iter().sum::<f64>() - 1.0).abs() < 1e-12);
                let likelihood = |at: usize| belief.log_weights[at] - logs[at];
                let best = (0..after.len()).max_by(|&a, &b| likelihood(a).total_cmp(&likelihood(b)));
                let best = best.expect("a candidate");
                prop_assert!(after[best] >= before[best] - 1e-12);
            }
            let free = map.free_cells();
            let chances = belief.hole_chances(&free);
            prop_assert!(chances.iter().all(|chance| (0.0..=1.0).contains(chance)));
        }
    }
}
