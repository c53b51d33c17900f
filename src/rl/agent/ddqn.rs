//! Double DQN: target, loss and what is added to it, beside the paper's equations.

use tch::{Kind, Reduction, Tensor};

use super::batch::Batch;
use super::network::QNetwork;
use crate::config::{Loss, TrainConfig};

/// The parts of a loss.
#[derive(Debug)]
pub struct LossParts {
    /// What is minimised.
    pub total: Tensor,
    /// `L_1`, `eqn:ddqn_loss`.
    pub q: Tensor,
    /// Mean squared error of the predicted rewards, if there is a head for them.
    pub reward: Option<Tensor>,
    /// By how much each transition's Q-value was wrong, `[batch]`, without gradient.
    pub errors: Tensor,
}

/// `eq:discounted_reward`: `y = r + γ Q_target(h', argmax_a' Q_policy(h', a'))`: `[batch]`. A state
/// that ends the episode at a hole has no value.
fn target(
    policy: &QNetwork,
    target_network: &QNetwork,
    batch: &Batch,
    config: &TrainConfig,
) -> Tensor {
    let Batch { reward, next, .. } = batch;
    if next.of.numel() == 0 {
        return reward.shallow_clone();
    }
    let inputs = policy.inputs(&next.map, &next.window);
    let allowed = config.mask_actions.then_some(&next.permissible);
    let actions = policy.best_actions(&inputs, allowed);
    let value = target_network.values_of(&inputs, &actions);
    reward.index_add(0, &next.of, &(&next.discount * value))
}

fn error(found: &Tensor, wanted: &Tensor, loss: Loss) -> Tensor {
    match loss {
        Loss::Squared => found.mse_loss(wanted, Reduction::None),
        Loss::Huber => found.huber_loss(wanted, Reduction::None, 1.0),
    }
}

/// `L = L_1 + α r²`, `eqn:final_loss`, and what is added beyond the paper: the errors of Q-values of
/// all actions that end the episode (they are 0, whatever the network thinks), and of the
/// predicted rewards of all actions. `weights`, `[batch]`, are those of prioritised replay.
#[must_use]
pub fn loss(
    policy: &QNetwork,
    target_network: &QNetwork,
    batch: &Batch,
    weights: Option<&Tensor>,
    config: &TrainConfig,
) -> LossParts {
    let wanted = tch::no_grad(|| target(policy, target_network, batch, config));
    let (q_values, rewards) = policy.forward(&policy.inputs(&batch.map, &batch.window));
    let taken = q_values.gather(1, &batch.action.unsqueeze(1), false).squeeze_dim(1);
    let errors = error(&taken, &wanted, config.loss);
    let q = match weights {
        Some(weights) => (errors * weights).mean(Kind::Float),
        None => errors.mean(Kind::Float),
    };
    let mut total = q.copy();
    if config.squared_reward > 0.0 {
        total += config.squared_reward * batch.reward.square().mean(Kind::Float);
    }
    if let Some(ends) = batch.all_terminal.as_ref().filter(|_| config.dense_terminal) {
        let errors = error(&q_values, &q_values.zeros_like(), config.loss) * ends;
        total += errors.sum(Kind::Float) / ends.sum(Kind::Float).clamp_min(1.0);
    }
    let reward = batch.all_rewards.as_ref().zip(rewards);
    let reward = reward.map(|(wanted, found)| found.mse_loss(wanted, Reduction::Mean));
    if let Some(reward) = &reward {
        total += config.reward_prediction * reward;
    }
    LossParts { total, q, reward, errors: (taken - wanted).detach() }
}
