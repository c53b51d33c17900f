//! Checkpoints: everything that training goes on from, whole or absent.
//!
//! A checkpoint is a directory, written under a temporary name and renamed: `weights.safetensors` (the
//! policy, all that a user of it needs), `learning.safetensors` (target network, moments of Adam) and
//! `state.msgpack` (configuration, dataset, counters, episodes, replay).

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;
use tch::{Device, Tensor};

use super::adam::Adam;
use super::network::{QNetwork, ShapeError};
use crate::config::{RlConfig, TrainConfig};
use crate::error::{Fault, FileError, HasFault};
use crate::rl::EpisodeState;
use crate::store::write_atomic;

/// What names of directories begin with that are not whole yet.
pub(super) const TEMPORARY: &str = ".holescout-checkpoint-";
const SCHEMA: &str = "checkpoint.v1";
const WEIGHTS: &str = "weights.safetensors";
const LEARNING: &str = "learning.safetensors";
const STATE: &str = "state.msgpack";

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
    /// The network does not fit the maps.
    #[error(transparent)]
    Shape(#[from] ShapeError),
}

impl HasFault for CheckpointError {
    fn fault(&self) -> Fault {
        match self {
            Self::File(error) => error.fault(),
            Self::Shape(error) => error.fault(),
            Self::Format { .. } | Self::OtherRun { .. } => Fault::Input,
        }
    }
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
    /// Updates done.
    pub updates: u64,
    /// Steps of all episodes done.
    pub steps: u64,
    /// Best score on the validation split so far, and the update that had it.
    pub best: Option<(f64, u64)>,
    pub(super) episodes: Vec<EpisodeState>,
    pub(super) replay_added: u64,
    pub(super) replay: ByteBuf,
    adam_updates: i32,
}

/// What a checkpoint is made of, beside its tensors.
#[derive(Debug)]
pub(super) struct Run<'a> {
    pub(super) rl: &'a RlConfig,
    pub(super) train: &'a TrainConfig,
    pub(super) dataset_sha256: &'a str,
}

fn invalid(path: &Path, reason: &impl ToString) -> CheckpointError {
    CheckpointError::Format { path: path.to_owned(), reason: reason.to_string() }
}

impl Checkpoint {
    pub(super) fn new(
        run: &Run<'_>,
        [updates, steps]: [u64; 2],
        best: Option<(f64, u64)>,
        episodes: Vec<EpisodeState>,
        (replay_added, replay): (u64, &[u8]),
    ) -> Self {
        Self {
            schema: SCHEMA.to_owned(),
            rl: run.rl.clone(),
            train: run.train.clone(),
            dataset_sha256: run.dataset_sha256.to_owned(),
            updates,
            steps,
            best,
            episodes,
            replay_added,
            replay: ByteBuf::from(replay),
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
        let (moments, updates) = adam.state();
        self.adam_updates = updates;
        let save = |name: &str, tensors: Vec<(String, Tensor)>| {
            let path = temporary.path().join(name);
            Tensor::write_safetensors(&tensors, &path).map_err(|error| invalid(&path, &error))?;
            let file = std::fs::File::open(&path).map_err(FileError::new("open", &path))?;
            file.sync_all().map_err(FileError::new("sync", &path))?;
            Ok::<_, CheckpointError>(())
        };
        let named = |prefix: &str, network: &QNetwork| -> Vec<(String, Tensor)> {
            network.named().map(|(name, one)| (format!("{prefix}{name}"), one.detach())).collect()
        };
        save(WEIGHTS, named("", policy))?;
        let mut learning = named("target.", target);
        for ((name, _), [first, second]) in policy.named().zip(moments) {
            learning.push((format!("adam.first.{name}"), first.shallow_clone()));
            learning.push((format!("adam.second.{name}"), second.shallow_clone()));
        }
        save(LEARNING, learning)?;
        let state = rmp_serde::to_vec_named(&self).expect("writing to memory cannot fail");
        write_atomic(&temporary.path().join(STATE), &state)?;
        if directory.exists() {
            std::fs::remove_dir_all(directory).map_err(FileError::new("remove", directory))?;
        }
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
        let checkpoint: Self =
            rmp_serde::from_slice(&bytes).map_err(|error| invalid(&path, &error))?;
        if checkpoint.schema != SCHEMA {
            return Err(invalid(
                &path,
                &format!("schema is {:?}, not {SCHEMA}", checkpoint.schema),
            ));
        }
        Ok(checkpoint)
    }

    /// Demands that it was made by this run.
    pub(super) fn demand(&self, directory: &Path, run: &Run<'_>) -> Result<(), CheckpointError> {
        let mut differences = Vec::new();
        let mut compare = |key: &str, expected: &serde_json::Value, found: &serde_json::Value| {
            if expected != found {
                differences.push(format!("{key} is {expected} here, {found} there"));
            }
        };
        let value = |text: &str| serde_json::Value::from(text);
        compare("dataset", &value(run.dataset_sha256), &value(&self.dataset_sha256));
        let sections = [
            ("rl", serde_json::json!(run.rl), serde_json::json!(self.rl)),
            ("train", serde_json::json!(run.train), serde_json::json!(self.train)),
        ];
        for (section, expected, found) in &sections {
            for (key, expected) in expected.as_object().into_iter().flatten() {
                // What is only watched does not change what is learned.
                if !matches!(&**key, "checkpoint_every" | "evaluate_every" | "evaluate_starts") {
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
        policy.copy_from(&weights.of(policy, "")?);
        let learning = Tensors::read(&directory.join(LEARNING))?;
        target.copy_from(&learning.of(target, "target.")?);
        let first = learning.of(policy, "adam.first.")?;
        let second = learning.of(policy, "adam.second.")?;
        let moments = first.into_iter().zip(second).map(|(first, second)| [first, second]);
        adam.restore(&moments.collect::<Vec<_>>(), self.adam_updates);
        Ok(())
    }
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

    /// The tensors of a network's parameters, in their order.
    fn of(&self, network: &QNetwork, prefix: &str) -> Result<Vec<Tensor>, CheckpointError> {
        let find = |(name, parameter): (&str, &Tensor)| {
            let name = format!("{prefix}{name}");
            let found = self.tensors.iter().find(|(found, _)| *found == name);
            let (_, found) = found.ok_or_else(|| invalid(&self.path, &format!("no {name}")))?;
            if found.size() == parameter.size() && found.kind() == parameter.kind() {
                return Ok(found.shallow_clone());
            }
            let (found, expected) = (found.size(), parameter.size());
            Err(invalid(&self.path, &format!("{name} is {found:?}, expected {expected:?}")))
        };
        network.named().map(find).collect()
    }
}

/// The policy of a checkpoint, and how it was trained.
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
    let Checkpoint { train, .. } = Checkpoint::read(directory)?;
    let mut network = QNetwork::new(cells, config.reach_cells, &train, device)?;
    let weights = Tensors::read(&directory.join(WEIGHTS))?;
    let weights = weights.of(&network, "")?;
    network.copy_from(&weights);
    Ok((train, network))
}
