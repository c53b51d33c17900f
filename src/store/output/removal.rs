//! Removing what a run replaces or leaves over: only what lists of our own name.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::path::{Path, PathBuf};

use super::journal::Journal;
use crate::error::FileError;
use crate::store::Digest;
use crate::store::atomic::{TEMPORARY_PREFIX, remove_if_there};
use crate::store::{MANIFEST, SUMS, parse_sums, stays_inside};

/// Removes a finished output: the manifest first, so that nobody takes the rest for whole,
/// and the list of its files last, so that an interrupted removal can go on. What an interrupted
/// run has finished is kept: it may have been killed between the list and the manifest.
pub(super) fn remove_finished(root: &Path, kept: &HashSet<&str>) -> Result<(), FileError> {
    remove_if_there(&root.join(MANIFEST))?;
    if let Ok(sums) = std::fs::read_to_string(root.join(SUMS)) {
        let listed = parse_sums(&sums).unwrap_or_default();
        remove_inside(
            root,
            listed.into_iter().map(|(_, name)| name).filter(|n| !kept.contains(n)),
        )?;
        remove_if_there(&root.join(SUMS))?;
    }
    Ok(())
}

/// Removes files by names that come from a disk and must not lead out of their directory, and
/// the directories below it that are empty then.
pub(super) fn remove_inside<'a>(
    root: &Path,
    names: impl Iterator<Item = &'a str>,
) -> Result<(), FileError> {
    for name in names.filter(|name| stays_inside(name)) {
        let path = root.join(name);
        remove_if_there(&path)?;
        if let Some(parent) = path.parent().filter(|parent| *parent != root) {
            // It fails where other files are left, as it should.
            let _ = std::fs::remove_dir(parent);
        }
    }
    Ok(())
}

/// Removes temporary files of killed runs, and items of the journals that the finished output
/// does not list.
pub(super) fn remove_leftovers(
    root: &Path,
    files: &BTreeMap<String, Digest>,
) -> Result<(), FileError> {
    for journal in Journal::all(root) {
        remove_inside(root, journal.files().filter(|name| !files.contains_key(*name)))?;
    }
    for directory in directories(root, files) {
        let entries = std::fs::read_dir(&directory).map_err(FileError::new("list", &directory))?;
        for entry in entries.flatten() {
            if entry.file_name().to_string_lossy().starts_with(TEMPORARY_PREFIX) {
                remove_if_there(&entry.path())?;
            }
        }
    }
    Ok(())
}

/// The directory of an output and those below it that hold its files.
pub(super) fn directories(root: &Path, files: &BTreeMap<String, Digest>) -> BTreeSet<PathBuf> {
    let below = files.keys().filter_map(|name| root.join(name).parent().map(Path::to_owned));
    below.chain([root.to_owned()]).collect()
}
