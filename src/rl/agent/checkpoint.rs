//! Checkpoints: everything that training goes on from, whole or absent.
//!
//! A checkpoint is a directory, written under a temporary name and renamed: `weights.safetensors` (the
//! policy, all that a user of it needs), `learning.safetensors` (target network, moments of Adam) and
//! `state.msgpack` (configuration, dataset, counters, maps, episodes, replay).

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;
use tch::{Device, Tensor};
use tempfile::TempDir;

use super::adam::Adam;
use super::network::{QNetwork, ShapeError};
use super::report::TotalsState;
use super::trainer::TrainJob;
use crate::config::{RlConfig, TrainConfig};
use crate::error::{Fault, FileError, HasFault};
use crate::manifest::{ManifestError, PolicyManifest, load};
use crate::rl::{EpisodeState, PoolState, Recent, World};
use crate::store::{MANIFEST, sha256_file, write_atomic};

/// What names of directories begin with that are not whole yet.
pub(super) const TEMPORARY: &str = ".holescout-checkpoint-";
const SCHEMA: &str = "checkpoint.v3";
pub(super) const WEIGHTS: &str = "weights.safetensors";
const LEARNING: &str = "learning.safetensors";
const STATE: &str = "state.msgpack";
/// Moments of Adam, all parameters in a row.
const FIRST: &str = "adam.first";
const SECOND: &str = "adam.second";

/// Why a checkpoint cannot be written or used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckpointError {
    /// Reading or writing failed.
    #[error(transparent)]
    File(#[from] FileError),
    /// A file is not what it should be.
    #[error("{}: {reason}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// It is of another run.
    #[error(
        "{}: the checkpoint is of another run: {}; train into another directory, or with the \
         dataset and configuration of this one", path.display(), differences.join("; ")
    )]
    OtherRun {
        /// The checkpoint.
        path: PathBuf,
        /// What differs: key, expected, found.
        differences: Vec<String>,
    },
    /// It was trained on states that are encoded otherwise.
    #[error(
        "{}: the policy sees states otherwise: {}; evaluate it with its own settings",
        path.display(), differences.join("; ")
    )]
    OtherEncoding {
        /// The checkpoint.
        path: PathBuf,
        /// What differs: key, expected, found.
        differences: Vec<String>,
    },
    /// The manifest of an exported policy cannot be used.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// The network does not fit the maps.
    #[error(transparent)]
    Shape(#[from] ShapeError),
}

impl HasFault for CheckpointError {
    fn fault(&self) -> Fault {
        match self {
            Self::File(error) => error.fault(),
            Self::Manifest(error) => error.fault(),
            Self::Shape(error) => error.fault(),
            Self::Format { .. } | Self::OtherRun { .. } | Self::OtherEncoding { .. } => {
                Fault::Input
            }
        }
    }
}

/// How far training is.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Counters {
    /// Updates done.
    pub updates: u64,
    /// Steps of all episodes done.
    pub steps: u64,
    /// Best score on the validation split so far, and the update that had it.
    pub best: Option<(f64, u64)>,
    /// Judgements since then.
    pub judged_since_best: u32,
}

/// What was lived through: maps, episodes under way, transitions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Memory {
    pub(super) pool: PoolState,
    pub(super) episodes: Vec<EpisodeState>,
    pub(super) recent: Vec<Recent>,
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
    /// Scores of the best policy so far, for each map of the validation split.
    pub(super) best_scores: Vec<f64>,
    pub(super) totals: TotalsState,
    pub(super) memory: Memory,
    adam_updates: i32,
}

/// What all versions of a checkpoint begin with.
#[derive(Deserialize)]
struct Version {
    schema: String,
}

fn invalid(path: &Path, reason: &impl ToString) -> CheckpointError {
    CheckpointError::Format { path: path.to_owned(), reason: reason.to_string() }
}

impl Checkpoint {
    pub(super) fn new(
        job: &TrainJob<'_>,
        map: &World,
        counters: Counters,
        totals: TotalsState,
        memory: Memory,
    ) -> Self {
        Self {
            schema: SCHEMA.to_owned(),
            rl: job.rl.clone(),
            train: job.train.clone(),
            dataset_sha256: job.dataset_sha256.to_owned(),
            cells: map.cells() as u32,
            cell_m: map.cell_m(),
            counters,
            best_scores: Vec::new(),
            totals,
            memory,
            adam_updates: 0,
        }
    }

