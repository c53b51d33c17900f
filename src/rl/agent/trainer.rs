//! The training loop: act, remember, learn.
//!
//! All randomness is keyed by what it is for and by a counter, so a run that goes on from a
//! checkpoint does what it would have done without the interruption, to the bit (on a CPU, with the
//! same number of threads).

use std::path::Path;
use std::sync::Arc;

use serde::Serialize;
use tch::Device;

use super::adam::Adam;
use super::batch::Batcher;
use super::checkpoint::{Checkpoint, CheckpointError, Run};
use super::ddqn::loss;
use super::network::{QNetwork, ShapeError};
use crate::config::{RlConfig, TrainConfig};
use crate::error::{Fault, HasFault};
use crate::rl::{Environment, NothingToLearn, Random, Replay, Transition, World};

const ACTING: u64 = 21;
const SAMPLING: u64 = 22;

/// Why training cannot begin or go on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainError {
    /// There is nothing to learn from.
    #[error(transparent)]
    NothingToLearn(#[from] NothingToLearn),
    /// The network does not fit the maps.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// A checkpoint cannot be written or used.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The loss is no number any more.
    #[error(
        "the loss became {loss} at update {update}: the last checkpoint is from before; \
         lower train.learning_rate or train.clip_norm"
    )]
    Diverged {
        /// The update.
        update: u64,
        /// The loss.
        loss: f64,
    },
}

impl HasFault for TrainError {
    fn fault(&self) -> Fault {
        match self {
            Self::NothingToLearn(error) => error.fault(),
            Self::Shape(error) => error.fault(),
            Self::Checkpoint(error) => error.fault(),
            Self::Diverged { .. } => Fault::Running,
        }
    }
}

/// What to train on and how.
#[derive(Debug, Clone, Copy)]
pub struct TrainJob<'a> {
    /// The maps.
    pub maps: &'a [Arc<World>],
    /// SHA-256 of the dataset's manifest.
    pub dataset_sha256: &'a str,
    /// The task.
    pub rl: &'a RlConfig,
    /// How to train.
    pub train: &'a TrainConfig,
}

/// How an update went.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Progress {
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
    /// Share of random actions.
    pub epsilon: f64,
    /// Mean return of the episodes that ended since the last update, not discounted.
    pub mean_return: Option<f64>,
}

/// Training under way.
#[derive(Debug)]
pub struct Trainer<'a> {
    job: TrainJob<'a>,
    environment: Environment,
    replay: Replay,
    batcher: Batcher,
    policy: QNetwork,
    target: QNetwork,
    adam: Adam,
    updates: u64,
    steps: u64,
    /// Best score on the validation split so far, and the update that had it.
    pub best: Option<(f64, u64)>,
    /// Returns of the running episodes; for the log only.
    returns: Vec<f64>,
}

impl<'a> Trainer<'a> {
    /// From the beginning.
    ///
    /// # Errors
    /// If there is nothing to learn, or the network does not fit the maps.
    pub fn new(job: TrainJob<'a>) -> Result<Self, TrainError> {
        let TrainJob { maps, rl, train, .. } = job;
        let episodes = train.episodes as usize;
        let environment = Environment::new(maps, episodes, rl.max_steps, train.seed)?;
        let cells = environment.maps()[0].cells();
        let network = || QNetwork::new(cells, rl.reach_cells, train, Device::Cpu);
        let (policy, target) = (network()?, network()?);
        Ok(Self {
            job,
            replay: Replay::new(train.replay as usize, cells, rl.max_steps as usize),
            batcher: Batcher::new(environment.maps(), rl, Device::Cpu),
            adam: Adam::new(policy.parameters()),
            policy,
            target,
            updates: 0,
            steps: 0,
            best: None,
            returns: vec![0.0; episodes],
            environment,
        })
    }

    /// From a checkpoint of the same run.
    ///
    /// # Errors
    /// As [`Trainer::new`], and if the checkpoint is damaged or of another run.
    pub fn resume(job: TrainJob<'a>, directory: &Path) -> Result<Self, TrainError> {
        let mut trainer = Self::new(job)?;
        let checkpoint = Checkpoint::read(directory)?;
        checkpoint.demand(directory, &trainer.run())?;
        let networks = [&mut trainer.policy, &mut trainer.target];
        checkpoint.restore_tensors(directory, networks, &mut trainer.adam)?;
        let damaged = |what: &str| CheckpointError::Format {
            path: directory.to_owned(),
            reason: format!("its {what} do not fit this run"),
        };
        if !trainer.environment.restore(&checkpoint.episodes) {
            return Err(damaged("episodes").into());
        }
        if !trainer.replay.restore(checkpoint.replay_added, checkpoint.replay.into_vec()) {
            return Err(damaged("transitions").into());
        }
        (trainer.updates, trainer.steps) = (checkpoint.updates, checkpoint.steps);
        trainer.best = checkpoint.best;
        Ok(trainer)
    }

