//! From references in the replay to tensors: states are encoded when they are sampled.

use std::sync::Arc;

use rayon::prelude::*;
use tch::{Device, Tensor};

use crate::config::RlConfig;
use crate::rl::policy::View;
use crate::rl::{
    Cell, Encoder, Measurement, Random, Sight, State, Symmetry, Transition, World, rewards_into,
};

/// A batch of transitions; states as [`Encoder`] writes them.
#[derive(Debug)]
pub struct Batch {
    /// `I_A` before the step, `[batch, 3, L, L]`.
    pub map: Tensor,
    /// `I_B` before the step, `[batch, 3, 2l + 1, 2l + 1]`.
    pub window: Tensor,
    /// The actions taken, `[batch]`.
    pub action: Tensor,
    /// Their rewards, `[batch]`.
    pub reward: Tensor,
    /// 1 where the episode ended at a hole, `[batch]`.
    pub terminal: Tensor,
    /// `I_A` after the step.
    pub next_map: Tensor,
    /// `I_B` after the step.
    pub next_window: Tensor,
    /// 1 for actions that are permissible after the step, `[batch, actions]`.
    pub next_permissible: Tensor,
    /// The rewards of all actions before the step, `[batch, actions]`.
    pub all_rewards: Tensor,
    /// 1 for actions that would end the episode, `[batch, actions]`.
    pub all_terminal: Tensor,
}

/// Makes batches.
#[derive(Debug)]
pub struct Batcher {
    encoder: Encoder,
    sight: Sight,
    maps: Vec<Arc<World>>,
    cells: usize,
    device: Device,
}

/// The numbers of one sample, parts of the batch's buffers.
struct Sample<'a> {
    states: [(&'a mut [f32], &'a mut [f32]); 2],
    next_permissible: &'a mut [f32],
    rewards: &'a mut [f32],
    terminal: &'a mut [f32],
}

impl Batcher {
    /// For transitions over these maps, by their numbers; all have the same size.
    ///
    /// # Panics
    /// If there is no map.
    #[must_use]
    pub fn new(maps: &[Arc<World>], config: &RlConfig, device: Device) -> Self {
        let cells = maps.first().expect("there are maps").cells();
        let (encoder, sight) = (Encoder::new(cells, config), Sight::new(config.reach_cells));
        Self { encoder, sight, maps: maps.to_vec(), cells, device }
    }

    /// What a UAV has measured in cells of a map.
    fn measured(world: &World, cells: &[Cell]) -> Vec<Measurement> {
        let measure = |&cell: &Cell| Measurement { cell, rsrp_dbm: world.rsrp_dbm(cell) };
        cells.iter().map(measure).collect()
    }

    /// `I_A` and `I_B` of episodes, each a map and the visited cells.
    pub fn states(&self, states: &[(&World, &[Cell])]) -> [Tensor; 2] {
        let measured: Vec<(&World, Vec<Measurement>)> =
            states.iter().map(|&(world, cells)| (world, Self::measured(world, cells))).collect();
        let states = measured.iter().map(|(world, measured)| State::new(world, measured));
        self.encode(&states.collect::<Vec<_>>())
    }

    /// `I_A` and `I_B` of flights, with the levels that they have measured.
    pub fn measured_states(&self, views: &[View<'_, '_>]) -> [Tensor; 2] {
        let states = views.iter().map(|view| State::new(view.known, view.flight.measurements()));
        self.encode(&states.collect::<Vec<_>>())
    }

