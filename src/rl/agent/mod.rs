//! The agent: a Q-network and Double DQN, with libtorch (feature `torch`).

mod adam;
mod batch;
mod centered;
mod checkpoint;
mod ddqn;
mod device;
mod encoding;
mod events;
mod export;
mod judgement;
mod layer;
mod memory;
mod network;
mod paper;
mod policy;
mod report;
mod session;
#[cfg(test)]
mod tests;
mod trainer;

pub use adam::Adam;
pub use batch::{All, Batch, Batcher, Next};
pub use checkpoint::{Checkpoint, CheckpointError, load_weights};
pub use ddqn::{LossParts, loss};
pub use device::{Computing, DeviceChoice, NoDevice, keep_freed_memory};
pub use export::{ExportError, export_policy};
pub use judgement::{Judgement, Mean};
pub use memory::{MemoryError, MemoryNeed};
pub use network::{Inputs, Outputs, QNetwork, ShapeError};
pub use policy::Agent;
pub use report::TrainReport;
pub use session::{Ended, Pace, SessionError, Watch, train};
pub use trainer::{TrainError, TrainJob, Trainer};
