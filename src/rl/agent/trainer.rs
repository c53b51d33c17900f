//! The training loop: act, remember, learn.
//!
//! All randomness is keyed by what it is for and by a counter, so a run that goes on from a
//! checkpoint does what it would have done without the interruption, to the bit (on a CPU, with the
//! same number of threads).

use std::borrow::Cow;
use std::path::Path;

use tch::Tensor;

use super::adam::Adam;
use super::batch::{Batcher, flags};
use super::checkpoint::{Checkpoint, Counters, Memory, Validation};
use super::damage::CheckpointError;
use super::ddqn::loss;
use super::device::upload;
use super::inputs::ShapeError;
use super::network::QNetwork;
use super::report::{Totals, TotalsState, TrainReport};
use super::setup::TrainerSetup;
use crate::config::TrainConfig;
use crate::error::{Fault, HasFault};
use crate::rl::{
    ActionSet, Cell, Environment, MapKey, MapPool, MapSource, NStepBuffer, NothingToLearn,
    PoolError, Random, ReplayBuffer,
};

const ACTING: u64 = 21;
const SAMPLING: u64 = 22;

/// Why training cannot begin or go on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainerError {
    /// There is nothing to learn from.
    #[error(transparent)]
    NothingToLearn(#[from] NothingToLearn),
    /// A map cannot be read.
    #[error(transparent)]
    Pool(#[from] PoolError),
    /// The network does not fit the maps.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// Cells of such maps have no number in the replay.
    #[error(
        "maps of {cells} × {cells} cells are too large for the replay, which takes {0} × {0}: choose \
         a smaller shard.downsample or grid.crop_m",
        ReplayBuffer::MAX_CELLS
    )]
    TooLarge {
        /// Cells along a side.
        cells: usize,
    },
    /// A checkpoint cannot be written or used.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The loss is no longer finite.
    #[error(
        "the loss or its gradient is no longer finite, shortly before update {update}: train into \
         another directory (--run) with a lower train.learning_rate or train.max_grad_norm"
    )]
    Diverged {
        /// Updates done.
        update: u64,
    },
}

impl HasFault for TrainerError {
    fn fault(&self) -> Fault {
        match self {
            Self::NothingToLearn(error) => error.fault(),
            Self::Pool(error) => error.fault(),
            Self::Shape(error) => error.fault(),
            Self::Checkpoint(error) => error.fault(),
            Self::TooLarge { .. } => Fault::Input,
            Self::Diverged { .. } => Fault::Running,
        }
    }
}

/// Training under way.
#[derive(Debug)]
pub struct Trainer<'a> {
    setup: TrainerSetup<'a>,
    pool: MapPool,
    environment: Environment,
    /// Steps that no transition begins with yet, and the return so far, of each episode.
    recent: Vec<NStepBuffer>,
    returns: Vec<f32>,
    replay: ReplayBuffer,
    batcher: Batcher,
    policy: QNetwork,
    target: QNetwork,
    adam: Adam,
    counters: Counters,
    totals: Totals,
}

impl<'a> Trainer<'a> {
    /// From the beginning.
    ///
    /// # Errors
    /// If there is nothing to learn, or the network does not fit the maps.
    pub fn new(setup: TrainerSetup<'a>, pool: MapPool) -> Result<Self, TrainerError> {
        let TrainerSetup { rl, train, device, .. } = setup;
        let (maps, episodes) = (pool.maps(), train.num_envs as usize);
        let environment = Environment::new(maps, episodes, rl.max_steps, train.seed);
        let cells = maps.cells();
        if cells > ReplayBuffer::MAX_CELLS {
            return Err(TrainerError::TooLarge { cells });
        }
        let network = || QNetwork::new(cells, rl.reach_cells, train, device);
        let (policy, target) = (network()?, network()?);
        let capacity = train.buffer_size as usize;
        Ok(Self {
            setup,
            environment,
            recent: vec![NStepBuffer::default(); episodes],
            returns: vec![0.0; episodes],
            replay: ReplayBuffer::new(capacity, cells, rl.max_steps as usize)
                .prioritised(train.priority_alpha),
            batcher: Batcher::new(maps, rl, train, device),
            adam: Adam::new(&policy),
            policy,
            target,
            counters: Counters::default(),
            totals: Totals::new(&TotalsState::default(), train, device),
            pool,
        })
    }