    /// Writes a checkpoint; an older one of the same name is replaced.
    pub(super) fn write(
        mut self,
        directory: &Path,
        [policy, target]: [&QNetwork; 2],
        adam: &Adam,
    ) -> Result<(), CheckpointError> {
        let parent = directory.parent().unwrap_or(Path::new("."));
        std::fs::create_dir_all(parent).map_err(FileError::new("create", parent))?;
        let temporary = tempfile::Builder::new().prefix(TEMPORARY).tempdir_in(parent);
        let temporary = temporary.map_err(FileError::new("create", parent))?;
        let ([first, second], updates) = adam.state();
        self.adam_updates = updates;
        let save = |name: &str, tensors: Vec<(String, Tensor)>| {
            let path = temporary.path().join(name);
            write_tensors(&path, &tensors)?;
            let file = std::fs::File::open(&path).map_err(FileError::new("open", &path))?;
            file.sync_all().map_err(FileError::new("sync", &path))?;
            Ok::<_, CheckpointError>(())
        };
        let named = |prefix: &str, network: &QNetwork| -> Vec<(String, Tensor)> {
            network.named().map(|(name, one)| (format!("{prefix}{name}"), one)).collect()
        };
        save(WEIGHTS, named("", policy))?;
        let mut learning = named("target.", target);
        for (name, moment) in [(FIRST, first), (SECOND, second)] {
            learning.push((name.to_owned(), moment.shallow_clone()));
        }
        save(LEARNING, learning)?;
        let state = rmp_serde::to_vec_named(&self).expect("writing to memory cannot fail");
        write_atomic(&temporary.path().join(STATE), &state)?;
        // The old one goes in one step too, and is removed when the new one is in its place.
        let _old = remove_whole(directory)?;
        let temporary = temporary.keep();
        std::fs::rename(&temporary, directory).map_err(FileError::new("rename", directory))?;
        Ok(())
    }

    /// Reads what is beside the tensors.
    ///
    /// # Errors
    /// [`CheckpointError`].
    pub fn read(directory: &Path) -> Result<Self, CheckpointError> {
        let path = directory.join(STATE);
        let bytes = std::fs::read(&path).map_err(FileError::new("read", &path))?;
        // What other versions keep is not what this one expects, so the version comes first.
        let Version { schema } =
            rmp_serde::from_slice(&bytes).map_err(|error| invalid(&path, &error))?;
        if schema != SCHEMA {
            let reason = format!(
                "the checkpoint is of schema {schema:?}, expected {SCHEMA:?}: train into another \
                 directory, or use the version of holescout that wrote it"
            );
            return Err(invalid(&path, &reason));
        }
        rmp_serde::from_slice(&bytes).map_err(|error| invalid(&path, &error))
    }

    /// Demands that it was made by this run.
    pub(super) fn demand(
        &self,
        directory: &Path,
        job: &TrainJob<'_>,
    ) -> Result<(), CheckpointError> {
        let mut differences = Vec::new();
        let mut compare = |key: &str, expected: &serde_json::Value, found: &serde_json::Value| {
            if expected != found {
                differences.push(format!("{key} is {expected} here, {found} there"));
            }
        };
        let value = |text: &str| serde_json::Value::from(text);
        compare("dataset", &value(job.dataset_sha256), &value(&self.dataset_sha256));
        let sections = [
            ("rl", serde_json::json!(job.rl), serde_json::json!(self.rl)),
            ("train", serde_json::json!(job.train), serde_json::json!(self.train)),
        ];
        for (section, expected, found) in &sections {
            for (key, expected) in expected.as_object().into_iter().flatten() {
                // What is only watched does not change what is learned.
                if !matches!(
                    &**key,
                    "checkpoint_every"
                        | "evaluate_every"
                        | "evaluate_maps"
                        | "evaluate_starts"
                        | "patience"
                ) {
                    compare(&format!("{section}.{key}"), expected, &found[key]);
                }
            }
        }
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
        let weights = Tensors::read(&directory.join(WEIGHTS))?;
        policy.set(&weights.of(policy, "")?);
        let learning = Tensors::read(&directory.join(LEARNING))?;
        target.set(&learning.of(target, "target.")?);
        let moment = |name| learning.find(name, policy.learned());
        adam.restore(&[moment(FIRST)?, moment(SECOND)?], self.adam_updates);
        Ok(())
    }
}

/// Takes a checkpoint out of the way, whole, if it is there; it is removed when the result is dropped.
pub(super) fn remove_whole(directory: &Path) -> Result<Option<TempDir>, FileError> {
    if !directory.exists() {
        return Ok(None);
    }
    let parent = directory.parent().unwrap_or(Path::new("."));
    let aside = tempfile::Builder::new().prefix(TEMPORARY).tempdir_in(parent);
    let aside = aside.map_err(FileError::new("create", parent))?;
    let to = aside.path().join("old");
    std::fs::rename(directory, to).map_err(FileError::new("rename", directory))?;
    Ok(Some(aside))
}

