//! A trained network as a policy.

use std::path::Path;
use std::sync::{Arc, Mutex};

use rayon::prelude::*;
use tch::Device;

use super::batch::{encode_views, flags};
use super::checkpoint::load_weights;
use super::damage::CheckpointError;
use super::network::{QNetwork, best};
use crate::config::{RlConfig, TrainConfig};
use crate::rl::policy::{MakePolicy, Policy, View};
use crate::rl::{ActionSet, StateEncoder, World};

/// States that go through the network at a time, at most. Fewer are filled up to a multiple of an
/// eighth: oneDNN compiles kernels for each number of states that it meets.
const CHUNK: usize = 128;

/// A network that predicts waypoints on any map of its size.
#[derive(Debug)]
pub struct Agent {
    shared: Arc<Shared>,
    choice: Choice,
    /// The same network by its other head, if it has one.
    predictor: Option<Box<Agent>>,
}

/// Which head a waypoint is chosen by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Choice {
    QValues,
    HoleChance,
}

/// What both choices have in common.
#[derive(Debug)]
struct Shared {
    networks: Networks,
    device: Device,
    encoder: StateEncoder,
    mask_actions: bool,
    avoid_visited: bool,
    /// Cells along a side of the maps that it was trained on, and metres along a cell, if that is known.
    trained_on: Option<(usize, f64)>,
}

/// A network and copies of it, one for each prediction that is under way: tensors cannot be shared between
/// threads. Flights over several maps, and parts of large batches, go on side by side, which keeps more cores
/// busy than all of them on one prediction after the other.
#[derive(Debug)]
struct Networks {
    first: Mutex<QNetwork>,
    idle: Mutex<Vec<QNetwork>>,
}

impl Networks {
    /// Lends a network that nobody else has.
    fn lend<T>(&self, predict: impl FnOnce(&QNetwork) -> T) -> T {
        let expected = "no prediction panics";
        let idle = self.idle.lock().expect(expected).pop();
        let network = idle.unwrap_or_else(|| self.first.lock().expect(expected).duplicate());
        let predicted = predict(&network);
        self.idle.lock().expect(expected).push(network);
        predicted
    }
}

/// Keeps libtorch to the thread that asks, if that is one of rayon's: it starts threads of its own for each of
/// those that ask otherwise, which then wait for each other.
fn stay_on_this_thread() {
    if rayon::current_thread_index().is_some() && tch::get_num_threads() != 1 {
        tch::set_num_threads(1);
    }
}

impl Agent {
    /// A network as it is, for maps of `cells` × `cells`.
    #[must_use]
    pub fn new(network: QNetwork, cells: usize, rl: &RlConfig, train: &TrainConfig) -> Self {
        Self::of(network, cells, rl, train, None)
    }

    fn of(
        network: QNetwork,
        cells: usize,
        rl: &RlConfig,
        train: &TrainConfig,
        trained_on: Option<(usize, f64)>,
    ) -> Self {
        let predicts_holes = network.predicts_holes();
        let shared = Arc::new(Shared {
            device: network.device(),
            networks: Networks { first: Mutex::new(network), idle: Mutex::default() },
            encoder: StateEncoder::new(cells, rl, train),
            mask_actions: train.mask_actions,
            avoid_visited: train.avoid_visited,
            trained_on,
        });
        let predictor = predicts_holes.then(|| {
            let shared = Arc::clone(&shared);
            Box::new(Self { shared, choice: Choice::HoleChance, predictor: None })
        });
        Self { shared, choice: Choice::QValues, predictor }
    }

    /// The weights of a checkpoint, for maps of `cells` × `cells`.
    ///
    /// # Errors
    /// [`CheckpointError`] if the checkpoint cannot be read, or is for maps or moves of another size.
    pub fn load(
        checkpoint: &Path,
        cells: usize,
        config: &RlConfig,
        device: Device,
    ) -> Result<Self, CheckpointError> {
        let (train, network, grid) = load_weights(checkpoint, cells, config, device)?;
        Ok(Self::of(network, cells, config, &train, Some(grid)))
    }

    /// Cells along a side of the maps that it was trained on, and metres along a cell, if it was loaded.
    #[must_use]
    pub fn trained_on(&self) -> Option<(usize, f64)> {
        self.shared.trained_on
    }

    /// Equation 12: the action of the greatest Q-value, or of the greatest P(hole), of
    /// those that the network was trained to choose among.
    fn waypoints(&self, views: &[View<'_, '_>]) -> Vec<[f64; 2]> {
        let Shared { networks, device, encoder, mask_actions, .. } = &*self.shared;
        stay_on_this_thread();
        let count = views.len().next_multiple_of(CHUNK / 8);
        let [map, window] = encode_views(encoder, views, count, *device);
        let actions = encoder.actions();
        let masked = *mask_actions || self.choice == Choice::HoleChance;
        let sets: Vec<ActionSet> = views.iter().map(|view| self.allowed(view)).collect();
        let allowed = masked.then(|| flags(sets.iter(), actions.count(), *device));
        let forward = |network: &QNetwork| {
            let outputs = network.forward(&network.inputs(&map, &window));
            let values = match self.choice {
                Choice::QValues => outputs.q,
                Choice::HoleChance => outputs.holes.expect("there is a head for it"),
            };
            best(&values.narrow(0, 0, views.len() as i64), allowed.as_ref())
        };
        let best = networks.lend(|network| tch::no_grad(|| forward(network)));
        let best = Vec::<i64>::try_from(&best).expect("an action for each");
        let pairs = views.iter().zip(best);
        pairs
            .map(|(view, at)| (view.flight.cell() + actions.offset(at as usize)).center())
            .collect()
    }

    /// The actions that may be chosen.
    fn allowed(&self, view: &View<'_, '_>) -> ActionSet {
        if self.shared.avoid_visited || self.choice == Choice::HoleChance {
            view.unvisited()
        } else {
            view.permissible().into_owned()
        }
    }
}

impl MakePolicy for Agent {
    fn policy<'a>(&'a self, _: &World) -> Box<dyn Policy + 'a> {
        Box::new(Flown(self))
    }

    fn predictor(&self) -> Option<&dyn MakePolicy> {
        self.predictor.as_deref().map(|predictor| predictor as _)
    }
}

/// An agent on one map.
struct Flown<'a>(&'a Agent);

impl Policy for Flown<'_> {
    fn predict(&self, views: &mut [View<'_, '_>]) -> Vec<[f64; 2]> {
        views.par_chunks(CHUNK).flat_map_iter(|views| self.0.waypoints(views)).collect()
    }
}
