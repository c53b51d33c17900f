//! `run.json` of a run of training.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Software;
use crate::config::{RlConfig, TrainConfig};
use crate::store::Digest;

/// What `holescout train` writes at the head of a run: what is trained on, and how. It marks the directory as a
/// run, too.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RunManifest {
    /// Always `run.v1`.
    #[schemars(extend("const" = "run.v1"))]
    pub schema: String,
    /// The program that wrote it.
    pub software: Software,
    /// The dataset's manifest.
    pub dataset: Digest,
    /// The task.
    pub rl: RlConfig,
    /// How it is trained.
    pub train: TrainConfig,
}

impl RunManifest {
    /// The value of `schema`.
    pub const SCHEMA: &'static str = "run.v1";
}