    /// From a checkpoint of the same run, with what the validation split had told by then.
    ///
    /// # Errors
    /// As [`Trainer::new`], and if the checkpoint is damaged or of another run.
    pub fn resume(
        setup: TrainerSetup<'a>,
        maps: MapSource,
        directory: &Path,
    ) -> Result<(Self, Validation), TrainerError> {
        let checkpoint = Checkpoint::read(directory)?;
        checkpoint.demand(directory, &setup)?;
        let damaged = |what: &str| CheckpointError::Format {
            path: directory.to_owned(),
            reason: format!("its {what} do not fit this run"),
        };
        let Memory { pool, episodes, recent, returns, replay_added, replay, priorities } =
            &checkpoint.memory;
        let pool = maps.restore(pool)?.ok_or_else(|| damaged("maps"))?;
        let mut trainer = Self::new(setup, pool)?;
        let networks = [&mut trainer.policy, &mut trainer.target];
        checkpoint.restore_tensors(directory, networks, &mut trainer.adam)?;
        let slots = trainer.environment.len();
        if !trainer.environment.restore(trainer.pool.maps(), episodes)
            || [recent.len(), returns.len()] != [slots; 2]
        {
            return Err(damaged("episodes").into());
        }
        if !trainer.replay.restore(*replay_added, replay.to_vec(), priorities) {
            return Err(damaged("transitions").into());
        }
        (trainer.recent, trainer.returns) = (recent.clone(), returns.clone());
        trainer.counters = checkpoint.counters;
        trainer.totals = Totals::new(&checkpoint.totals, setup.train, setup.device);
        Ok((trainer, checkpoint.validation))
    }

    /// Writes a checkpoint, with what the validation split has told.
    ///
    /// # Errors
    /// [`TrainerError::Diverged`] if what was learned is not worth keeping, or [`CheckpointError`];
    /// nothing is left under the final name then.
    pub fn save(&self, directory: &Path, validation: &Validation) -> Result<(), TrainerError> {
        let update = self.counters.updates;
        let totals = self.totals.state().ok_or(TrainerError::Diverged { update })?;
        let (replay_added, replay, priorities) = self.replay.state();
        let memory = Memory {
            pool: self.pool.state(),
            episodes: self.environment.save(),
            recent: self.recent.clone(),
            returns: self.returns.clone(),
            replay_added,
            replay: replay.to_vec().into(),
            priorities: priorities.into(),
        };
        let mut checkpoint = Checkpoint::new(
            &self.setup,
            &self.pool.maps().all()[0].1,
            self.counters,
            totals,
            memory,
        );
        checkpoint.validation.clone_from(validation);
        checkpoint.write(directory, [&self.policy, &self.target], &self.adam)?;
        Ok(())
    }

    /// The network as it is now.
    #[must_use]
    pub fn policy(&self) -> &QNetwork {
        &self.policy
    }

    /// The maps.
    #[must_use]
    pub fn pool(&self) -> &MapPool {
        &self.pool
    }

    /// Updates done.
    #[must_use]
    pub fn updates(&self) -> u64 {
        self.counters.updates
    }

    /// How it went since the last report.
    ///
    /// # Errors
    /// [`TrainerError::Diverged`] if the loss is no longer finite.
    pub fn report(&mut self) -> Result<TrainReport, TrainerError> {
        let (epsilon, Counters { updates, steps, .. }) = (self.epsilon(), self.counters);
        let report = self.totals.take([updates, steps], epsilon);
        report.ok_or(TrainerError::Diverged { update: updates })
    }

