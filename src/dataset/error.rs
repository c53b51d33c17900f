//! Why a record cannot be read.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::grids::RecordError;
use crate::error::{Fault, FileError, HasFault};
use crate::grid::TileId;
use crate::manifest::ManifestError;
#[cfg(feature = "remote")]
use crate::store::RemoteError;
use crate::store::SeekError;

/// Why a record cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The manifest cannot be used.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// A dataset on a server cannot be had.
    #[cfg(feature = "remote")]
    #[error(transparent)]
    Remote(#[from] RemoteError),
    /// This program reads directories only.
    #[cfg(not(feature = "remote"))]
    #[error("{url}: this program was built without the feature `remote`, which reads addresses")]
    NoRemote {
        /// The address.
        url: String,
    },
    /// A shard is damaged.
    #[error("{}: {source}", shard.display())]
    Shard {
        /// The file.
        shard: PathBuf,
        /// What is wrong.
        source: SeekError,
    },
    /// A record is damaged.
    #[error("{}: frame {frame}: {source}", shard.display())]
    Record {
        /// The file.
        shard: PathBuf,
        /// Index of the frame, from 0.
        frame: usize,
        /// What is wrong.
        source: RecordError,
    },
    /// No record of this name.
    #[error("no record {id} in the dataset, which has {records}, for instance {example}")]
    Unknown {
        /// What was asked for.
        id: TileId,
        /// Number of records.
        records: usize,
        /// A record that exists.
        example: String,
    },
}

impl HasFault for ReadError {
    fn fault(&self) -> Fault {
        match self {
            Self::Manifest(error) => error.fault(),
            #[cfg(feature = "remote")]
            Self::Remote(error) => error.fault(),
            Self::Shard { source: SeekError::Io(_), .. } if !self.is_damage() => Fault::Running,
            _ => Fault::Input,
        }
    }
}

impl ReadError {
    /// Whether a record or its shard is damaged or missing: nothing that another try, a key or a
    /// larger cache would mend.
    #[must_use]
    pub fn is_damage(&self) -> bool {
        match self {
            Self::Shard { source: SeekError::Io(error), .. } => {
                matches!(error.kind(), ErrorKind::NotFound | ErrorKind::UnexpectedEof)
            }
            Self::Shard { .. } | Self::Record { .. } => true,
            #[cfg(feature = "remote")]
            Self::Remote(error) => matches!(
                error,
                RemoteError::Damaged { .. }
                    | RemoteError::Size { .. }
                    | RemoteError::NotFound { .. }
            ),
            _ => false,
        }
    }
}

/// A shard that the system does not give.
pub(super) fn unreadable(path: &Path, error: std::io::Error) -> ReadError {
    let kind = error.kind();
    let named = FileError::new("read", path)(error);
    let source = SeekError::Io(std::io::Error::new(kind, named));
    ReadError::Shard { shard: path.to_owned(), source }
}
