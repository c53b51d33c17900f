//! Writing a file so that it is whole or absent.

use std::fs::File;
use std::io::Write;
use std::path::Path;

use crate::error::FileError;

/// Prefix of temporary names; a leftover of a killed run is recognised by it.
pub(super) const TEMPORARY_PREFIX: &str = ".holescout-tmp-";

/// Writes `bytes` under a temporary name beside `path`, syncs, and renames.
///
/// # Errors
/// [`FileError`] with the path and the operating system's reason; nothing is left behind.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    write_with(path, Sync::Now, |file| file.write_all(bytes))
}

/// As [`write_atomic`], for content that is too large for the memory: `fill` writes it.
///
/// # Errors
/// As [`write_atomic`], also for what `fill` fails with.
pub fn write_atomic_with(
    path: &Path,
    fill: impl FnOnce(&mut File) -> std::io::Result<()>,
) -> Result<(), FileError> {
    write_with(path, Sync::Now, fill)
}

/// As [`write_atomic`], but the file may still be lost if the machine fails before
/// [`sync_file`]. For many files of which a list is kept: one sync each, while the disk is
/// busy anyway, costs more than all the rest.
pub(super) fn write_unsynced(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    write_with(path, Sync::Later, |file| file.write_all(bytes))
}

/// Waits until a file, or the entries of a directory, are on the disk.
pub(super) fn sync_file(path: &Path) -> Result<(), FileError> {
    let sync = File::open(path).and_then(|file| file.sync_all());
    sync.map_err(FileError::new("sync", path))
}

/// Removes a file; one that is not there is as good.
pub(super) fn remove_if_there(path: &Path) -> Result<(), FileError> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(FileError::new("remove", path)(error))
        }
        _ => Ok(()),
    }
}

/// Whether an open file is still the one at a path: its owner may have removed it.
pub(super) fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    match (file.metadata(), path.metadata()) {
        (Ok(open), Ok(there)) => (open.dev(), open.ino()) == (there.dev(), there.ino()),
        _ => false,
    }
}

#[derive(Clone, Copy)]
enum Sync {
    Now,
    Later,
}

fn write_with(
    path: &Path,
    sync: Sync,
    fill: impl FnOnce(&mut File) -> std::io::Result<()>,
) -> Result<(), FileError> {
    let directory = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let write = || {
        let mut temporary = tempfile::Builder::new()
            .prefix(TEMPORARY_PREFIX)
            .permissions(permissions())
            .tempfile_in(directory)?;
        fill(temporary.as_file_mut())?;
        if matches!(sync, Sync::Now) {
            temporary.as_file().sync_all()?;
        }
        temporary.persist(path).map_err(|error| error.error)?;
        Ok(())
    };
    write().map_err(FileError::new("write", path))?;
    match sync {
        // The rename itself lasts only once the directory is on the disk.
        Sync::Now => sync_file(directory),
        Sync::Later => Ok(()),
    }
}

/// Readable by all, as a plain `File::create` would make it (temporary files default to 0600).
fn permissions() -> std::fs::Permissions {
    std::os::unix::fs::PermissionsExt::from_mode(0o644)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_temporary() {
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join("file");
        write_atomic(&path, b"old").expect("written");
        let failure = write_with(&path, Sync::Now, |file| {
            file.write_all(b"new")?;
            Err(std::io::Error::other("power cut"))
        });
        assert!(failure.expect_err("failed").to_string().contains("power cut"));
        assert_eq!(std::fs::read(&path).expect("read"), b"old");
        assert_eq!(std::fs::read_dir(dir.path()).expect("listed").count(), 1);
    }
}
