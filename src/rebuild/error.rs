//! Why an output cannot be built once more.

use std::path::PathBuf;

use crate::config::ConfigError;
use crate::dataset::ShardError;
use crate::error::{Fault, FileError, HasFault};
use crate::manifest::ManifestError;
use crate::rasterise::RasteriseError;
use crate::release::{DiffError, ReleaseError};
use crate::rsrp::ImportRsrpError;
use crate::scenes::ScenesError;

/// Why an output cannot be built once more.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RebuildError {
    /// Its manifest cannot be used.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// The configuration that it records cannot be used.
    #[error("recorded {0}")]
    Config(#[from] ConfigError),
    /// A file cannot be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    /// The tiles cannot be built.
    #[error(transparent)]
    Rasterise(#[from] RasteriseError),
    /// The scenes cannot be built.
    #[error(transparent)]
    Scene(#[from] ScenesError),
    /// The maps cannot be imported.
    #[error(transparent)]
    Import(#[from] ImportRsrpError),
    /// The shards cannot be built.
    #[error(transparent)]
    Shard(#[from] ShardError),
    /// The release cannot be made.
    #[error(transparent)]
    Release(#[from] ReleaseError),
    /// Its records cannot be compared with those rebuilt.
    #[error(transparent)]
    Diff(#[from] DiffError),
    /// No stage that can be repeated.
    #[error("{schema} cannot be rebuilt: only tiles, scenes, imported maps and datasets can")]
    NoStage {
        /// Schema of the manifest.
        schema: String,
    },
    /// Something that was used is not given.
    #[error("the manifest records {recorded}: say by {flag} where to find that")]
    NotGiven {
        /// What was used.
        recorded: String,
        /// The flag that gives it.
        flag: &'static str,
    },
    /// An extract is not among those given.
    #[error("none of the files given by --osm is {recorded}, as the manifest records it: {given}")]
    MissingExtract {
        /// Name and digest of the extract.
        recorded: String,
        /// The files given, and their digests.
        given: String,
    },
    /// What is given is something else.
    #[error("{}: {found}; the manifest records {recorded}", path.display())]
    Other {
        /// What was given.
        path: PathBuf,
        /// What it is.
        found: String,
        /// What was used.
        recorded: String,
    },
    /// Recorded maps are missing or have changed.
    #[error(
        "{}: not the {recorded} maps that the manifest records: {missing} are missing or have \
         changed, for example {example}", path.display()
    )]
    OtherMaps {
        /// The directory.
        path: PathBuf,
        /// How many maps are recorded.
        recorded: usize,
        /// How many of them are not there.
        missing: usize,
        /// One of them, and what is wrong.
        example: String,
    },
    /// A name in the manifest leads elsewhere.
    #[error("the manifest records an input with the name {name:?}, which is no file name")]
    Name {
        /// The name.
        name: String,
    },
    /// A manifest that no run of this program writes.
    #[error("the manifest contradicts itself: {reason}")]
    Contradiction {
        /// How.
        reason: String,
    },
}

impl HasFault for RebuildError {
    fn fault(&self) -> Fault {
        match self {
            Self::Manifest(error) => error.fault(),
            Self::File(error) => error.fault(),
            Self::Rasterise(error) => error.fault(),
            Self::Scene(error) => error.fault(),
            Self::Import(error) => error.fault(),
            Self::Shard(error) => error.fault(),
            Self::Release(error) => error.fault(),
            Self::Diff(error) => error.fault(),
            _ => Fault::Input,
        }
    }
}
