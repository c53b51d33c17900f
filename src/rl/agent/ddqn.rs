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
    /// `L_1`, `eqn:ddqn_loss`: the error of Q-values; in a factored network that of V.
    pub q: Tensor,
    /// Mean cross-entropy of P(hole), in nats, if there is a head for it.
    pub holes: Option<Tensor>,
    /// Mean squared error of the predicted rewards, if there is a head for them.
    pub rewards: Option<Tensor>,
    /// Mean error of the Q-values of all actions that end the episode, if they are taught.
    pub terminal: Option<Tensor>,
    /// By how much each transition's Q-value was wrong, `[batch]`, without gradient.
    pub errors: Tensor,
}

/// `Q_target(h', argmax_a' Q_policy(h', a'))` of the states after the steps, `[nexts]`: what
/// `eq:discounted_reward` has after γ.
fn next_values(
    policy: &QNetwork,
    target_network: &QNetwork,
    batch: &Batch,
    config: &TrainConfig,
) -> Tensor {
    let next = &batch.next;
    if next.of.numel() == 0 {
        return next.discount.shallow_clone();
    }
    let inputs = policy.inputs(&next.map, &next.window);
    let allowed = config.mask_actions.then_some(&next.allowed);
    let actions = policy.best_actions(&inputs, allowed);
    target_network.values_of(&inputs, &actions)
}

fn error(found: &Tensor, wanted: &Tensor, loss: Loss) -> Tensor {
    match loss {
        Loss::Squared => found.mse_loss(wanted, Reduction::None),
        Loss::Huber => found.huber_loss(wanted, Reduction::None, 1.0),
    }
}

/// The mean of what is marked, over all rows together.
fn masked_mean(values: &Tensor, marks: &Tensor) -> Tensor {
    (values * marks).sum(Kind::Float) / marks.sum(Kind::Float).clamp_min(1.0)
}

/// The mean over states of the mean over the moves that are marked: all states count alike.
fn mean_of_states(values: &Tensor, marks: &Tensor) -> Tensor {
    let sum = |of: &Tensor| of.sum_dim_intlist(&[1_i64][..], false, Kind::Float);
    (sum(&(values * marks)) / sum(marks).clamp_min(1.0)).mean(Kind::Float)
}

/// `L = L_1 + α r²`, `eqn:final_loss`, and what is added beyond the paper: the cross-entropy of
/// P(hole) over the moves that may be chosen, the errors of predicted rewards of all actions, and of
/// Q-values of all actions that end the episode. A state that ends the episode at a hole has no value:
/// `y = r + γ Q_target(h', ·)`, `eq:discounted_reward`, is r there. `weights`, `[batch]`, are those of
/// prioritised replay.
///
/// A factored network learns `Q_target(h', ·)` itself, as V of the move taken, from the transitions
/// that go on: how likely they are to go on is what P(hole) says.
#[must_use]
pub fn loss(
    policy: &QNetwork,
    target_network: &QNetwork,
    batch: &Batch,
    weights: Option<&Tensor>,
    config: &TrainConfig,
) -> LossParts {
    let next = &batch.next;
    let values = tch::no_grad(|| next_values(policy, target_network, batch, config));
    let wanted = batch.reward.index_add(0, &next.of, &(&next.discount * &values));
    let outputs = policy.forward(&policy.inputs(&batch.map, &batch.window));
    let taken = |of: &Tensor| of.gather(1, &batch.action.unsqueeze(1), false).squeeze_dim(1);
    let taken_q = taken(&outputs.q);
    let q = if let Some(following) = &outputs.following {
        let errors = error(&taken(following).index_select(0, &next.of), &values, config.loss);
        let errors = match weights {
            Some(weights) => errors * weights.index_select(0, &next.of),
            None => errors,
        };
        errors.sum(Kind::Float) / (next.of.numel() as f64).max(1.0)
    } else {
        let errors = error(&taken_q, &wanted, config.loss);
        match weights {
            Some(weights) => (errors * weights).mean(Kind::Float),
            None => errors.mean(Kind::Float),
        }
    };
    let mut total = q.copy();
    if config.squared_reward > 0.0 {
        total += config.squared_reward * batch.reward.square().mean(Kind::Float);
    }
    let all = batch.all.as_ref();
    let terminal = all.filter(|_| config.dense_terminal).map(|all| {
        let errors = error(&outputs.q, &outputs.q.zeros_like(), config.loss);
        masked_mean(&errors, &all.terminal)
    });
    if let Some(terminal) = &terminal {
        total += terminal;
    }
    let rewards = all.zip(outputs.rewards.as_ref());
    let rewards = rewards.map(|(all, found)| found.mse_loss(&all.rewards, Reduction::Mean));
    if let Some(rewards) = &rewards {
        total += config.reward_prediction * rewards;
    }
    let holes = all.zip(outputs.holes.as_ref()).map(|(all, odds)| {
        let none = None::<&Tensor>;
        let errors =
            odds.binary_cross_entropy_with_logits(&all.terminal, none, none, Reduction::None);
        mean_of_states(&errors, &all.allowed)
    });
    if let Some(holes) = &holes {
        total += config.hole_prediction * holes;
    }
    let errors = (taken_q - wanted).detach();
    LossParts { total, q, holes, rewards, terminal, errors }
}
