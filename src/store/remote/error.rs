//! Why a file of a server cannot be had.

use crate::error::{Fault, FileError, HasFault};
use crate::store::Digest;

/// Why a file cannot be had.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RemoteError {
    /// Not an address that can be read.
    #[error("{url}: {reason}; expected http://, https:// or s3:// and a directory")]
    Url {
        /// The address.
        url: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The file is not there.
    #[error("{url}: not found; expected a file of a dataset or release")]
    NotFound {
        /// The file.
        url: String,
    },
    /// The server knows who asks, or wants to, and gives nothing.
    #[error(
        "{url}: refused: {reason}; for s3:// set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or \
         AWS_SKIP_SIGNATURE=true for a public bucket"
    )]
    Refused {
        /// The file.
        url: String,
        /// What the server said.
        reason: String,
    },
    /// A manifest that no dataset of any use has.
    #[error("{url}: has {bytes} bytes, more than the {limit} that a manifest may have")]
    TooLarge {
        /// The file.
        url: String,
        /// Its size, or what came before it was given up.
        bytes: u64,
        /// The most that is read.
        limit: u64,
    },
    /// It is no longer wanted.
    #[error("{url}: the download was stopped; what came is kept")]
    Stopped {
        /// The file.
        url: String,
    },
    /// The server or the network failed, each time.
    #[error("{url}: failed {attempts} times in a row, the last time: {reason}")]
    Failed {
        /// The file.
        url: String,
        /// How often it was tried without a new byte.
        attempts: u32,
        /// Why it failed at last.
        reason: String,
    },
    /// The server has a file of another size than the manifest promises.
    #[error("{url}: has {found} bytes, the manifest says {expected}")]
    Size {
        /// The file.
        url: String,
        /// From the manifest.
        expected: u64,
        /// From the server.
        found: u64,
    },
    /// The server gives other bytes than the manifest promises.
    #[error("{url}: is {found}, the manifest says {expected}; downloaded twice")]
    Damaged {
        /// The file.
        url: String,
        /// From the manifest.
        expected: Digest,
        /// What was downloaded.
        found: Digest,
    },
    /// A manifest of somebody's that names no SHA-256.
    #[error("{url}: {sha256:?} is no SHA-256")]
    NoDigest {
        /// The file.
        url: String,
        /// What the manifest has.
        sha256: String,
    },
    /// More than the cache may hold.
    #[error(
        "{url}: {bytes} bytes do not fit into the cache of {limit}; raise remote.cache_mb, or read \
         fewer shards at a time"
    )]
    CacheTooSmall {
        /// The file.
        url: String,
        /// Its size.
        bytes: u64,
        /// The size of the cache, in bytes.
        limit: u64,
    },
    /// The cache cannot be used.
    #[error(transparent)]
    Cache(#[from] FileError),
    /// No memory or threads for the network.
    #[error("cannot start the network: {0}")]
    Runtime(std::io::Error),
}

impl HasFault for RemoteError {
    fn fault(&self) -> Fault {
        match self {
            Self::Failed { .. }
            | Self::Refused { .. }
            | Self::Stopped { .. }
            | Self::Runtime(_) => Fault::Running,
            Self::Cache(error) => error.fault(),
            _ => Fault::Input,
        }
    }
}
