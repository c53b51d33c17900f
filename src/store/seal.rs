//! Writing and removing sealed directories.

use std::fs::File;
use std::io::Write;
use std::path::Path;

use tempfile::TempDir;

use super::atomic::{TEMPORARY_PREFIX, sync_file};
use super::list::{SUMS, parse_sums};
use super::output::OutputError;
use super::sha256_bytes;
use crate::error::FileError;

/// Writes files and their checksums into a directory under a temporary name, and puts it in the place of
/// the one that is there.
///
/// # Errors
/// [`OutputError::Foreign`] if that one holds anything that it does not list, and when writing fails;
/// the old directory is left as it was then.
pub(crate) fn write_sealed(directory: &Path, files: &[(&str, &[u8])]) -> Result<(), OutputError> {
    demand_own(directory)?;
    let parent = parent(directory);
    std::fs::create_dir_all(parent).map_err(FileError::new("create", parent))?;
    let new = aside(parent)?;
    let mut sums = String::new();
    for (name, bytes) in files {
        write_synced(&new.path().join(name), bytes)?;
        sums.extend([&*sha256_bytes(bytes).sha256, "  ", name, "\n"]);
    }
    write_synced(&new.path().join(SUMS), sums.as_bytes())?;
    sync_file(new.path())?;
    // The old one goes in one step too, and its files are removed when the new one is in its place.
    let _old = take_away(directory)?;
    std::fs::rename(new.keep(), directory).map_err(FileError::new("rename", directory))?;
    Ok(sync_file(parent)?)
}

/// Removes a directory that [`write_sealed`] wrote, at once.
///
/// # Errors
/// As [`write_sealed`].
pub(crate) fn remove_sealed(directory: &Path) -> Result<(), OutputError> {
    demand_own(directory)?;
    let _removed = take_away(directory)?;
    Ok(())
}

/// Removes what killed runs left half-written or half-removed in a directory.
///
/// # Errors
/// When removing fails.
pub(crate) fn remove_unsealed(parent: &Path) -> Result<(), FileError> {
    for entry in std::fs::read_dir(parent).into_iter().flatten().flatten() {
        let path = entry.path();
        if entry.file_name().to_string_lossy().starts_with(TEMPORARY_PREFIX) && path.is_dir() {
            std::fs::remove_dir_all(&path).map_err(FileError::new("remove", &path))?;
        }
    }
    Ok(())
}

fn parent(directory: &Path) -> &Path {
    directory.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// A temporary directory that others may read once it has its name.
fn aside(parent: &Path) -> Result<TempDir, FileError> {
    let readable = std::os::unix::fs::PermissionsExt::from_mode(0o755);
    let builder = &mut tempfile::Builder::new();
    let made = builder.prefix(TEMPORARY_PREFIX).permissions(readable).tempdir_in(parent);
    made.map_err(FileError::new("create", parent))
}

fn write_synced(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    let write = || {
        let mut file = File::create(path)?;
        file.write_all(bytes)?;
        file.sync_all()
    };
    write().map_err(FileError::new("write", path))
}

/// Takes a directory out of the way, if it is there; it is removed when the result is dropped.
fn take_away(directory: &Path) -> Result<Option<TempDir>, FileError> {
    if !directory.exists() {
        return Ok(None);
    }
    let aside = aside(parent(directory))?;
    let to = aside.path().join("old");
    std::fs::rename(directory, to).map_err(FileError::new("rename", directory))?;
    Ok(Some(aside))
}

/// Demands that a directory holds nothing but what its list names.
fn demand_own(directory: &Path) -> Result<(), OutputError> {
    let entries = match std::fs::read_dir(directory) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        other => other.map_err(FileError::new("list", directory))?,
    };
    let sums = std::fs::read_to_string(directory.join(SUMS)).unwrap_or_default();
    let listed = parse_sums(&sums).unwrap_or_default();
    let own = |name: &str| name == SUMS || listed.iter().any(|(_, listed)| *listed == name);
    let names = entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned());
    match { names }.find(|name| !own(name)) {
        Some(example) => Err(OutputError::Foreign { path: directory.to_owned(), example }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::sealed::{SealError, read_sealed};
    use super::*;

    #[test]
    fn a_directory_is_replaced_whole_and_every_change_is_found() {
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join("below").join("sealed");
        write_sealed(&path, &[("a", b"one"), ("b", b"two")]).expect("written");
        write_sealed(&path, &[("a", b"three")]).expect("replaced");
        assert_eq!(read_sealed(&path, "a").expect("sound"), b"three");
        assert!(!path.join("b").exists());
        assert!(matches!(read_sealed(&path, "b"), Err(SealError::List { .. })));
        std::fs::write(path.join("a"), b"thref").expect("changed");
        assert!(matches!(read_sealed(&path, "a"), Err(SealError::Other { .. })));
        std::fs::write(path.join(SUMS), b"no list").expect("changed");
        assert!(matches!(read_sealed(&path, "a"), Err(SealError::List { .. })));
        let parent = path.parent().expect("it has one");
        assert_eq!(std::fs::read_dir(parent).expect("listed").count(), 1, "nothing is left over");
    }

    #[test]
    fn files_of_somebody_else_are_never_removed() {
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join("best");
        std::fs::create_dir(&path).expect("created");
        std::fs::write(path.join("thesis.doc"), b"text").expect("written");
        let refused = write_sealed(&path, &[("a", b"one")]).expect_err("not ours");
        assert!(refused.to_string().contains("thesis.doc"), "{refused}");
        let refused = remove_sealed(&path).expect_err("not ours");
        assert!(refused.to_string().contains("thesis.doc"), "{refused}");
        assert_eq!(std::fs::read(path.join("thesis.doc")).expect("there"), b"text");
    }

    #[test]
    fn what_killed_runs_leave_is_removed() {
        let dir = tempfile::tempdir().expect("a directory");
        let left = dir.path().join(format!("{TEMPORARY_PREFIX}x"));
        std::fs::create_dir_all(left.join("old")).expect("created");
        std::fs::create_dir(dir.path().join("other")).expect("created");
        remove_unsealed(dir.path()).expect("removed");
        assert!(!left.exists() && dir.path().join("other").exists());
    }
}
