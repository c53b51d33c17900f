//! Why a directory cannot be used or filled.

use std::path::PathBuf;

use crate::error::{Fault, FileError, HasFault};

/// Why a directory cannot be used or filled.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// Reading or writing failed.
    #[error(transparent)]
    File(#[from] FileError),
    /// The directory holds the output of other inputs.
    #[error("{} holds {found}, not {expected}: {mend}", path.display())]
    Occupied {
        /// The directory.
        path: PathBuf,
        /// What is there.
        found: String,
        /// What would have been written.
        expected: String,
        /// What to do.
        mend: &'static str,
    },
    /// The directory holds files of somebody else, which are never removed.
    #[error(
        "{} is no output of this stage: it holds {example}; \
         choose another directory, or empty this one yourself", path.display()
    )]
    Foreign {
        /// The directory.
        path: PathBuf,
        /// What is in it, for example.
        example: String,
    },
    /// The directory lies in a finished output.
    #[error(
        "{} lies in {}, a finished output, which would be damaged by it: choose a directory elsewhere",
        path.display(), output.display()
    )]
    Inside {
        /// The directory.
        path: PathBuf,
        /// The output that it lies in.
        output: PathBuf,
    },
    /// Another process is writing there now.
    #[error("{} is being written by another run of holescout", path.display())]
    Busy {
        /// The directory.
        path: PathBuf,
    },
    /// Parts are missing, or no longer what their task wrote.
    #[error(
        "{}: {} of {tasks} tasks are not done: {}; run them again with --task-count {tasks} and \
         --task-index {}, then --merge",
        path.display(), gaps.len(), reasons(gaps), indices(gaps)
    )]
    Gaps {
        /// The directory.
        path: PathBuf,
        /// How many tasks there are.
        tasks: u32,
        /// Those to be run again.
        gaps: Vec<Gap>,
    },
    /// The output was finished, but is no longer what it was.
    #[error(
        "{}: finished, but {file} is not what its checksum says; remove the directory and build \
         it again", path.display()
    )]
    Damaged {
        /// The directory.
        path: PathBuf,
        /// The first file that differs.
        file: String,
    },
}

impl HasFault for OutputError {
    fn fault(&self) -> Fault {
        match self {
            Self::File(error) => error.fault(),
            Self::Occupied { .. }
            | Self::Foreign { .. }
            | Self::Inside { .. }
            | Self::Damaged { .. } => Fault::Input,
            // Waiting may help: for the other run, or for the tasks.
            Self::Busy { .. } | Self::Gaps { .. } => Fault::Running,
        }
    }
}

/// A task whose part is missing, wholly or in pieces.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Gap {
    /// The task, from 0.
    pub index: u32,
    /// What is missing.
    pub reason: String,
}

/// More gaps than this are counted, not told.
const MOST_TOLD: usize = 10;

fn reasons(gaps: &[Gap]) -> String {
    let told = gaps.iter().take(MOST_TOLD);
    let mut reasons: Vec<String> =
        told.map(|Gap { index, reason }| format!("task {index} {reason}")).collect();
    if gaps.len() > MOST_TOLD {
        reasons.push(format!("and {} more", gaps.len() - MOST_TOLD));
    }
    reasons.join(", ")
}

fn indices(gaps: &[Gap]) -> String {
    let indices: Vec<String> = gaps.iter().map(|gap| gap.index.to_string()).collect();
    indices.join(" ")
}
