//! `trees` and `trees-told-bs`: P(hole) by gradient-boosted trees, followed greedily.

use forust_ml::gradientbooster::GrowPolicy;
use forust_ml::objective::ObjectiveType;
use forust_ml::{GradientBooster, Matrix};

use super::columns::{Columns, PLAIN};
use super::forest::Forest;
use super::moves::moves;
use super::samples::Samples;
use crate::rl::policy::{Policy, View};
use crate::rl::{Cell, PoolError, World};

const TREES: usize = 300;
const LEARNING_RATE: f32 = 0.08;
const LEAVES: usize = 31;
/// About 200 rows, of which a fifth are holes.
const LEAST_WEIGHT: f32 = 30.0;

/// Why trees cannot be fitted.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// There are no examples of both kinds.
    #[error(
        "it has no map with 50 outdoor cells that are no holes, from which moves lead to holes and to \
         other cells"
    )]
    NothingToFit,
    /// No base station stands on its map.
    #[error("no base station of its maps stands on its map, so that nothing tells where they do")]
    NoStation,
    /// Its maps cannot be had.
    #[error(transparent)]
    Maps(#[from] PoolError),
    /// The library refuses.
    #[error("trees cannot be fitted: {0}")]
    Library(String),
}

/// Fitted trees.
#[derive(Debug)]
pub(super) struct Trees {
    columns: usize,
    told: bool,
    forest: Forest,
}

impl Trees {
    /// Fits trees. The same rows give the same trees at any number of threads.
    ///
    /// # Errors
    /// [`FitError`] if there is nothing to tell apart.
    pub(super) fn fit(samples: &Samples, told: bool) -> Result<Self, FitError> {
        let Samples { columns, rows, holes } = samples;
        let width = if told { *columns } else { PLAIN };
        let found = holes.iter().sum::<f64>();
        if found == 0.0 || found == holes.len() as f64 {
            return Err(FitError::NothingToFit);
        }
        let differs = |column: &usize| {
            let mut values = rows.iter().skip(*column).step_by(*columns);
            let first = values.next();
            values.any(|value| Some(value) != first)
        };
        // Columns that differ from row to row.
        let kept: Vec<usize> = (0..width).filter(differs).collect();
        let values = by_column(rows, *columns, &kept);
        let mut booster = GradientBooster::default()
            .set_objective_type(ObjectiveType::LogLoss)
            .set_iterations(TREES)
            .set_learning_rate(LEARNING_RATE)
            .set_max_depth(LEAVES)
            .set_max_leaves(LEAVES)
            .set_l2(1.0)
            .set_min_leaf_weight(LEAST_WEIGHT)
            .set_tiled_histograms(true);
        booster.grow_policy = GrowPolicy::LossGuide;
        let matrix = Matrix::new(&values, holes.len(), kept.len());
        let fitted = booster.fit_unweighted(&matrix, holes, None);
        fitted.map_err(|error| FitError::Library(error.to_string()))?;
        Ok(Self { columns: width, told, forest: Forest::new(&booster, &kept) })
    }

    /// The policy on a map.
    pub(super) fn policy(&self, known: &World) -> ByTrees<'_> {
        ByTrees { trees: self, columns: Columns::new(known, self.told) }
    }

    /// Log-odds of a hole, of each row.
    fn log_odds(&self, rows: &[f32]) -> Vec<f64> {
        self.forest.sums(rows, self.columns)
    }
}

/// Some columns of rows, one after the other.
fn by_column(rows: &[f32], columns: usize, kept: &[usize]) -> Vec<f64> {
    let column = |&at: &usize| rows.iter().skip(at).step_by(columns).map(|&value| f64::from(value));
    kept.iter().flat_map(column).collect()
}

/// Flies to where the trees find a hole most likely.
#[derive(Debug)]
pub(super) struct ByTrees<'a> {
    trees: &'a Trees,
    columns: Columns,
}

impl Policy for ByTrees<'_> {
    fn predict(&self, views: &mut [View<'_, '_>]) -> Vec<[f64; 2]> {
        let mut rows = Vec::new();
        let best = |view: &mut View<'_, '_>| {
            let moves = moves(view);
            rows.clear();
            self.columns.rows(view.known, view.flight.measurements(), &moves, &mut rows);
            let odds = self.trees.log_odds(&rows);
            let pairs = moves.iter().zip(&odds);
            // The first of equals.
            let best = pairs.reduce(|best, other| if other.1 > best.1 { other } else { best });
            best.map_or_else(|| view.flight.cell(), |(cell, _): (&Cell, _)| *cell).center()
        };
        views.iter_mut().map(best).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::rl::{Flight, Random, Sight, drawn_world};

    /// Holes lie in the south: trees learn to fly there, at any number of threads alike.
    #[test]
    fn trees_find_what_tells_holes_apart() {
        let rows = ["..............."; 10].into_iter().chain(["ooooooooooooooo"; 5]);
        let map = rows.collect::<Vec<_>>().join("\n");
        let (sight, maps) = (Sight::new(6), [Arc::new(drawn_world(&map, 6))]);
        let samples = Samples::draw(&maps, &sight, 1, false);
        let fit = |threads: usize| {
            let pool =
                rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| Trees::fit(&samples, false)).expect("fits")
        };
        let (one, three) = (fit(1), fit(3));
        assert_eq!(one.log_odds(&samples.rows), three.log_odds(&samples.rows));
        let flight = Flight::new(&maps[0], &maps[0], &sight, Cell::new(7, 7));
        let random = &mut Random::keyed(&[1]);
        let mut views = [View { flight: &flight, known: &maps[0], random }];
        let to = Cell::at(one.policy(&maps[0]).predict(&mut views)[0]);
        assert!(maps[0].is_hole(to), "{to:?}");
    }

    #[test]
    fn without_holes_there_is_nothing_to_fit() {
        let maps = [Arc::new(drawn_world(&[".........."; 10].join("\n"), 4))];
        let samples = Samples::draw(&maps, &Sight::new(4), 1, false);
        assert!(matches!(Trees::fit(&samples, false), Err(FitError::NothingToFit)));
        assert!(matches!(Trees::fit(&Samples::default(), false), Err(FitError::NothingToFit)));
    }
}
