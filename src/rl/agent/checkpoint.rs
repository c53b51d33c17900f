//! Checkpoints: everything that training goes on from, whole or absent.
//!
//! A checkpoint is a directory, written under a temporary name and renamed: `weights.safetensors` (the
//! policy, all that a user of it needs), `learning.safetensors` (target network, moments of Adam),
//! `state.msgpack` (configuration, dataset, counters, maps, episodes, replay) and `SHA256SUMS`, which
//! vouches for them.

use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;
use serde_json::{Value, json};
use tch::Device;

use super::adam::Adam;
use super::damage::{CheckpointError, SCHEMA, invalid};
use super::network::QNetwork;
use super::report::TotalsState;
use super::setup::TrainerSetup;
use super::tensors::{Tensors, named, pack};
use crate::config::{RlConfig, TrainConfig};
use crate::error::FileError;
use crate::manifest::{PolicyManifest, RunManifest, load};
use crate::rl::{EpisodeState, NStepBuffer, PoolState, World};
use crate::store::{MANIFEST, SUMS, SealError, read_sealed, sha256_bytes, write_sealed};

pub(super) const WEIGHTS: &str = PolicyManifest::WEIGHTS;
const LEARNING: &str = "learning.safetensors";
const STATE: &str = RunManifest::STATE;
/// Moments of Adam, all parameters in a row.
const FIRST: &str = "adam.first";
const SECOND: &str = "adam.second";

/// How far training is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Counters {
    /// Updates done.
    pub updates: u64,
    /// Steps of all episodes done.
    pub steps: u64,
}

/// What the validation split has told so far. It does not change what is learned.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Validation {
    /// Update after which the policy was judged last; 0 for never.
    pub judged: u64,
    /// Best score so far, and the update that had it.
    pub best: Option<(f64, u64)>,
    /// The scores behind it, of each map.
    pub best_scores: Vec<f64>,
    /// Judgements since then.
    pub since_best: u32,
}

/// What was lived through: maps, episodes under way, transitions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Memory {
    pub(super) pool: PoolState,
    pub(super) episodes: Vec<EpisodeState>,
    pub(super) recent: Vec<NStepBuffer>,
    pub(super) returns: Vec<f32>,
    pub(super) replay_added: u64,
    pub(super) replay: ByteBuf,
    pub(super) priorities: ByteBuf,
}

/// What training goes on from, beside the tensors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    schema: String,
    /// The task.
    pub rl: RlConfig,
    /// How it was trained.
    pub train: TrainConfig,
    /// SHA-256 of the dataset's manifest.
    pub dataset_sha256: String,
    /// Cells along a side of its maps.
    pub cells: u32,
    /// Side of a cell, in metres.
    pub cell_m: f64,
    /// How far.
    pub counters: Counters,
    /// How good.
    pub validation: Validation,
    pub(super) totals: TotalsState,
    pub(super) memory: Memory,
    adam_updates: i32,
    /// `rl` and `train` as they stand there: what is absent was not set, whatever is the default now.
    #[serde(skip)]
    stored: [Value; 2],
}

/// What all versions of a checkpoint hold.
#[derive(Deserialize)]
struct Stored {
    schema: String,
    rl: Value,
    train: Value,
}

/// Settings that may change from one session of a run to the next: they do not change what is learned.
const ONLY_WATCHED: [&str; 5] =
    ["checkpoint_every", "evaluate_every", "evaluate_maps", "evaluate_starts", "patience"];

/// Which settings of a section differ, those that only one side has included.
fn differences(section: &str, expected: &Value, found: &Value) -> Vec<String> {
    let object = |value: &Value| value.as_object().cloned().unwrap_or_default();
    let (expected, found) = (object(expected), object(found));
    let keys: std::collections::BTreeSet<&String> = expected.keys().chain(found.keys()).collect();
    let told = |value: Option<&Value>| value.map_or_else(|| "absent".to_owned(), Value::to_string);
    keys.into_iter()
        .filter(|key| {
            !ONLY_WATCHED.contains(&key.as_str()) && expected.get(*key) != found.get(*key)
        })
        .map(|key| {
            let [here, there] = [expected.get(key), found.get(key)].map(told);
            format!("{section}.{key} is {here} here, {there} there")
        })
        .collect()
}

