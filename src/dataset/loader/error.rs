//! Why a loader cannot begin.

use std::path::PathBuf;

use crate::config::Split;
use crate::error::{Fault, HasFault};

/// Why a loader cannot begin.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoaderError {
    /// Nothing to load.
    #[error("{}: no records in split {split}; records are in: {}", root.display(), names(found))]
    Empty {
        /// The dataset.
        root: PathBuf,
        /// The split that was asked for.
        split: Split,
        /// The splits that have records.
        found: Vec<Split>,
    },
    /// More processes than records.
    #[error(
        "the {split} split has {records} records, too few for {world} processes; run fewer of them"
    )]
    TooManyProcesses {
        /// The split.
        split: Split,
        /// Its records.
        records: u32,
        /// The processes.
        world: u32,
    },
    /// Shards that are needed at a time do not fit into the cache, and would be downloaded again and
    /// again.
    #[error(
        "{shards} shards of the {split} split are needed at a time, with {bytes} bytes, more than the \
         {limit} of remote.cache_mb; raise that, or shuffle fewer shards together (train.block)"
    )]
    CacheTooSmall {
        /// The split.
        split: Split,
        /// How many.
        shards: usize,
        /// What the largest of them have together.
        bytes: u64,
        /// What the cache holds.
        limit: u64,
    },
    /// The operating system gave no thread.
    #[error("cannot start a thread that decodes records: {0}; try fewer threads")]
    Thread(std::io::Error),
}

fn names(splits: &[Split]) -> String {
    let names: Vec<&str> = splits.iter().map(|split| split.name()).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

impl HasFault for LoaderError {
    fn fault(&self) -> Fault {
        match self {
            Self::Thread(_) => Fault::Running,
            _ => Fault::Input,
        }
    }
}
