//! What is said of training from time to time.

use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor};

use super::ddqn::LossParts;
use crate::config::TrainConfig;

/// How training went since the last report: means over the updates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TrainReport {
    /// Updates done.
    pub update: u64,
    /// Steps of all episodes done.
    pub steps: u64,
    /// What was minimised.
    pub loss: f64,
    /// Its part of Q-values, `L_1`; in a factored network that of V.
    pub q_loss: f64,
    /// Cross-entropy of P(hole) in nats, if there is a head for it.
    pub hole_loss: Option<f64>,
    /// Error of the Q-values of all actions that end the episode, if they are taught.
    pub terminal_loss: Option<f64>,
    /// Mean squared error of predicted rewards, if there is a head for them.
    pub reward_loss: Option<f64>,
    /// Norm of the gradients before it was limited.
    pub gradient_norm: f64,
    /// Share of random actions now.
    pub epsilon: f64,
    /// Mean return of the episodes that ended, not discounted.
    pub mean_return: Option<f64>,
    /// Share of the actions chosen by Q-value that led to a visited cell, or nowhere.
    pub revisits: Option<f64>,
}

/// Losses and the norm of gradients.
const SUMS: usize = 6;

/// Sums since the last report. Those of losses stay on the device: nobody waits for them.
#[derive(Debug)]
pub(super) struct Totals {
    losses: Tensor,
    /// Which losses there are.
    has: [bool; SUMS],
    counts: Counts,
}

#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
struct Counts {
    updates: u32,
    returns: f64,
    episodes: u32,
    chosen: u32,
    revisits: u32,
}

/// What a checkpoint keeps of them.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct TotalsState {
    losses: [f64; SUMS],
    counts: Counts,
}

impl Totals {
    pub(super) fn new(state: &TotalsState, train: &TrainConfig, device: Device) -> Self {
        let [holes, rewards] = [train.hole_prediction, train.reward_prediction].map(|of| of > 0.0);
        let has = [true, true, holes, rewards, train.dense_terminal, true];
        Self::from(state, has, device)
    }

    fn from(state: &TotalsState, has: [bool; SUMS], device: Device) -> Self {
        let losses = Tensor::from_slice(&state.losses).to_device(device);
        Self { losses, has, counts: state.counts }
    }

    /// Adds an update.
    pub(super) fn add(&mut self, parts: &LossParts, norm: &Tensor) {
        let some = |part: &Option<Tensor>| part.as_ref().map_or(norm.zeros_like(), Tensor::detach);
        let LossParts { total, q, holes, rewards, terminal, .. } = parts;
        let [holes, rewards, terminal] = [holes, rewards, terminal].map(some);
        let losses = [total.detach(), q.detach(), holes, rewards, terminal, norm.shallow_clone()];
        self.losses += Tensor::stack(&losses, 0).to_kind(Kind::Double);
        self.counts.updates += 1;
    }

    /// Adds the return of an episode.
    pub(super) fn ended(&mut self, of: f64) {
        self.counts.returns += of;
        self.counts.episodes += 1;
    }

    /// Adds an action that was chosen by its Q-value.
    pub(super) fn chose(&mut self, revisits: bool) {
        self.counts.chosen += 1;
        self.counts.revisits += u32::from(revisits);
    }

    /// The sums, once they are computed; `None` if they are no longer finite.
    pub(super) fn state(&self) -> Option<TotalsState> {
        let mut losses = [0.0_f64; SUMS];
        self.losses.to_device(Device::Cpu).copy_data(&mut losses, SUMS);
        let finite = losses.iter().all(|sum| sum.is_finite());
        finite.then_some(TotalsState { losses, counts: self.counts })
    }

    /// The report of what came so far, after which sums begin anew.
    pub(super) fn take(&mut self, [update, steps]: [u64; 2], epsilon: f64) -> Option<TrainReport> {
        let TotalsState { losses, counts } = self.state()?;
        *self = Self::from(&TotalsState::default(), self.has, self.losses.device());
        let Counts { updates, returns, episodes, chosen, revisits } = counts;
        let mean = |at: usize| losses[at] / f64::from(updates.max(1));
        let some = |at: usize| self.has[at].then(|| mean(at));
        let share = |sum: f64, count: u32| (count > 0).then(|| sum / f64::from(count));
        Some(TrainReport {
            update,
            steps,
            loss: mean(0),
            q_loss: mean(1),
            hole_loss: some(2),
            reward_loss: some(3),
            terminal_loss: some(4),
            gradient_norm: mean(5),
            epsilon,
            mean_return: share(returns, episodes),
            revisits: share(revisits.into(), chosen),
        })
    }
}
