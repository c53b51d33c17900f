//! Double DQN: target, loss and what is added to it, beside the paper's equations.

use tch::{Kind, Reduction, Tensor};

use super::batch::{Batch, Next};
use super::network::QNetwork;
use crate::config::{Loss, TrainConfig};

/// The parts of a loss.
#[derive(Debug)]
pub struct LossParts {
    /// What is minimised.
    pub total: Tensor,
    /// `L_1`, equation 14: the error of Q-values; in a factored network that of V.
    pub q: Tensor,
    /// Mean cross-entropy of P(hole), in nats, if there is a head for it.
    pub holes: Option<Tensor>,
    /// Mean squared error of the predicted rewards, if there is a head for them.
    pub rewards: Option<Tensor>,
    /// Mean error of the Q-values of all actions that end the episode, if they are taught.
    pub terminal: Option<Tensor>,
    /// By how much each transition's Q-value was wrong, `[batch]`, without gradient; not of a factored
    /// network, which does not look at all of them.
    pub errors: Option<Tensor>,
}

/// `Q_target(h', argmax_a' Q_policy(h', a'))` of the states after the steps, `[nexts]`: what
/// Equation 15 has after γ.
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

/// The error of V. The values of several moves of a state have much in common that nobody can know: that is
/// learned by the level, and how they differ by comparing them. One output for both would take what tells
/// states apart for what tells moves apart.
fn value_loss(
    following: &Tensor,
    level: &Tensor,
    values: &Tensor,
    batch: &Batch,
    loss: Loss,
) -> Tensor {
    let Next { of, action, .. } = &batch.next;
    let states = batch.reward.zeros_like();
    let counts = states.index_add(0, of, &values.ones_like());
    let mean = |values: &Tensor| states.index_add(0, of, values) / counts.clamp_min(1.0);
    let centred = |values: &Tensor| values - mean(values).index_select(0, of);
    let found = following.index_select(0, of).gather(1, &action.unsqueeze(1), false).squeeze_dim(1);
    let advantages = found - level.squeeze_dim(1).index_select(0, of);
    let has = counts.clamp_max(1.0);
    let levels = (level.squeeze_dim(1) + mean(&advantages.detach())) * &has;
    let of_levels = error(&levels, &mean(values), loss);
    let of_moves = error(&centred(&advantages), &centred(values), loss);
    of_levels.sum(Kind::Float) / has.sum(Kind::Float).clamp_min(1.0)
        + of_moves.sum(Kind::Float) / (of.numel() as f64).max(1.0)
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

/// `L = L_1 + α r²`, equation 16, and what is added beyond the paper: the cross-entropy of
/// P(hole) over the moves that may be chosen, the errors of predicted rewards of all actions, and of
/// Q-values of all actions that end the episode. A state that ends the episode at a hole has no value:
/// `y = r + γ Q_target(h', ·)`, equation 15, is r there. `weights`, `[batch]`, are those of
/// prioritised replay.
///
/// A factored network learns `Q_target(h', ·)` itself, as V of moves that go on: how likely they are to go on is
/// what P(hole) says.
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
    let outputs = policy.forward(&policy.inputs(&batch.map, &batch.window));
    let taken = |of: &Tensor| of.gather(1, &batch.action.unsqueeze(1), false).squeeze_dim(1);
    let (q, errors) = if let Some(level) = &outputs.level {
        let following = outputs.following.as_ref().expect("the network is factored");
        (value_loss(following, level, &values, batch, config.loss), None)
    } else {
        let wanted = batch.reward.index_add(0, &next.of, &(&next.discount * &values));
        let taken_q = taken(&outputs.q);
        let errors = error(&taken_q, &wanted, config.loss);
        let q = match weights {
            Some(weights) => (errors * weights).mean(Kind::Float),
            None => errors.mean(Kind::Float),
        };
        (q, Some((taken_q - wanted).detach()))
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
    LossParts { total, q, holes, rewards, terminal, errors }
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;

    /// Of three states the first has two moves, the second one.
    #[test]
    fn levels_and_differences_are_learned_apart() {
        let zeros = |shape: &[i64]| Tensor::zeros(shape, (Kind::Float, Device::Cpu));
        let advantages = zeros(&[3, 4]).set_requires_grad(true);
        let level = zeros(&[3, 1]).set_requires_grad(true);
        let next = Next {
            of: Tensor::from_slice(&[0_i64, 0, 1]),
            action: Tensor::from_slice(&[1_i64, 3, 2]),
            map: zeros(&[0]),
            window: zeros(&[0]),
            allowed: zeros(&[0]),
            discount: zeros(&[0]),
        };
        let [map, window, action] = [(); 3].map(|()| zeros(&[0]));
        let batch = Batch { map, window, action, reward: zeros(&[3]), next, all: None };
        let values = Tensor::from_slice(&[-0.5_f32, -0.3, -1.0]);
        let following = &advantages + &level;
        let loss = value_loss(&following, &level, &values, &batch, Loss::Squared);
        loss.backward();
        let close = |found: &Tensor, expected: &[f32]| {
            let found = Vec::<f32>::try_from(&found.flatten(0, -1)).expect("numbers");
            let off = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(found.len() == expected.len() && off < 1e-6, "{found:?}");
        };
        close(&loss, &[0.58 + 0.02 / 3.0]);
        close(&level.grad(), &[0.4, 1.0, 0.0]);
        let mut expected = [0.0; 12];
        (expected[1], expected[3]) = (0.2 / 3.0, -0.2 / 3.0);
        close(&advantages.grad(), &expected);
    }
}
