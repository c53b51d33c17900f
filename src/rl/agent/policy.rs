//! A trained network as a policy.

use std::path::Path;
use std::sync::Mutex;

use tch::Device;

use super::batch::{encode_views, flags};
use super::checkpoint::{CheckpointError, load_weights};
use super::network::QNetwork;
use crate::config::RlConfig;
use crate::rl::policy::{MakePolicy, Policy, View};
use crate::rl::{Encoder, World};

/// States that go through the network at a time.
const CHUNK: usize = 128;

/// A network that predicts waypoints on any map of its size.
#[derive(Debug)]
pub struct Agent {
    /// One prediction at a time: libtorch uses all cores for each.
    network: Mutex<QNetwork>,
    device: Device,
    encoder: Encoder,
    mask_actions: bool,
}

impl Agent {
    /// A network as it is, for maps of `cells` × `cells`.
    #[must_use]
    pub fn new(network: QNetwork, cells: usize, config: &RlConfig, mask_actions: bool) -> Self {
        let (device, encoder) = (network.device(), Encoder::new(cells, config));
        Self { network: Mutex::new(network), device, encoder, mask_actions }
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
        Ok(Self::new(network, cells, config, train.mask_actions))
    }

    /// `eqn:predicted_location`: the action of the greatest Q-value, of the permissible ones if
    /// the network was trained so.
    fn waypoints(&self, views: &[View<'_, '_>]) -> Vec<[f64; 2]> {
        let [map, window] = encode_views(&self.encoder, views, self.device);
        let actions = self.encoder.actions();
        let sets: Vec<_> = views.iter().map(View::permissible).collect();
        let sets = sets.iter().map(AsRef::as_ref);
        let allowed = self.mask_actions.then(|| flags(sets, actions.count(), self.device));
        let best = {
            let network = self.network.lock().expect("no prediction panics");
            network.best_actions(&network.inputs(&map, &window), allowed.as_ref())
        };
        let best = Vec::<i64>::try_from(&best).expect("an action for each");
        let pairs = views.iter().zip(best);
        pairs
            .map(|(view, at)| (view.flight.cell() + actions.offset(at as usize)).center())
            .collect()
    }
}

impl MakePolicy for Agent {
    fn policy<'a>(&'a self, _: &World) -> Box<dyn Policy + 'a> {
        Box::new(Flown(self))
    }
}

/// An agent on one map.
struct Flown<'a>(&'a Agent);

impl Policy for Flown<'_> {
    fn predict(&self, views: &mut [View<'_, '_>]) -> Vec<[f64; 2]> {
        views.chunks(CHUNK).flat_map(|views| self.0.waypoints(views)).collect()
    }
}