impl Checkpoint {
    pub(super) fn new(
        setup: &TrainerSetup<'_>,
        map: &World,
        counters: Counters,
        totals: TotalsState,
        memory: Memory,
    ) -> Self {
        Self {
            schema: SCHEMA.to_owned(),
            rl: setup.rl.clone(),
            train: setup.train.clone(),
            dataset_sha256: setup.dataset_sha256.to_owned(),
            cells: map.cells() as u32,
            cell_m: map.cell_m(),
            counters,
            validation: Validation::default(),
            totals,
            memory,
            adam_updates: 0,
            stored: [Value::Null, Value::Null],
        }
    }

    /// Writes a checkpoint; an older one of the same name is replaced.
    pub(super) fn write(
        mut self,
        directory: &Path,
        [policy, target]: [&QNetwork; 2],
        adam: &Adam,
    ) -> Result<(), CheckpointError> {
        let ([first, second], updates) = adam.state();
        self.adam_updates = updates;
        let mut learning = named(target, "target.");
        for (name, moment) in [(FIRST, first), (SECOND, second)] {
            learning.push((name.to_owned(), moment.shallow_clone()));
        }
        let state = rmp_serde::to_vec_named(&self).expect("writing to memory cannot fail");
        let [weights, learning] = [named(policy, ""), learning].map(|tensors| pack(&tensors));
        let files = [(WEIGHTS, &*weights), (LEARNING, &*learning), (STATE, &*state)];
        Ok(write_sealed(directory, &files)?)
    }

    /// Reads what is beside the tensors.
    ///
    /// # Errors
    /// [`CheckpointError`].
    pub fn read(directory: &Path) -> Result<Self, CheckpointError> {
        let path = directory.join(STATE);
        let bytes = match read_sealed(directory, STATE) {
            // Older versions have no list of checksums.
            Err(SealError::List { .. }) if !directory.join(SUMS).exists() => {
                std::fs::read(&path).map_err(FileError::new("read", &path))?
            }
            other => other?,
        };
        // What other versions keep is not what this one expects, so the version comes first.
        let Stored { schema, rl, train } =
            rmp_serde::from_slice(&bytes).map_err(|error| invalid(&path, &error))?;
        if schema != SCHEMA {
            return Err(CheckpointError::OtherVersion { path, found: schema });
        }
        if !directory.join(SUMS).exists() {
            return Err(SealError::List { path: directory.join(SUMS) }.into());
        }
        let read: Self = rmp_serde::from_slice(&bytes).map_err(|error| invalid(&path, &error))?;
        Ok(Self { stored: [rl, train], ..read })
    }

    /// Demands that it was made by this run.
    pub(super) fn demand(
        &self,
        directory: &Path,
        setup: &TrainerSetup<'_>,
    ) -> Result<(), CheckpointError> {
        let [rl, train] = &self.stored;
        let (expected, found) = (setup.dataset_sha256, &self.dataset_sha256);
        let dataset =
            (expected != found).then(|| format!("dataset is {expected:?} here, {found:?} there"));
        let settings = [("rl", json!(setup.rl), rl), ("train", json!(setup.train), train)];
        let settings = settings
            .iter()
            .flat_map(|(section, expected, found)| differences(section, expected, found));
        let differences: Vec<String> = dataset.into_iter().chain(settings).collect();
        if differences.is_empty() {
            return Ok(());
        }
        Err(CheckpointError::OtherRun { path: directory.to_owned(), differences })
    }

    /// Fills networks and optimiser with the tensors of the checkpoint.
    pub(super) fn restore_tensors(
        &self,
        directory: &Path,
        [policy, target]: [&mut QNetwork; 2],
        adam: &mut Adam,
    ) -> Result<(), CheckpointError> {
        let read = |name| Tensors::unpack(&directory.join(name), &read_sealed(directory, name)?);
        policy.set(&read(WEIGHTS)?.of(policy, "")?);
        let learning = read(LEARNING)?;
        target.set(&learning.of(target, "target.")?);
        let moment = |name| learning.find(name, policy.learned());
        adam.restore(&[moment(FIRST)?, moment(SECOND)?], self.adam_updates);
        Ok(())
    }
}

