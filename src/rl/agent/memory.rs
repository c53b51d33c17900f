//! The memory that training takes, known before it begins.

use sysinfo::System;
use tch::Device;

use super::inputs::ShapeError;
use super::network::{QNetwork, activations};
use crate::config::{Config, Split};
use crate::dataset::Dataset;
use crate::error::{Fault, HasFault};
use crate::rl::{MapPool, ReplayBuffer, StateEncoder, World};

/// Copies of a batch's states that are there at a time: in buffers, as tensors, as computed with.
const STATE_COPIES: usize = 4;
/// Copies of what layers make of them: results, gradients, what is kept for the next batch.
const LAYER_COPIES: usize = 3;

/// There is too little memory.
#[derive(Debug, thiserror::Error)]
#[error(
    "training needs about {} MB ({} MB maps, {} MB replay, {} MB network and batch), {} MB are free: \
     lower train.map_memory_mb, train.buffer_size or train.batch_size",
    mb(need.bytes()), mb(need.map_bytes), mb(need.replay_bytes), mb(need.network_bytes), mb(*free)
)]
pub struct MemoryError {
    /// What it needs.
    pub need: MemoryNeed,
    /// What is free, in bytes.
    pub free: usize,
}

fn mb(bytes: usize) -> usize {
    bytes.div_ceil(1_000_000)
}

impl HasFault for MemoryError {
    fn fault(&self) -> Fault {
        Fault::Running
    }
}

/// Memory in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MemoryNeed {
    /// Maps to train on and to be judged on.
    pub map_bytes: usize,
    /// Transitions and their priorities.
    pub replay_bytes: usize,
    /// Networks, optimiser, batches.
    pub network_bytes: usize,
}

impl MemoryNeed {
    /// What training on a dataset takes. A network on a graphics card takes nothing here.
    ///
    /// # Errors
    /// If the network does not fit the maps of the dataset.
    pub fn new(dataset: &Dataset, config: &Config, device: Device) -> Result<Self, ShapeError> {
        let Config { rl, train, .. } = config;
        let cells = dataset.manifest().cells as usize;
        let records = |split| dataset.ids_of(split).len();
        let budget = train.map_memory_mb as usize * 1_000_000;
        let train_bytes = MapPool::bytes(records(Split::Train), cells, budget);
        let judged = records(Split::Val).min(train.evaluate_maps as usize);
        let val_bytes = judged * World::bytes(cells);
        let (max_steps, replay) = (rl.max_steps as usize, train.buffer_size as usize);
        let network = QNetwork::new(cells, rl.reach_cells, train, Device::Cpu)?;
        let shapes = StateEncoder::new(cells, rl, train).shapes();
        let state = size_of::<f32>()
            * shapes.iter().map(|shape| shape.iter().product::<usize>()).sum::<usize>();
        // Policy, target, moments, gradients; each with a copy of 16 bits.
        let weights = 6 * 6 * network.size();
        let layers = size_of::<f32>() * activations(cells, rl.reach_cells, train);
        let sample = STATE_COPIES * 2 * state + LAYER_COPIES * layers;
        let batch = sample * train.batch_size.max(train.num_envs) as usize;
        Ok(Self {
            map_bytes: train_bytes + val_bytes,
            replay_bytes: ReplayBuffer::memory(replay, max_steps, train.priority_alpha),
            network_bytes: if device == Device::Cpu { weights + batch } else { 0 },
        })
    }

    /// All of it.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.map_bytes + self.replay_bytes + self.network_bytes
    }

    /// Demands that so much is free, within the limits of a container too.
    ///
    /// # Errors
    /// [`MemoryError`].
    pub fn demand(self) -> Result<(), MemoryError> {
        let mut system = System::new();
        system.refresh_memory();
        let limit = system.cgroup_limits().map_or(u64::MAX, |limits| limits.free_memory);
        let free = usize::try_from(system.available_memory().min(limit)).unwrap_or(usize::MAX);
        // Zero is what systems tell that do not know.
        if free > 0 && self.bytes() > free {
            return Err(MemoryError { need: self, free });
        }
        Ok(())
    }
}
