//! Baselines that learn from the train split before anything flies, so that every report can have them: boosted
//! trees that predict P(hole) as an agent does but without a network or planning, the same told where the
//! base station is, and a table of what surrounds holes.
//!
//! The two that are told more than a UAV knows are ceilings: for what finding the base station can bring,
//! and for what interpolating levels can.

mod columns;
mod neighbours;
mod samples;
mod surroundings;
mod trees;

use rayon::prelude::*;

use self::neighbours::Neighbours;
use self::samples::Samples;
pub use self::trees::FitError;
use self::trees::Trees;
use crate::config::{Config, EvaluateConfig, Method, Split};
use crate::dataset::{Dataset, ReadError};
use crate::progress::Progress;
use crate::rl::policy::{Policy, View};
use crate::rl::{Cell, Random, Sight, World};

const CHOOSING: u64 = 6;
/// Maps that are learned from, at most.
const MAPS: usize = 1000;

/// What was learned for the methods that were asked for.
#[derive(Debug, Default)]
pub(super) struct Fitted {
    trees: Option<Trees>,
    told: Option<Trees>,
    neighbours: Option<Neighbours>,
}

impl Fitted {
    /// Learns from the train split of a dataset, or from [`MAPS`] of its maps chosen at random, what the methods
    /// of the configuration need.
    ///
    /// # Errors
    /// [`FitError`] if the split does not do for it or cannot be read.
    pub(super) fn fit(
        dataset: &Dataset,
        config: &Config,
        progress: &dyn Progress,
    ) -> Result<Self, FitError> {
        let EvaluateConfig { methods, seed, .. } = &config.evaluate;
        let wants = |method| methods.contains(&method);
        if !methods.iter().any(|method| method.learns()) {
            return Ok(Self::default());
        }
        progress.begin("fitting", None);
        let ids = Random::keyed(&[*seed, CHOOSING]).sample(&dataset.ids_of(Split::Train), MAPS);
        let maps = ids.into_par_iter().map(|id| {
            let (record, grids) = dataset.record_with_grids(id)?;
            Ok(World::new(&record, &grids, &config.rl))
        });
        let maps: Vec<World> = maps.collect::<Result<_, ReadError>>()?;
        if maps.is_empty() {
            return Err(FitError::NothingToFit);
        }
        let sight = Sight::new(config.rl.reach_cells);
        let trees = |method, told| {
            let fit = || Trees::fit(&Samples::draw(&maps, &sight, *seed, told), told);
            wants(method).then(fit).transpose()
        };
        let fitted = Self {
            trees: trees(Method::Trees, false)?,
            told: trees(Method::TreesToldBs, true)?,
            neighbours: wants(Method::LeaveOneOut).then(|| Neighbours::fit(maps.iter())),
        };
        progress.end();
        Ok(fitted)
    }

    /// The policy of a method that learns, on a map.
    ///
    /// # Panics
    /// If the method was not among those that [`Fitted::fit`] was told of.
    pub(super) fn policy<'a>(&'a self, method: Method, known: &World) -> Box<dyn Policy + 'a> {
        let fitted = "fitted before anything flies";
        match method {
            Method::LeaveOneOut => Box::new(self.neighbours.as_ref().expect(fitted).policy(known)),
            Method::TreesToldBs => Box::new(self.told.as_ref().expect(fitted).policy(known)),
            _ => Box::new(self.trees.as_ref().expect(fitted).policy(known)),
        }
    }
}

/// Cells that a flight may be led to, visited ones left out while there are others.
fn moves(view: &View<'_, '_>) -> Vec<Cell> {
    let actions = view.flight.sight().actions();
    let visited = view.flight.measurements().iter().map(|measured| measured.cell);
    let set = view.permissible().unvisited(actions, &visited.collect::<Vec<_>>());
    set.iter().map(|action| view.flight.cell() + actions.offset(action)).collect()
}
