//! Policies to be given away: weights, a manifest, a card that tells how to use them.

use std::path::Path;

use serde::Serialize;
use serde_json::json;

use super::checkpoint::{Checkpoint, Trained, WEIGHTS};
use super::damage::CheckpointError;
use crate::config::{Channel, Encoding, RlConfig, TrainConfig};
use crate::error::{Fault, FileError, HasFault};
use crate::manifest::{Manifest, PolicyManifest, Software, fingerprint, to_json};
use crate::rl::{CenteredEncoder, REWARD_STEP};
use crate::store::{Build, OutputError, sha256_bytes};

const CARD: &str = include_str!("model_card.md");
/// What is said of inputs, and how Q-values are computed, in either encoding.
const PAPER: &str = include_str!("model_card_paper.md");
const CENTERED: &str = include_str!("model_card_centered.md");
/// What divides the two.
const DIVISION: &str = "\n<!-- python -->\n";

/// Why a policy cannot be exported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// The checkpoint cannot be used.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The output directory cannot be used.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// A file cannot be read or written.
    #[error(transparent)]
    File(#[from] FileError),
}

impl HasFault for ExportError {
    fn fault(&self) -> Fault {
        match self {
            Self::Checkpoint(error) => error.fault(),
            Self::Output(error) => error.fault(),
            Self::File(error) => error.fault(),
        }
    }
}

/// Exports the policy of a checkpoint: `weights.safetensors`, the card `README.md`, `manifest.json`
/// and checksums. The same checkpoint gives the same bytes.
///
/// # Errors
/// [`ExportError`]; nothing is complete under the final name then.
pub fn export_policy(
    checkpoint: &Path,
    out: &Path,
    overwrite: bool,
) -> Result<PolicyManifest, ExportError> {
    let Checkpoint { dataset_sha256, counters, validation, cells, cell_m, .. } =
        Checkpoint::read(checkpoint)?;
    // Weights that do not fit are found here, and not by whom they are given to.
    let trained = Trained::read(checkpoint)?;
    let (side, device) = (cells as usize, tch::Device::Cpu);
    let network = trained.network(checkpoint, side, trained.rl.reach_cells, device)?;
    let Trained { rl, train, weights, .. } = trained;
    let weights_sha256 = sha256_bytes(&weights).sha256;
    let score = validation.best.filter(|&(_, update)| update == counters.updates);
    let manifest = PolicyManifest {
        schema: PolicyManifest::SCHEMA.to_owned(),
        fingerprint: fingerprint(&("policy", &weights_sha256, &dataset_sha256, &rl, &train)),
        software: Software::this(),
        weights_sha256,
        parameters: network.size() as u64,
        cells,
        cell_m,
        dataset_sha256,
        updates: counters.updates,
        score: score.map(|(score, _)| score),
        rl,
        train,
    };
    let output = Build::open_whole(out, "policy", &manifest.fingerprint, overwrite)?.begin()?;
    output.write(WEIGHTS, &weights)?;
    output.write("README.md", card(&manifest).as_bytes())?;
    output.complete(&to_json(&manifest))?;
    Ok(manifest)
}

/// The sections of a configuration that made a policy.
#[derive(Serialize)]
struct Sections<'a> {
    rl: &'a RlConfig,
    train: &'a TrainConfig,
}

/// The end of the Python function: from the channels of the last layer to Q-values.
fn values(train: &TrainConfig) -> String {
    let level = "    value = F.linear(hidden.mean((2, 3)), weights[\"value.weight\"], weights[\"value.bias\"])\n";
    if train.factored {
        let (step, discount) = (REWARD_STEP, train.gamma);
        let chance = "    hole = out[:, -1].sigmoid()  # the chance that a move leads to a hole\n";
        let q = format!("(1 - hole) * ({step} + {discount} * (out[:, 0] + value))");
        format!("{chance}{level}    return {q}")
    } else if train.dueling {
        format!("{level}    return out[:, 0] - out[:, 0].mean(1, keepdim=True) + value")
    } else {
        "    return out[:, 0]".to_owned()
    }
}

fn card(manifest: &PolicyManifest) -> String {
    let PolicyManifest { rl, train, software, cells, cell_m, .. } = manifest;
    let side = 2 * rl.reach_cells + 1;
    let score = manifest.score.map_or_else(String::new, |score| {
        format!(
            "Its mean precision after a few steps on the validation split (or a sample of it) was \
             {:.1} %: the best of all judgements while it was trained, and so optimistic.",
            100.0 * score
        )
    });
    let masked = if train.avoid_visited {
        " It was trained to choose among permissible moves to cells not yet visited only: leave the \
         others out before you take the greatest value."
    } else if train.mask_actions {
        " It was trained to choose among permissible moves only: leave the others out before you \
         take the greatest value."
    } else {
        ""
    };
    let config = toml::to_string(&Sections { rl, train }).expect("configurations are TOML");
    let parts = match train.encoding {
        Encoding::Paper => PAPER,
        Encoding::Centered => CENTERED,
    };
    let (inputs, python) = parts.split_once(DIVISION).expect("cards have two parts");
    let [coarse_count, fine_count] = train.inputs().map(|count| count.to_string());
    let names = |coarse_only: bool| {
        let shown = train.channels.iter().filter(|channel| !coarse_only || channel.is_coarse());
        let name = |channel: &Channel| format!("`{}`", json!(channel).as_str().unwrap_or_default());
        shown.map(name).collect::<Vec<_>>().join(", ")
    };
    let encoder = CenteredEncoder::new(*cells as usize, rl, &train.channels);
    let [_, [_, window, _]] = encoder.shapes();
    let values = [
        // What other values stand in comes first.
        ("inputs", inputs.trim_end().to_owned()),
        ("python", python.to_owned()),
        ("values", values(train)),
        ("coarse_count", coarse_count),
        ("fine_count", fine_count),
        ("coarse", names(true)),
        ("fine", names(false)),
        ("block", encoder.block().to_string()),
        ("window", window.to_string()),
        ("flight_height", rl.flight_height_m.to_string()),
        ("software", format!("{} {}", software.name, software.version)),
        ("parameters", manifest.parameters.to_string()),
        ("actions", (side * side).to_string()),
        ("updates", manifest.updates.to_string()),
        ("dataset", manifest.dataset_sha256.clone()),
        ("score", score),
        ("cells", cells.to_string()),
        ("cell_m", cell_m.to_string()),
        ("side", side.to_string()),
        ("decay", rl.encoding_decay.to_string()),
        ("floor", rl.floor_dbm.0.to_string()),
        ("threshold", format!("({})", rl.hole_threshold_dbm.0)),
        ("minus_threshold", (-rl.hole_threshold_dbm.0).to_string()),
        ("height_scale", rl.height_scale_m.to_string()),
        ("discount", train.gamma.to_string()),
        ("masked", masked.to_owned()),
        ("config", config),
    ];
    let fill = |card: String, (name, value): &(&str, String)| {
        card.replace(&format!("{{{{{name}}}}}"), value)
    };
    values.iter().fold(CARD.to_owned(), fill)
}