    /// Share of random actions now: all while the replay warms up, then falling along a line.
    #[must_use]
    pub fn epsilon(&self) -> f64 {
        let train = self.setup.train;
        if self.replay.len() < train.learning_starts as usize {
            return 1.0;
        }
        let over = (train.exploration_fraction * train.updates as f64).max(1.0);
        let fallen = (self.counters.updates as f64 / over).min(1.0);
        train.start_e + (train.end_e - train.start_e) * fallen
    }

    /// How far weights make good for prioritised sampling now: from `train.priority_beta` to 1.
    fn beta(&self) -> f64 {
        let TrainConfig { updates, priority_beta: first, .. } = *self.setup.train;
        let done = (self.counters.updates as f64 / updates as f64).min(1.0);
        first + (1.0 - first) * done
    }

    /// The learning rate now.
    fn learning_rate(&self) -> f64 {
        let train = self.setup.train;
        let done = self.counters.updates as f64 / train.updates as f64;
        let left = if train.anneal_learning_rate { (1.0 - done).max(0.0) } else { 1.0 };
        train.learning_rate * left
    }

    /// One update: as many steps of all episodes as are due, then one step of Adam.
    ///
    /// # Errors
    /// If a map cannot be read.
    pub fn update(&mut self) -> Result<(), TrainerError> {
        let train = self.setup.train;
        while self.replay.len() < train.learning_starts as usize {
            self.act()?;
        }
        if self.counters.updates.is_multiple_of(train.gradient_steps.into()) {
            self.act()?;
        }
        // Maps that were just replaced have taken their transitions along.
        while self.learnable() < train.batch_size as usize {
            self.act()?;
        }
        self.learn();
        Ok(())
    }

    /// Transitions on maps that are in memory.
    fn learnable(&self) -> usize {
        if !self.pool.is_streamed() {
            return self.replay.len();
        }
        self.pool.maps().all().iter().map(|&(key, _)| self.replay.on_map(key)).sum()
    }

    /// One step of Adam on sampled transitions.
    ///
    /// # Panics
    /// If there are none yet.
    pub fn learn(&mut self) {
        let train = self.setup.train;
        let mut random = Random::keyed(&[train.seed, SAMPLING, self.counters.updates]);
        let (count, maps) = (train.batch_size as usize, self.pool.maps());
        let sample = self.replay.sample(count, self.beta(), |map| maps.contains(map), &mut random);
        let batch = self.batcher.batch(maps, &sample.transitions, train.augment, &mut random);
        let weights = sample.weights.map(|weights| upload(&weights, self.setup.device));
        let parts = loss(&self.policy, &self.target, &batch, weights.as_ref(), train);
        let gradients = Tensor::run_backward(&[&parts.total], self.policy.leaves(), false, false);
        let (rate, clip) = (self.learning_rate(), train.max_grad_norm);
        let norm = self.adam.step(&mut self.policy, &gradients, rate, clip);
        self.totals.add(&parts, &norm);
        if let Some(errors) = &parts.errors {
            let errors = Vec::<f32>::try_from(errors).expect("a row of numbers");
            self.replay.update_priorities(&sample.positions, &errors);
        }
        self.counters.updates += 1;
        if self.counters.updates.is_multiple_of(train.target_network_frequency.into()) {
            self.target.soft_update(&self.policy, train.tau);
        }
    }

