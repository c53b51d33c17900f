//! `manifest.json` of an exported policy.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Manifest, Software};
use crate::config::{RlConfig, TrainConfig};

/// The manifest that `holescout export-policy` writes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PolicyManifest {
    /// Always `policy.v4`.
    #[schemars(extend("const" = "policy.v4"))]
    pub schema: String,
    /// SHA-256 over everything that the output depends on.
    pub fingerprint: String,
    /// The program that wrote it.
    pub software: Software,
    /// SHA-256 of `weights.safetensors`.
    pub weights_sha256: String,
    /// Number of parameters.
    pub parameters: u64,
    /// Cells along a side of the maps that it takes (L).
    pub cells: u32,
    /// Side of a cell, in metres.
    pub cell_m: f64,
    /// SHA-256 of the manifest of the dataset that it was trained on.
    pub dataset_sha256: String,
    /// Updates after which it was taken.
    pub updates: u64,
    /// Mean precision after a few steps on the validation split or a sample of it, if it was judged
    /// then: the greatest of all while it was trained, and so optimistic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub score: Option<f64>,
    /// The task.
    pub rl: RlConfig,
    /// How it was trained.
    pub train: TrainConfig,
}

impl Manifest for PolicyManifest {
    const SCHEMA: &'static str = "policy.v4";
    const COMMAND: &'static str = "export-policy";
}

impl PolicyManifest {
    /// Name of the file of weights.
    pub const WEIGHTS: &'static str = "weights.safetensors";
}
