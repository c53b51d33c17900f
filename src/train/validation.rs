//! Flights over the validation split, which a signal may interrupt.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::judgement::Judgement;
use crate::config::Config;
use crate::evaluate::precision;
use crate::rl::agent::{Agent, Trainer};
use crate::rl::policy::{MakePolicy, Policy, View};
use crate::rl::{Cell, World};

/// Steps after which a policy is judged while it is trained; the mean precision is its score.
const JUDGED_STEPS: [u32; 3] = [1, 2, 4];
/// Flights between two looks at whether to stop.
const UNWATCHED: usize = 256;

/// Judges policies on maps of the validation split.
pub(super) struct Judge<'a> {
    maps: &'a [Arc<World>],
    config: Config,
    stop: &'a AtomicBool,
}

impl<'a> Judge<'a> {
    pub(super) fn new(maps: &'a [Arc<World>], config: &Config, stop: &'a AtomicBool) -> Self {
        let mut config = config.clone();
        config.evaluate.steps = JUDGED_STEPS.to_vec();
        config.evaluate.starts = config.train.evaluate_starts;
        Self { maps, config, stop }
    }

    /// Precision of the network as it is; `None` if it is told to stop.
    pub(super) fn judge(&self, trainer: &Trainer<'_>) -> Option<Judgement> {
        let Config { rl, train, .. } = &self.config;
        let agent = Agent::new(trainer.policy().duplicate(), self.maps[0].cells(), rl, train);
        let judged = |agent| {
            let found = precision(&Stoppable { agent, stop: self.stop }, self.maps, &self.config);
            (!self.stop.load(Ordering::Relaxed)).then_some(found)
        };
        let policy = judged(&agent)?;
        let predictor = match agent.predictor() {
            Some(predictor) => Some(judged(predictor)?),
            None => None,
        };
        Some(Judgement { steps: JUDGED_STEPS.to_vec(), policy, predictor })
    }
}

/// A policy that stays where it is from the moment when it is told to stop: what it comes to is of no use then,
/// but it is soon over.
#[derive(Debug)]
struct Stoppable<'a> {
    agent: &'a dyn MakePolicy,
    stop: &'a AtomicBool,
}

impl MakePolicy for Stoppable<'_> {
    fn policy<'a>(&'a self, known: &World) -> Box<dyn Policy + 'a> {
        Box::new(OnMap { policy: self.agent.policy(known), stop: self.stop })
    }
}

struct OnMap<'a> {
    policy: Box<dyn Policy + 'a>,
    stop: &'a AtomicBool,
}

impl Policy for OnMap<'_> {
    fn predict(&self, views: &mut [View<'_, '_>]) -> Vec<[f64; 2]> {
        let mut waypoints = Vec::with_capacity(views.len());
        for views in views.chunks_mut(UNWATCHED) {
            if self.stop.load(Ordering::Relaxed) {
                waypoints.extend(views.iter().map(|view| view.flight.cell().center()));
            } else {
                waypoints.extend(self.policy.predict(views));
            }
        }
        waypoints
    }

    fn keeps_fraction(&self) -> bool {
        self.policy.keeps_fraction()
    }

    fn allows(&self, cell: Cell) -> bool {
        self.policy.allows(cell)
    }
}
