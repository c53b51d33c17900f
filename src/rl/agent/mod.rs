//! The agent: a Q-network and Double DQN, with libtorch (feature `torch`).

mod adam;
mod batch;
mod checkpoint;
mod ddqn;
mod network;
mod policy;
mod session;
#[cfg(test)]
mod tests;
mod trainer;

pub use adam::Adam;
pub use batch::{Batch, Batcher};
pub use checkpoint::{Checkpoint, CheckpointError, load_weights};
pub use ddqn::{LossParts, loss, target};
pub use network::{Computing, QNetwork, ShapeError};
pub use policy::Agent;
pub use session::{Ended, SessionError, Watch, train};
pub use trainer::{Progress as TrainProgress, TrainError, TrainJob, Trainer};
