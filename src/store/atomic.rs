//! Writing a file so that it is whole or absent.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use crate::error::FileError;

/// Prefix of temporary names; a leftover of a killed run is recognised by it.
pub(super) const TEMPORARY_PREFIX: &str = ".holescout-tmp-";

/// Writes `bytes` under a temporary name beside `path`, syncs, and renames.
///
/// # Errors
/// [`FileError`] with the path and the operating system's reason; nothing is left behind.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    write_atomic_with(path, |file| file.write_all(bytes))
}

/// As [`write_atomic`], for content that is produced piece by piece.
///
/// # Errors
/// [`FileError`] with the path and the operating system's reason; nothing is left behind.
pub fn write_atomic_with(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<&File>) -> std::io::Result<()>,
) -> Result<(), FileError> {
    let directory = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let write = || {
        let temporary = tempfile::Builder::new()
            .prefix(TEMPORARY_PREFIX)
            .permissions(permissions())
            .tempfile_in(directory)?;
        let mut buffered = BufWriter::new(temporary.as_file());
        fill(&mut buffered)?;
        buffered.flush()?;
        drop(buffered);
        temporary.as_file().sync_all()?;
        temporary.persist(path).map_err(|error| error.error)?;
        // The rename itself lasts only once the directory is on the disk.
        File::open(directory)?.sync_all()
    };
    write().map_err(FileError::new("write", path))
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
        let failure = write_atomic_with(&path, |file| {
            file.write_all(b"new")?;
            Err(std::io::Error::other("power cut"))
        });
        assert!(failure.expect_err("failed").to_string().contains("power cut"));
        assert_eq!(std::fs::read(&path).expect("read"), b"old");
        assert_eq!(std::fs::read_dir(dir.path()).expect("listed").count(), 1);
    }
}