    /// One step of all episodes, ε-greedy, into the replay.
    ///
    /// # Errors
    /// If a map cannot be read.
    pub fn act(&mut self) -> Result<(), PoolError> {
        let train = self.setup.train;
        let steps = self.counters.steps;
        let is_due = steps > 0 && steps.is_multiple_of(train.refresh_every.into());
        // A map that goes takes its transitions along: as long as there are too few, all stay.
        if is_due && self.learnable() >= train.batch_size as usize {
            self.refresh()?;
        }
        let mut random = Random::keyed(&[train.seed, ACTING, self.counters.steps]);
        let epsilon = self.epsilon();
        let slots = self.environment.len();
        let explores: Vec<bool> = (0..slots).map(|_| random.unit() < epsilon).collect();
        let greedy = self.greedy(&explores);
        let count = self.environment.actions().count();
        let actions: Vec<usize> = (0..slots)
            .map(|slot| match greedy[slot] {
                Some(action) => action,
                None if train.mask_actions => {
                    let set = self.allowed(slot);
                    set.nth(random.below(set.count())).expect("to stay is permissible")
                }
                None => random.below(count),
            })
            .collect();
        let before = (0..slots).map(|slot| self.environment.state(slot));
        let before: Vec<(MapKey, Vec<Cell>)> =
            before.map(|(map, visited)| (map, visited.to_vec())).collect();
        let outcomes = self.environment.step(self.pool.maps(), &actions);
        for (slot, ((map, mut path), outcome)) in before.into_iter().zip(outcomes).enumerate() {
            if greedy[slot].is_some() {
                self.totals.chose(path.contains(&outcome.next));
            }
            path.push(outcome.next);
            let ends = outcome.terminal || outcome.truncated;
            let step = (actions[slot], outcome.reward);
            let replay = &mut self.replay;
            let push = |transition| {
                let _ = replay.push(&transition);
            };
            let most = train.n_step as usize;
            self.recent[slot].step((map, &path), step, [ends, outcome.terminal], most, push);
            self.returns[slot] += outcome.reward;
            if ends {
                self.totals.ended(std::mem::take(&mut self.returns[slot]).into());
            }
        }
        self.counters.steps += 1;
        Ok(())
    }

    /// The actions that an episode may choose among.
    fn allowed(&self, slot: usize) -> Cow<'_, ActionSet> {
        let permissible = self.environment.permissible(slot);
        if self.setup.train.avoid_visited {
            let (_, visited) = self.environment.state(slot);
            Cow::Owned(permissible.unvisited(self.environment.actions(), visited))
        } else {
            Cow::Borrowed(permissible)
        }
    }

    /// Replaces a map if there are others. The episodes on it end there.
    fn refresh(&mut self) -> Result<(), PoolError> {
        let Some([gone, by]) = self.pool.refresh()? else { return Ok(()) };
        let maps = self.pool.maps();
        self.batcher.replace(maps, by);
        let Self { recent, returns, replay, .. } = self;
        self.environment.replace(maps, gone, by, |slot, visited| {
            returns[slot] = 0.0;
            let push = |transition| {
                let _ = replay.push(&transition);
            };
            recent[slot].cut((gone, visited), false, push);
        });
        Ok(())
    }

    /// The best actions of the episodes that do not explore.
    fn greedy(&self, explores: &[bool]) -> Vec<Option<usize>> {
        let wanted: Vec<usize> = (0..explores.len()).filter(|&slot| !explores[slot]).collect();
        let mut actions = vec![None; explores.len()];
        if wanted.is_empty() {
            return actions;
        }
        let states: Vec<_> = wanted.iter().map(|&slot| self.environment.state(slot)).collect();
        let [map, window] = self.batcher.states(self.pool.maps(), &states);
        let sets: Vec<_> = wanted.iter().map(|&slot| self.allowed(slot)).collect();
        let sets = sets.iter().map(AsRef::as_ref);
        let count = self.environment.actions().count();
        let allowed = self.setup.train.mask_actions.then(|| flags(sets, count, self.setup.device));
        let best = self.policy.best_actions(&self.policy.inputs(&map, &window), allowed.as_ref());
        let best = Vec::<i64>::try_from(&best).expect("an action for each");
        for (slot, action) in wanted.into_iter().zip(best) {
            actions[slot] = Some(action as usize);
        }
        actions
    }
}
