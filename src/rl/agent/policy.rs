//! A trained network as a policy.

use std::path::Path;
use std::sync::{Arc, Mutex};

use tch::Device;

use super::batch::{encode_views, flags};
use super::checkpoint::{CheckpointError, load_weights};
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
    /// One prediction at a time: libtorch uses all cores for each.
    network: Mutex<QNetwork>,
    device: Device,
    encoder: StateEncoder,
    mask_actions: bool,
    avoid_visited: bool,
}

impl Agent {
    /// A network as it is, for maps of `cells` × `cells`.
    #[must_use]
    pub fn new(network: QNetwork, cells: usize, rl: &RlConfig, train: &TrainConfig) -> Self {
        let predicts_holes = network.predicts_holes();
        let shared = Arc::new(Shared {
            device: network.device(),
            network: Mutex::new(network),
            encoder: StateEncoder::new(cells, rl, train),
            mask_actions: train.mask_actions,
            avoid_visited: train.avoid_visited,
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
        let (train, network) = load_weights(checkpoint, cells, config, device)?;
        Ok(Self::new(network, cells, config, &train))
    }

    /// `eqn:predicted_location`: the action of the greatest Q-value, or of the greatest P(hole), of
    /// those that the network was trained to choose among.
    fn waypoints(&self, views: &[View<'_, '_>]) -> Vec<[f64; 2]> {
        let Shared { network, device, encoder, mask_actions, .. } = &*self.shared;
        let count = views.len().next_multiple_of(CHUNK / 8);
        let [map, window] = encode_views(encoder, views, count, *device);
        let actions = encoder.actions();
        let masked = *mask_actions || self.choice == Choice::HoleChance;
        let sets: Vec<ActionSet> = views.iter().map(|view| self.allowed(view)).collect();
        let allowed = masked.then(|| flags(sets.iter(), actions.count(), *device));
        let best = tch::no_grad(|| {
            let network = network.lock().expect("no prediction panics");
            let outputs = network.forward(&network.inputs(&map, &window));
            let values = match self.choice {
                Choice::QValues => outputs.q,
                Choice::HoleChance => outputs.holes.expect("there is a head for it"),
            };
            best(&values.narrow(0, 0, views.len() as i64), allowed.as_ref())
        });
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
        views.chunks(CHUNK).flat_map(|views| self.0.waypoints(views)).collect()
    }
}
