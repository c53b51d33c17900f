//! Why a run cannot begin or go on.

use std::path::{Path, PathBuf};

use crate::dataset::ReadError;
use crate::error::{Fault, FileError, HasFault};
use crate::rl::PoolError;
use crate::rl::agent::{CheckpointError, MemoryError, NoDevice, ShapeError, TrainerError};
use crate::store::OutputError;

/// Why a run cannot begin or go on. What its last checkpoint holds is not lost.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainError {
    /// The dataset cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Maps of the dataset cannot be had.
    #[error(transparent)]
    Pool(#[from] PoolError),
    /// There is no such device.
    #[error(transparent)]
    Device(#[from] NoDevice),
    /// The network does not fit the maps.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// There is too little memory.
    #[error(transparent)]
    Memory(#[from] MemoryError),
    /// Training failed.
    #[error(transparent)]
    Trainer(#[from] TrainerError),
    /// The directory cannot be used.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// A file of the run cannot be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    /// The checkpoint that the run would go on from is damaged.
    #[error("{source}; {}", way_on(path, before.as_deref()))]
    Damaged {
        /// What is wrong.
        source: Box<CheckpointError>,
        /// The checkpoint.
        path: PathBuf,
        /// The one before, if there is one.
        before: Option<PathBuf>,
    },
    /// Somebody has removed the checkpoints of a run.
    #[error(
        "{}: the log of a run whose checkpoints are gone, so it cannot go on: train into another directory, \
         or remove the log to begin anew here", log.display()
    )]
    NothingLeft {
        /// The log.
        log: PathBuf,
    },
}

fn way_on(path: &Path, before: Option<&Path>) -> String {
    let path = path.display();
    match before {
        Some(before) => {
            let before = before.display();
            format!("remove {path}, and the run goes on from {before}")
        }
        None => "there is none before it: train into another directory".to_owned(),
    }
}

impl HasFault for TrainError {
    fn fault(&self) -> Fault {
        match self {
            Self::Read(error) => error.fault(),
            Self::Pool(error) => error.fault(),
            Self::Device(error) => error.fault(),
            Self::Shape(error) => error.fault(),
            Self::Memory(error) => error.fault(),
            Self::Trainer(error) => error.fault(),
            Self::Output(error) => error.fault(),
            Self::File(error) => error.fault(),
            Self::Damaged { .. } | Self::NothingLeft { .. } => Fault::Input,
        }
    }
}
