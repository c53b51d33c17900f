//! Why a checkpoint cannot be written or used.

use std::path::{Path, PathBuf};

use super::inputs::ShapeError;
use crate::error::{Fault, FileError, HasFault};
use crate::manifest::ManifestError;
use crate::store::{OutputError, SealError};

/// The schema of checkpoints, which changes with what they hold.
pub(super) const SCHEMA: &str = "checkpoint.v5";

/// Why a checkpoint cannot be written or used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckpointError {
    /// Reading or writing failed.
    #[error(transparent)]
    File(#[from] FileError),
    /// A file is not the one that was written.
    #[error(transparent)]
    Seal(#[from] SealError),
    /// The directory cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// Another version wrote it.
    #[error(
        "{}: the checkpoint is of schema {found:?}, expected {SCHEMA:?}: train into another \
         directory, or use the version of holescout that wrote it", path.display()
    )]
    OtherVersion {
        /// The file.
        path: PathBuf,
        /// Its schema.
        found: String,
    },
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
    /// It was trained on states that are made otherwise.
    #[error(
        "{}: the policy sees states otherwise: {}; evaluate it with its own settings",
        path.display(), differences.join("; ")
    )]
    OtherStates {
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
            Self::Seal(error) => error.fault(),
            Self::Output(error) => error.fault(),
            Self::Manifest(error) => error.fault(),
            Self::Shape(error) => error.fault(),
            Self::OtherVersion { .. }
            | Self::Format { .. }
            | Self::OtherRun { .. }
            | Self::OtherStates { .. } => Fault::Input,
        }
    }
}

impl CheckpointError {
    /// Whether the checkpoint itself is to blame, so that an earlier one may still do.
    #[must_use]
    pub fn is_damage(&self) -> bool {
        match self {
            Self::Seal(_) | Self::Format { .. } => true,
            Self::File(error) => error.fault() == Fault::Input,
            _ => false,
        }
    }
}

pub(super) fn invalid(path: &Path, reason: &impl ToString) -> CheckpointError {
    CheckpointError::Format { path: path.to_owned(), reason: reason.to_string() }
}
