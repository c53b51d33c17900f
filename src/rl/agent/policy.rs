//! A trained network as a policy.

use std::path::Path;
use std::sync::{Arc, Mutex};

use tch::Device;

use super::batch::Batcher;
use super::checkpoint::{CheckpointError, load_weights};
use super::network::QNetwork;
use super::trainer::best;
use crate::config::{RlConfig, TrainConfig};
use crate::rl::policy::{MakePolicy, Policy, View};
use crate::rl::{Sight, World};

/// States that go through the network at a time.
const CHUNK: usize = 128;

/// A network that predicts waypoints on any map of its size.
#[derive(Debug)]
pub struct Agent {
    /// One prediction at a time: libtorch uses all cores for each.
    network: Mutex<QNetwork>,
    config: RlConfig,
    mask_actions: bool,
}

impl Agent {
    /// A network as it is.
    #[must_use]
    pub fn new(network: QNetwork, config: &RlConfig, mask_actions: bool) -> Self {
        Self { network: Mutex::new(network), config: config.clone(), mask_actions }
    }

    /// The weights of a checkpoint, for maps of `cells` × `cells`.
    ///
    /// # Errors
    /// [`CheckpointError`] if the checkpoint cannot be read, or is for maps or moves of another size.
    pub fn load(
        checkpoint: &Path,
        cells: usize,
        config: &RlConfig,
    ) -> Result<Self, CheckpointError> {
        let (train, network) = load_weights(checkpoint, cells, config, Device::Cpu)?;
        let TrainConfig { mask_actions, .. } = train;
        Ok(Self::new(network, config, mask_actions))
    }
}

impl MakePolicy for Agent {
    fn policy<'a>(&'a self, known: &World) -> Box<dyn Policy + 'a> {
        let maps = [Arc::new(known.clone())];
        let batcher = Batcher::new(&maps, &self.config, Device::Cpu);
        let sight = Sight::new(self.config.reach_cells);
        Box::new(OnMap { agent: self, batcher, sight })
    }
}

/// An agent on one map.
struct OnMap<'a> {
    agent: &'a Agent,
    batcher: Batcher,
    sight: Sight,
}

impl Policy for OnMap<'_> {
    fn predict(&self, views: &mut [View<'_, '_>]) -> Vec<[f64; 2]> {
        views.chunks(CHUNK).flat_map(|views| self.predict_chunk(views)).collect()
    }
}

impl OnMap<'_> {
    /// `eqn:predicted_location`: the action of the greatest Q-value, of the permissible ones if
    /// the network was trained so.
    fn predict_chunk(&self, views: &[View<'_, '_>]) -> Vec<[f64; 2]> {
        let [map, window] = self.batcher.measured_states(views);
        let q_values = tch::no_grad(|| {
            let network = self.agent.network.lock().expect("no prediction panics");
            network.forward(&map, &window).0
        });
        let count = self.sight.actions().count();
        let mut values = vec![0.0_f32; views.len() * count];
        q_values.copy_data(&mut values, views.len() * count);
        let waypoint = |(view, values): (&View<'_, '_>, &[f32])| {
            let permissible = view.permissible();
            let mask = self.agent.mask_actions;
            let action = best(values, |action| !mask || permissible.contains(action));
            (view.flight.cell() + self.sight.actions().offset(action)).center()
        };
        views.iter().zip(values.chunks_exact(count)).map(waypoint).collect()
    }
}
