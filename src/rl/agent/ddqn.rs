//! Double DQN: target, loss and what is added to it, beside the paper's equations.

use tch::{Kind, Reduction, Tensor};

use super::batch::Batch;
use super::network::QNetwork;
use crate::config::{Loss, TrainConfig};

/// The parts of a loss, for the log.
#[derive(Debug)]
pub struct LossParts {
    /// What is minimised.
    pub total: Tensor,
    /// `L_1`, `eqn:ddqn_loss`.
    pub q: Tensor,
    /// Mean squared error of the predicted rewards, if there is a head for them.
    pub reward: Option<Tensor>,
}

/// `eq:discounted_reward`: `y = r + γ Q_target(h', argmax_a' Q_policy(h', a'))`, where a state that
/// ends an episode has no value: `[batch]`, without gradient. `q_policy` and `q_target` are
/// the values of all actions in the next states, `[batch, actions]`; actions outside of
/// `allowed` (0 or 1, the same shape) are not chosen.
pub fn target(
    reward: &Tensor,
    terminal: &Tensor,
    q_policy: &Tensor,
    q_target: &Tensor,
    allowed: Option<&Tensor>,
    discount: f64,
) -> Tensor {
    let masked = allowed.map(|allowed| q_policy.masked_fill(&allowed.eq(0.0), f64::NEG_INFINITY));
    let best = masked.as_ref().unwrap_or(q_policy).argmax(1, true);
    let value = q_target.gather(1, &best, false).squeeze_dim(1);
    let continues: Tensor = 1.0 - terminal;
    (reward + continues * discount * value).detach()
}

fn error(found: &Tensor, wanted: &Tensor, loss: Loss) -> Tensor {
    match loss {
        Loss::Squared => found.mse_loss(wanted, Reduction::None),
        Loss::Huber => found.huber_loss(wanted, Reduction::None, 1.0),
    }
}

/// `L = L_1 + α r²`, `eqn:final_loss`, and what is added beyond the paper: the errors of Q-values of
/// all actions that end the episode (they are 0, whatever the network thinks), and of the
/// predicted rewards of all actions.
#[must_use]
pub fn loss(
    policy: &QNetwork,
    target_network: &QNetwork,
    batch: &Batch,
    config: &TrainConfig,
) -> LossParts {
    let wanted = tch::no_grad(|| {
        let (q_policy, _) = policy.forward(&batch.next_map, &batch.next_window);
        let (q_target, _) = target_network.forward(&batch.next_map, &batch.next_window);
        let allowed = config.mask_actions.then_some(&batch.next_permissible);
        target(&batch.reward, &batch.terminal, &q_policy, &q_target, allowed, config.discount)
    });
    let (q_values, rewards) = policy.forward(&batch.map, &batch.window);
    let taken = q_values.gather(1, &batch.action.unsqueeze(1), false).squeeze_dim(1);
    let q = error(&taken, &wanted, config.loss).mean(Kind::Float);
    let mut total = &q + config.squared_reward * batch.reward.square().mean(Kind::Float);
    if config.dense_terminal {
        let errors = error(&q_values, &q_values.zeros_like(), config.loss) * &batch.all_terminal;
        total += errors.sum(Kind::Float) / batch.all_terminal.sum(Kind::Float).clamp_min(1.0);
    }
    let reward = rewards.map(|found| found.mse_loss(&batch.all_rewards, Reduction::Mean));
    if let Some(reward) = &reward {
        total += config.reward_prediction * reward;
    }
    LossParts { total, q, reward }
}