/// A policy that was trained: that of a checkpoint, or one that was exported.
pub(super) struct Trained {
    pub(super) rl: RlConfig,
    pub(super) train: TrainConfig,
    /// Cells along a side of the maps that it was trained on, and the side of a cell in metres.
    pub(super) grid: (usize, f64),
    /// `weights.safetensors`, which is what its list or manifest tells.
    pub(super) weights: Vec<u8>,
}

impl Trained {
    pub(super) fn read(directory: &Path) -> Result<Self, CheckpointError> {
        if directory.join(STATE).exists() || !directory.join(MANIFEST).exists() {
            let Checkpoint { rl, train, cells, cell_m, .. } = Checkpoint::read(directory)?;
            let weights = read_sealed(directory, WEIGHTS)?;
            return Ok(Self { rl, train, grid: (cells as usize, cell_m), weights });
        }
        let (manifest, _) = load::<PolicyManifest>(directory)?;
        let PolicyManifest { rl, train, weights_sha256, cells, cell_m, .. } = manifest;
        let path = directory.join(WEIGHTS);
        let weights = std::fs::read(&path).map_err(FileError::new("read", &path))?;
        if sha256_bytes(&weights).sha256 != weights_sha256 {
            return Err(invalid(&path, &"it is not the file that the manifest tells of"));
        }
        Ok(Self { rl, train, grid: (cells as usize, cell_m), weights })
    }

    /// The network, for maps of `cells` × `cells` and moves of a reach.
    pub(super) fn network(
        &self,
        directory: &Path,
        cells: usize,
        reach: u32,
        device: Device,
    ) -> Result<QNetwork, CheckpointError> {
        let mut network = QNetwork::new(cells, reach, &self.train, device)?;
        let weights = Tensors::unpack(&directory.join(WEIGHTS), &self.weights)?;
        network.set(&weights.of(&network, "")?);
        Ok(network)
    }

    /// Demands that states are made as the policy has learned to see them.
    fn demand_states(&self, directory: &Path, expected: &RlConfig) -> Result<(), CheckpointError> {
        let found = &self.rl;
        let pairs = [
            ("encoding_decay", expected.encoding_decay, found.encoding_decay),
            ("height_scale_m", expected.height_scale_m, found.height_scale_m),
            ("flight_height_m", expected.flight_height_m, found.flight_height_m),
            ("hole_threshold_dbm", expected.hole_threshold_dbm.0, found.hole_threshold_dbm.0),
            ("floor_dbm", expected.floor_dbm.0, found.floor_dbm.0),
        ];
        let different = pairs.into_iter().filter(|(_, expected, found)| expected != found);
        let differences: Vec<String> = different
            .map(|(key, expected, found)| format!("rl.{key} is {expected} here, {found} there"))
            .collect();
        if differences.is_empty() {
            return Ok(());
        }
        Err(CheckpointError::OtherStates { path: directory.to_owned(), differences })
    }
}

/// The policy of a checkpoint or an exported one, how it was trained, and on which maps: cells along a side,
/// and metres along a cell.
///
/// # Errors
/// [`CheckpointError`] if the checkpoint cannot be read, or does not fit maps of `cells` × `cells` and
/// the moves of the task.
pub fn load_weights(
    directory: &Path,
    cells: usize,
    config: &RlConfig,
    device: Device,
) -> Result<(TrainConfig, QNetwork, (usize, f64)), CheckpointError> {
    let trained = Trained::read(directory)?;
    trained.demand_states(directory, config)?;
    let network = trained.network(directory, cells, config.reach_cells, device)?;
    Ok((trained.train, network, trained.grid))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_that_only_one_side_has_are_differences() {
        let here = json!({ "seed": 1, "updates": 5, "patience": 1 });
        let there = json!({ "seed": 2, "older": true, "patience": 2 });
        let expected = [
            "train.older is absent here, true there",
            "train.seed is 1 here, 2 there",
            "train.updates is 5 here, absent there",
        ];
        assert_eq!(differences("train", &here, &there), expected);
    }
}
