//! `manifest.json` of an evaluation: what it was made from. The figures are in `report.json`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Manifest, Software};
use crate::config::{EvaluateConfig, RlConfig};
use crate::store::Digest;

/// The manifest that `holescout evaluate` writes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EvaluationManifest {
    /// Always `evaluation.v1`.
    #[schemars(extend("const" = "evaluation.v1"))]
    pub schema: String,
    /// SHA-256 over everything that the output depends on.
    pub fingerprint: String,
    /// The program that wrote it.
    pub software: Software,
    /// The dataset's manifest.
    pub dataset: Digest,
    /// SHA-256 of the weights of the method `agent`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub policy_sha256: Option<String>,
    /// `train`, `val`, `test` or `all`.
    pub split: String,
    /// The task.
    pub rl: RlConfig,
    /// How policies were judged.
    pub evaluate: EvaluateConfig,
}

impl Manifest for EvaluationManifest {
    const SCHEMA: &'static str = "evaluation.v1";
    const COMMAND: &'static str = "evaluate";
}
