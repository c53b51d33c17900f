//! `belief`: to where a hole is most likely by what is believed of the base station's place.

use super::moves::moves;
use crate::rl::World;
use crate::rl::belief::{Belief, Candidates, Propagation};
use crate::rl::policy::{Policy, View};

/// Flies to where the candidates, weighed by the measurements, find a hole most likely.
#[derive(Debug)]
pub(super) struct ByBelief<'a> {
    model: &'a Propagation,
    candidates: Candidates,
}

impl<'a> ByBelief<'a> {
    /// On a map as the UAV has it stored.
    pub(super) fn new(model: &'a Propagation, known: &World) -> Self {
        Self { model, candidates: model.candidates(known) }
    }
}

impl Policy for ByBelief<'_> {
    fn predict(&self, views: &mut [View<'_, '_>]) -> Vec<[f64; 2]> {
        let best = |view: &mut View<'_, '_>| {
            let mut belief = Belief::new(self.model, &self.candidates, view.known);
            for measurement in view.flight.measurements() {
                belief.measure(measurement);
            }
            let moves = moves(view);
            let chances = belief.hole_chances(&moves);
            // The first of equals.
            let pairs = moves.into_iter().zip(chances);
            let best = pairs.reduce(|best, other| if other.1 > best.1 { other } else { best });
            best.map_or_else(|| view.flight.cell(), |(cell, _)| cell).center()
        };
        views.iter_mut().map(best).collect()
    }
}