    fn encode(&self, states: &[State<'_>]) -> [Tensor; 2] {
        let mut maps = vec![0.0; states.len() * self.encoder.map_len()];
        let mut windows = vec![0.0; states.len() * self.encoder.window_len()];
        self.encoder.encode_batch(states, &mut maps, &mut windows);
        self.inputs(&maps, &windows)
    }

    fn inputs(&self, maps: &[f32], windows: &[f32]) -> [Tensor; 2] {
        let square = |numbers: &[f32], side: usize| {
            Tensor::from_slice(numbers)
                .reshape([-1, 3, side as i64, side as i64])
                .to_device(self.device)
        };
        [square(maps, self.cells), square(windows, self.sight.actions().side())]
    }

    /// A batch of transitions; with `augment` each is turned or flipped as the keyed random
    /// numbers tell.
    #[must_use]
    pub fn batch(&self, transitions: &[Transition], augment: Option<&mut Random>) -> Batch {
        let actions = self.sight.actions();
        let (map_len, window_len) = (self.encoder.map_len(), self.encoder.window_len());
        let count = transitions.len();
        let symmetries: Vec<Symmetry> = match augment {
            Some(random) => {
                (0..count).map(|_| Symmetry::new(random.below(Symmetry::COUNT))).collect()
            }
            None => vec![Symmetry::IDENTITY; count],
        };
        let buffer = |length: usize| vec![0.0_f32; count * length];
        let mut states = [0, 1].map(|_| (buffer(map_len), buffer(window_len)));
        let [mut next_permissible, mut rewards, mut terminal] =
            [(); 3].map(|()| buffer(actions.count()));
        let [before, after] = &mut states;
        let samples = before
            .0
            .par_chunks_exact_mut(map_len)
            .zip(before.1.par_chunks_exact_mut(window_len))
            .zip(
                after.0.par_chunks_exact_mut(map_len).zip(after.1.par_chunks_exact_mut(window_len)),
            )
            .zip(next_permissible.par_chunks_exact_mut(actions.count()))
            .zip(rewards.par_chunks_exact_mut(actions.count()))
            .zip(terminal.par_chunks_exact_mut(actions.count()));
        samples.zip(transitions).zip(&symmetries).for_each(
            |(((((states, next_permissible), rewards), terminal), transition), &symmetry)| {
                let states = [states.0, states.1];
                let sample = Sample { states, next_permissible, rewards, terminal };
                self.fill(sample, transition, symmetry);
            },
        );
        let per_action = |numbers: &[f32]| {
            Tensor::from_slice(numbers)
                .reshape([count as i64, actions.count() as i64])
                .to_device(self.device)
        };
        let each = |value: fn(&Transition) -> f32| {
            let values: Vec<f32> = transitions.iter().map(value).collect();
            Tensor::from_slice(&values).to_device(self.device)
        };
        let turned = transitions.iter().zip(&symmetries);
        let action: Vec<i64> = turned
            .map(|(transition, symmetry)| {
                let side = actions.side();
                let at =
                    Cell::new((transition.action / side) as i32, (transition.action % side) as i32);
                let at = symmetry.of(at, side);
                i64::from(at.row) * side as i64 + i64::from(at.column)
            })
            .collect();
        let [map, window] = self.inputs(&states[0].0, &states[0].1);
        let [next_map, next_window] = self.inputs(&states[1].0, &states[1].1);
        Batch {
            map,
            window,
            action: Tensor::from_slice(&action).to_device(self.device),
            reward: each(|transition| transition.reward),
            terminal: each(|transition| f32::from(u8::from(transition.terminal))),
            next_map,
            next_window,
            next_permissible: per_action(&next_permissible),
            all_rewards: per_action(&rewards),
            all_terminal: per_action(&terminal),
        }
    }

    fn fill(&self, sample: Sample<'_>, transition: &Transition, symmetry: Symmetry) {
        let world = &*self.maps[transition.map as usize];
        let (actions, side) = (self.sight.actions(), self.sight.actions().side());
        let mut visited = transition.visited.clone();
        let from = *visited.last().expect("a step begins somewhere");
        let [before, after] = sample.states;
        for (buffers, next) in [(before, None), (after, Some(transition.next))] {
            visited.extend(next);
            let measurements = &Self::measured(world, &visited);
            let state = State { world, measurements, symmetry };
            self.encoder.encode(state, buffers.0, buffers.1);
        }
        let count = actions.count();
        let (mut rewards, mut terminal) = (vec![0.0; count], vec![0.0; count]);
        let permissible = self.sight.permissible(world, from);
        rewards_into(&self.sight, world, from, &permissible, |action, reward, ends| {
            (rewards[action], terminal[action]) = (reward, f32::from(u8::from(ends)));
        });
        symmetry.copy(&rewards, sample.rewards, side);
        symmetry.copy(&terminal, sample.terminal, side);
        let mut allowed = vec![0.0; count];
        for action in self.sight.permissible(world, transition.next).iter() {
            allowed[action] = 1.0;
        }
        symmetry.copy(&allowed, sample.next_permissible, side);
    }
}
