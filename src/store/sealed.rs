//! A small directory that is written at once, and replaced at once (`seal`): its list of checksums
//! vouches for every file.

use std::path::{Path, PathBuf};

use super::list::{SUMS, parse_sums};
use super::sha256_bytes;
use crate::error::{Fault, FileError, HasFault};

/// Why a file of a sealed directory cannot be had.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SealError {
    /// Reading failed.
    #[error(transparent)]
    File(#[from] FileError),
    /// The list of checksums is missing, or not one.
    #[error("{}: it is missing or damaged, so nothing vouches for the files beside it", path.display())]
    List {
        /// The list.
        path: PathBuf,
    },
    /// The file is not the one that was written.
    #[error("{}: it is not the file that {SUMS} tells of: damaged, or from elsewhere", path.display())]
    Other {
        /// The file.
        path: PathBuf,
    },
}

impl HasFault for SealError {
    fn fault(&self) -> Fault {
        match self {
            Self::File(error) => error.fault(),
            Self::List { .. } | Self::Other { .. } => Fault::Input,
        }
    }
}

/// Names of the files of a sealed directory.
///
/// # Errors
/// [`SealError`] if there is no list of them.
pub(crate) fn sealed_files(directory: &Path) -> Result<Vec<String>, SealError> {
    let list = directory.join(SUMS);
    let sums = std::fs::read_to_string(&list).ok();
    let listed = sums.as_deref().and_then(|sums| parse_sums(sums).ok());
    let listed = listed.ok_or(SealError::List { path: list })?;
    Ok(listed.into_iter().map(|(_, name)| name.to_owned()).collect())
}

/// A file of a sealed directory.
///
/// # Errors
/// [`SealError`] if it cannot be read, or is not what was written.
pub(crate) fn read_sealed(directory: &Path, name: &str) -> Result<Vec<u8>, SealError> {
    let list = directory.join(SUMS);
    let sums = match std::fs::read_to_string(&list) {
        Err(error) if error.kind() == std::io::ErrorKind::PermissionDenied => {
            return Err(FileError::new("read", &list)(error).into());
        }
        other => other.ok(),
    };
    let listed = sums.as_deref().and_then(|sums| parse_sums(sums).ok());
    let listed = listed.and_then(|sums| sums.into_iter().find(|(_, listed)| *listed == name));
    let Some((expected, _)) = listed else { return Err(SealError::List { path: list }) };
    let path = directory.join(name);
    let bytes = std::fs::read(&path).map_err(FileError::new("read", &path))?;
    if sha256_bytes(&bytes).sha256 != expected {
        return Err(SealError::Other { path });
    }
    Ok(bytes)
}
