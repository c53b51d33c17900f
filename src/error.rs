//! What all errors of this library have in common.
//!
//! Each module has its own error enum; this one only says who has to act on an
//! error, which is what the exit code of the command tells a batch system.

use std::path::{Path, PathBuf};

/// Who has to act on an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// The input or the configuration is wrong: trying again cannot help.
    Input,
    /// The machine failed while running (disk full, permission, interruption).
    Running,
}

/// An error that knows whose fault it is.
pub trait HasFault: std::error::Error {
    /// Whether the input is to blame or the run.
    fn fault(&self) -> Fault;
}

/// An operation on a file failed.
#[derive(Debug, thiserror::Error)]
#[error("cannot {action} {}: {source}", path.display())]
pub struct FileError {
    /// The file.
    pub path: PathBuf,
    /// What was attempted, as a verb; "open", "read" and "list" are about inputs.
    pub action: &'static str,
    /// The operating system's reason.
    pub source: std::io::Error,
}

impl FileError {
    /// For `map_err`: wraps an I/O error with the path and the action.
    pub fn new(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self { path, action, source }
    }
}

impl HasFault for FileError {
    /// A file that is missing or ends early when it is read is the input's fault, the rest is
    /// the machine's.
    fn fault(&self) -> Fault {
        let reads = matches!(self.action, "open" | "read" | "list");
        match self.source.kind() {
            std::io::ErrorKind::NotFound
            | std::io::ErrorKind::UnexpectedEof
            | std::io::ErrorKind::InvalidData
            | std::io::ErrorKind::IsADirectory
            | std::io::ErrorKind::NotADirectory
                if reads =>
            {
                Fault::Input
            }
            _ => Fault::Running,
        }
    }
}