    fn run(&self) -> Run<'a> {
        let TrainJob { rl, train, dataset_sha256, .. } = self.job;
        Run { rl, train, dataset_sha256 }
    }

    /// Writes a checkpoint.
    ///
    /// # Errors
    /// [`CheckpointError`]; nothing is left under the final name then.
    pub fn save(&self, directory: &Path) -> Result<(), CheckpointError> {
        let counters = [self.updates, self.steps];
        let (episodes, replay) = (self.environment.save(), self.replay.state());
        let checkpoint = Checkpoint::new(&self.run(), counters, self.best, episodes, replay);
        checkpoint.write(directory, [&self.policy, &self.target], &self.adam)
    }

    /// The network as it is now.
    #[must_use]
    pub fn policy(&self) -> &QNetwork {
        &self.policy
    }

    /// Updates done.
    #[must_use]
    pub fn updates(&self) -> u64 {
        self.updates
    }

    /// Bytes that the replay takes when it is full.
    #[must_use]
    pub fn replay_bytes(&self) -> usize {
        self.replay.stride() * self.job.train.replay as usize
    }

    /// Share of random actions now: all while the replay warms up, then falling along a line.
    #[must_use]
    pub fn epsilon(&self) -> f64 {
        let train = self.job.train;
        if self.replay.len() < train.warmup as usize {
            return 1.0;
        }
        let over = (train.epsilon_decay * train.updates as f64).max(1.0);
        let fallen = (self.updates as f64 / over).min(1.0);
        train.epsilon_start + (train.epsilon_end - train.epsilon_start) * fallen
    }

    /// One update: as many steps of all episodes as are due, then one step of Adam.
    ///
    /// # Errors
    /// [`TrainError::Diverged`] if the loss is no finite number; nothing is learned then.
    pub fn update(&mut self) -> Result<Progress, TrainError> {
        let train = self.job.train;
        let mut returns = Vec::new();
        while self.replay.len() < train.warmup as usize {
            self.act(&mut returns);
        }
        if self.updates.is_multiple_of(train.updates_per_step.into()) {
            self.act(&mut returns);
        }
        let mut random = Random::keyed(&[train.seed, SAMPLING, self.updates]);
        let transitions = self.replay.sample(train.batch as usize, &mut random);
        let batch = self.batcher.batch(&transitions, train.augment.then_some(&mut random));
        let parts = loss(&self.policy, &self.target, &batch, train);
        let total = parts.total.double_value(&[]);
        if !total.is_finite() {
            return Err(TrainError::Diverged { update: self.updates, loss: total });
        }
        parts.total.backward();
        let parameters = self.policy.parameters_mut();
        let norm = self.adam.step(parameters, train.learning_rate, train.clip_norm);
        let epsilon = self.epsilon();
        self.updates += 1;
        if self.updates.is_multiple_of(train.target_sync.into()) {
            self.target.copy_from(self.policy.parameters());
        }
        Ok(Progress {
            update: self.updates,
            steps: self.steps,
            loss: total,
            q_loss: parts.q.double_value(&[]),
            reward_loss: parts.reward.map(|reward| reward.double_value(&[])),
            gradient_norm: norm,
            epsilon,
            mean_return: (!returns.is_empty())
                .then(|| returns.iter().sum::<f64>() / returns.len() as f64),
        })
    }

    /// One step of all episodes, ε-greedy, into the replay.
    fn act(&mut self, returns: &mut Vec<f64>) {
        let train = self.job.train;
        let mut random = Random::keyed(&[train.seed, ACTING, self.steps]);
        let epsilon = self.epsilon();
        let slots = self.environment.len();
        let explores: Vec<bool> = (0..slots).map(|_| random.unit() < epsilon).collect();
        let greedy = self.greedy(&explores);
        let count = self.environment.actions().count();
        let actions: Vec<usize> = (0..slots)
            .map(|slot| {
                let set = self.environment.permissible(slot);
                match greedy[slot] {
                    Some(action) => action,
                    None if train.mask_actions => {
                        set.nth(random.below(set.count())).expect("to stay is permissible")
                    }
                    None => random.below(count),
                }
            })
            .collect();
        let before: Vec<(u32, Vec<crate::rl::Cell>)> = (0..slots)
            .map(|slot| {
                (self.environment.map(slot) as u32, self.environment.state(slot).1.to_vec())
            })
            .collect();
        let outcomes = self.environment.step(&actions);
        for (slot, ((map, visited), outcome)) in before.into_iter().zip(outcomes).enumerate() {
            self.replay.push(&Transition {
                map,
                visited,
                action: actions[slot],
                reward: outcome.reward,
                next: outcome.next,
                terminal: outcome.terminal,
            });
            self.returns[slot] += f64::from(outcome.reward);
            if outcome.terminal || outcome.truncated {
                returns.push(std::mem::take(&mut self.returns[slot]));
            }
        }
        self.steps += 1;
    }

    /// The best actions of the episodes that do not explore.
    fn greedy(&self, explores: &[bool]) -> Vec<Option<usize>> {
        let wanted: Vec<usize> = (0..explores.len()).filter(|&slot| !explores[slot]).collect();
        let mut actions = vec![None; explores.len()];
        if wanted.is_empty() {
            return actions;
        }
        let states: Vec<_> = wanted
            .iter()
            .map(|&slot| {
                let (map, visited) = self.environment.state(slot);
                (&**map, visited)
            })
            .collect();
        let [map, window] = self.batcher.states(&states);
        let q_values = tch::no_grad(|| self.policy.forward(&map, &window).0);
        let count = self.environment.actions().count();
        let mut values = vec![0.0_f32; wanted.len() * count];
        q_values.copy_data(&mut values, wanted.len() * count);
        for (&slot, values) in wanted.iter().zip(values.chunks_exact(count)) {
            let allowed = self.job.train.mask_actions.then(|| self.environment.permissible(slot));
            actions[slot] =
                Some(best(values, |action| allowed.is_none_or(|allowed| allowed.contains(action))));
        }
        actions
    }
}

/// The first of the allowed actions with the greatest value.
pub(super) fn best(values: &[f32], allowed: impl Fn(usize) -> bool) -> usize {
    let actions = (0..values.len()).filter(|&action| allowed(action)).rev();
    let best = actions.max_by(|&a, &b| values[a].total_cmp(&values[b]));
    best.expect("to stay is permissible")
}
