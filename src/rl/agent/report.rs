//! What is said of training from time to time.

use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor};

use super::ddqn::LossParts;

/// How training went since the last report: means over the updates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TrainReport {
    /// Updates done.
    pub update: u64,
    /// Steps of all episodes done.
    pub steps: u64,
    /// What was minimised.
    pub loss: f64,
    /// Its part of Q-values, `L_1`.
    pub q_loss: f64,
    /// Mean squared error of predicted rewards, if there is a head for them.
    pub reward_loss: Option<f64>,
    /// Norm of the gradients before it was limited.
    pub gradient_norm: f64,
    /// Share of random actions now.
    pub epsilon: f64,
    /// Mean return of the episodes that ended, not discounted.
    pub mean_return: Option<f64>,
}

/// Sums since the last report. Those of losses stay on the device: nobody waits for them.
#[derive(Debug)]
pub(super) struct Totals {
    losses: Tensor,
    updates: u32,
    has_reward: bool,
    returns: f64,
    episodes: u32,
}

/// What a checkpoint keeps of them.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct TotalsState {
    losses: [f64; 4],
    updates: u32,
    returns: f64,
    episodes: u32,
}

impl Totals {
    pub(super) fn new(state: &TotalsState, has_reward: bool, device: Device) -> Self {
        let TotalsState { losses, updates, returns, episodes } = *state;
        let losses = Tensor::from_slice(&losses).to_device(device);
        Self { losses, updates, has_reward, returns, episodes }
    }

    /// Adds an update.
    pub(super) fn add(&mut self, parts: &LossParts, norm: &Tensor) {
        let zero = || norm.zeros_like();
        let reward = parts.reward.as_ref().map_or_else(zero, Tensor::detach);
        let losses = [parts.total.detach(), parts.q.detach(), reward, norm.shallow_clone()];
        self.losses += Tensor::stack(&losses, 0).to_kind(Kind::Double);
        self.updates += 1;
    }

    /// Adds the return of an episode.
    pub(super) fn ended(&mut self, of: f64) {
        self.returns += of;
        self.episodes += 1;
    }

    /// The sums; for them one waits. `None` if they are no numbers any more.
    pub(super) fn state(&self) -> Option<TotalsState> {
        let mut losses = [0.0_f64; 4];
        self.losses.to_device(Device::Cpu).copy_data(&mut losses, 4);
        let Self { updates, returns, episodes, .. } = *self;
        let finite = losses.iter().all(|sum| sum.is_finite());
        finite.then_some(TotalsState { losses, updates, returns, episodes })
    }

    /// The report of what came so far, after which sums begin anew.
    pub(super) fn take(&mut self, [update, steps]: [u64; 2], epsilon: f64) -> Option<TrainReport> {
        let TotalsState { losses, updates, returns, episodes } = self.state()?;
        *self = Self::new(&TotalsState::default(), self.has_reward, self.losses.device());
        let [loss, q_loss, reward_loss, gradient_norm] =
            losses.map(|sum| sum / f64::from(updates.max(1)));
        Some(TrainReport {
            update,
            steps,
            loss,
            q_loss,
            reward_loss: self.has_reward.then_some(reward_loss),
            gradient_norm,
            epsilon,
            mean_return: (episodes > 0).then(|| returns / f64::from(episodes)),
        })
    }
}
