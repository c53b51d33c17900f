//! The agent: a Q-network and Double DQN, with libtorch (feature `torch`).

mod adam;
mod batch;
mod centered;
mod checkpoint;
mod damage;
mod ddqn;
mod device;
mod device_encoder;
mod export;
mod inputs;
mod layer;
mod memory;
mod network;
mod paper;
mod policy;
mod report;
mod setup;
mod tensors;
#[cfg(test)]
mod tests;
mod trainer;

pub use adam::Adam;
pub use batch::{All, Batch, Batcher, Next};
pub use checkpoint::{Checkpoint, Counters, Validation, load_weights};
pub use damage::CheckpointError;
pub use ddqn::{LossParts, loss};
pub use device::{Computing, DeviceChoice, NoDevice, keep_freed_memory, limit_threads};
pub use export::{ExportError, export_policy};
pub use inputs::{Inputs, ShapeError};
pub use memory::{MemoryError, MemoryNeed};
pub use network::{Outputs, QNetwork};
pub use policy::Agent;
pub use report::TrainReport;
pub use setup::TrainerSetup;
pub use trainer::{Trainer, TrainerError};
