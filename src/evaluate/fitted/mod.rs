//! Baselines that learn from the train split before anything flies, so that every report can have them: boosted
//! trees that predict P(hole) as an agent does but without a network or planning, the same told where the
//! base station is, a model of propagation for a belief about where it stands, and a table of what surrounds holes.
//!
//! The two that are told more than a UAV knows are ceilings: for what finding the base station can bring,
//! and for what interpolating levels can.

mod belief;
mod columns;
mod forest;
mod moves;
mod neighbours;
mod samples;
mod surroundings;
mod trees;

use self::belief::ByBelief;
use self::neighbours::Neighbours;
use self::samples::Samples;
pub use self::trees::FitError;
use self::trees::Trees;
use crate::config::{Config, EvaluateConfig, Method, Split};
use crate::dataset::Dataset;
use crate::progress::Progress;
use crate::rl::belief::Propagation;
use crate::rl::policy::Policy;
use crate::rl::{Sight, World, load_sample};

/// Maps that are learned from, at most.
const MAPS: usize = 1000;

/// What was learned for the methods that were asked for.
#[derive(Debug, Default)]
pub(super) struct Fitted {
    trees: Option<Trees>,
    told: Option<Trees>,
    neighbours: Option<Neighbours>,
    propagation: Option<Propagation>,
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
        let maps = load_sample(dataset, Split::Train, &config.rl, MAPS, *seed)?;
        let [plain, told] = [Method::Trees, Method::TreesToldBs].map(wants);
        let sight = Sight::new(config.rl.reach_cells);
        // What is told of the base station comes last: both learn from the same rows.
        let samples = (plain || told).then(|| Samples::draw(&maps, &sight, *seed, told));
        let trees = |wanted: bool, told| {
            let samples = samples.as_ref().filter(|_| wanted);
            samples.map(|samples| Trees::fit(samples, told)).transpose()
        };
        let propagation = wants(Method::Belief)
            .then(|| Propagation::fit(&maps).ok_or(FitError::NoStation))
            .transpose()?;
        let fitted = Self {
            propagation,
            trees: trees(plain, false)?,
            told: trees(told, true)?,
            neighbours: wants(Method::LeaveOneOut).then(|| Neighbours::fit(&maps)),
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
            Method::Belief => {
                Box::new(ByBelief::new(self.propagation.as_ref().expect(fitted), known))
            }
            Method::TreesToldBs => Box::new(self.told.as_ref().expect(fitted).policy(known)),
            _ => Box::new(self.trees.as_ref().expect(fitted).policy(known)),
        }
    }
}
