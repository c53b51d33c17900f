//! `holescout train`: a run, which goes on where it was, and the policy that was best on the validation split.

mod directory;
mod error;
mod events;
mod judgement;
mod log;
mod stage;
mod validation;

pub use error::TrainError;
pub use judgement::{Judgement, Mean};
pub use stage::{Ended, TrainJob, train};
