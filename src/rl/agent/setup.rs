//! What a trainer is told.

use tch::Device;

use crate::config::{RlConfig, TrainConfig};

/// What to train on and how.
#[derive(Debug, Clone, Copy)]
pub struct TrainerSetup<'a> {
    /// SHA-256 of the dataset's manifest.
    pub dataset_sha256: &'a str,
    /// The task.
    pub rl: &'a RlConfig,
    /// How to train.
    pub train: &'a TrainConfig,
    /// Where to compute.
    pub device: Device,
}