/// The tensors of a file.
struct Tensors {
    path: PathBuf,
    tensors: Vec<(String, Tensor)>,
}

impl Tensors {
    fn read(path: &Path) -> Result<Self, CheckpointError> {
        std::fs::metadata(path).map_err(FileError::new("read", path))?;
        let tensors = Tensor::read_safetensors(path).map_err(|error| invalid(path, &error))?;
        Ok(Self { path: path.to_owned(), tensors })
    }

    /// The tensor of a name, which has the shape of another.
    fn find(&self, name: &str, like: &Tensor) -> Result<Tensor, CheckpointError> {
        let found = self.tensors.iter().find(|(found, _)| found == name);
        let (_, found) = found.ok_or_else(|| invalid(&self.path, &format!("no {name}")))?;
        if found.size() == like.size() && found.kind() == like.kind() {
            return Ok(found.shallow_clone());
        }
        let (found, expected) = (found.size(), like.size());
        Err(invalid(&self.path, &format!("{name} is {found:?}, expected {expected:?}")))
    }

    /// The tensors of a network's parameters, in their order.
    fn of(&self, network: &QNetwork, prefix: &str) -> Result<Vec<Tensor>, CheckpointError> {
        let find = |(name, like): (&str, Tensor)| self.find(&format!("{prefix}{name}"), &like);
        network.named().map(find).collect()
    }
}

/// Writes tensors, whatever device they are on.
fn write_tensors(path: &Path, tensors: &[(String, Tensor)]) -> Result<(), CheckpointError> {
    let tensors: Vec<(&str, Tensor)> =
        tensors.iter().map(|(name, one)| (&**name, one.to_device(Device::Cpu))).collect();
    Tensor::write_safetensors(&tensors, path).map_err(|error| invalid(path, &error))
}

/// The task that a policy was trained for, and how: that of a checkpoint, or one that was exported.
fn trained(directory: &Path) -> Result<(RlConfig, TrainConfig), CheckpointError> {
    if directory.join(STATE).exists() || !directory.join(MANIFEST).exists() {
        let Checkpoint { rl, train, .. } = Checkpoint::read(directory)?;
        return Ok((rl, train));
    }
    let (PolicyManifest { rl, train, weights_sha256, .. }, _) =
        load::<PolicyManifest>(directory, "export-policy", PolicyManifest::SCHEMA)?;
    let path = directory.join(WEIGHTS);
    if sha256_file(&path)?.sha256 != weights_sha256 {
        return Err(invalid(&path, &"it is not the file that the manifest tells of"));
    }
    Ok((rl, train))
}

/// Demands that states are encoded as a policy has learned to see them.
fn demand_encoding(
    directory: &Path,
    expected: &RlConfig,
    found: &RlConfig,
) -> Result<(), CheckpointError> {
    let pairs = [
        ("encoding_decay", expected.encoding_decay, found.encoding_decay),
        ("height_scale_m", expected.height_scale_m, found.height_scale_m),
    ];
    let different = pairs.into_iter().filter(|(_, expected, found)| expected != found);
    let differences: Vec<String> = different
        .map(|(key, expected, found)| format!("rl.{key} is {expected} here, {found} there"))
        .collect();
    if differences.is_empty() {
        return Ok(());
    }
    Err(CheckpointError::OtherEncoding { path: directory.to_owned(), differences })
}

/// The policy of a checkpoint or an exported one, and how it was trained.
///
/// # Errors
/// [`CheckpointError`] if the checkpoint cannot be read, or does not fit maps of `cells` × `cells` and
/// the moves of the task.
pub fn load_weights(
    directory: &Path,
    cells: usize,
    config: &RlConfig,
    device: Device,
) -> Result<(TrainConfig, QNetwork), CheckpointError> {
    let (rl, train) = trained(directory)?;
    demand_encoding(directory, config, &rl)?;
    let network = read_network(directory, cells, config.reach_cells, &train, device)?;
    Ok((train, network))
}

/// The policy of a directory, trained so.
pub(super) fn read_network(
    directory: &Path,
    cells: usize,
    reach: u32,
    train: &TrainConfig,
    device: Device,
) -> Result<QNetwork, CheckpointError> {
    let mut network = QNetwork::new(cells, reach, train, device)?;
    let weights = Tensors::read(&directory.join(WEIGHTS))?;
    network.set(&weights.of(&network, "")?);
    Ok(network)
}
