//! `run.json` of a run of training.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Manifest, Software};
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

impl Manifest for RunManifest {
    const SCHEMA: &'static str = "run.v1";
    const COMMAND: &'static str = "train";
}

/// The layout of a run.
impl RunManifest {
    /// Name of the file that it is in.
    pub const FILE: &'static str = "run.json";
    /// The directory of the last checkpoints, each named by its update.
    pub const CHECKPOINTS: &'static str = "checkpoints";
    /// The checkpoint with the best score.
    pub const BEST: &'static str = "best";
    /// In a checkpoint: configuration, counters, what was lived through.
    pub const STATE: &'static str = "state.msgpack";
    /// What was reported and judged.
    pub const LOG: &'static str = "log.jsonl";
}
