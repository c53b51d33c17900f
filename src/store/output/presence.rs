//! What a directory holds before a run begins.

use std::path::Path;

use rayon::prelude::*;
use serde::Deserialize;

use super::error::OutputError;
use super::journal::{self, Journal, Plan};
use super::part::{BuildMode, Part};
use crate::error::FileError;
use crate::progress::Progress;
use crate::store::atomic::TEMPORARY_PREFIX;
use crate::store::sha256_file;
use crate::store::{MANIFEST, SUMS, parse_sums};

/// What to do about a directory that is taken.
const REPLACE: &str = "choose another directory, or pass --overwrite to replace it";
const REMOVE: &str = "choose another directory, or remove this one";
const FINISH: &str = "run it again as it was, or choose another directory";

/// The fields that all manifests share, enough to tell whose a directory is.
#[derive(Debug, Deserialize)]
struct AnyManifest {
    schema: String,
    fingerprint: String,
}

enum Present {
    Nothing,
    Ours(Plan),
    Foreign(String),
}

/// Checks that a run may fill a directory.
pub(super) fn check(root: &Path, expected: &Plan, mode: BuildMode) -> Result<(), OutputError> {
    demand_outside(root)?;
    let stage = &expected.stage;
    let occupied = |found: String, expected: String, mend| OutputError::Occupied {
        path: root.to_owned(),
        found,
        expected,
        mend,
    };
    let foreign = |example| OutputError::Foreign { path: root.to_owned(), example };
    let journals = Journal::all(root);
    let overwrite = mode.overwrite && mode.part == Part::Whole;
    match present(root, expected, &journals)? {
        Present::Nothing => {}
        Present::Ours(plan) if plan == *expected => {}
        Present::Ours(plan) if plan.stage != *stage => {
            return Err(foreign(format!("{} of another stage", plan.stage)));
        }
        Present::Ours(_) if overwrite => {}
        Present::Ours(_) => {
            let mend = if mode.part == Part::Whole { REPLACE } else { REMOVE };
            let found = format!("the {stage} of other inputs or another configuration");
            return Err(occupied(found, format!("the {stage} of these inputs"), mend));
        }
        Present::Foreign(example) => return Err(foreign(example)),
    }
    let Some(tasks) = mode.tasks() else {
        return Ok(());
    };
    for Journal { path, task, .. } in &journals {
        let expected = || format!("the parts of {tasks} tasks");
        match task {
            Some(task) if task.count == tasks => {}
            Some(task) => {
                let found = format!("parts of {} tasks", task.count);
                return Err(occupied(found, expected(), FINISH));
            }
            None if journal::is_locked(path) => {
                return Err(OutputError::Busy { path: root.to_owned() });
            }
            None => {
                let found = "what an interrupted run without --task-count left".to_owned();
                return Err(occupied(found, expected(), FINISH));
            }
        }
    }
    Ok(())
}

fn present(root: &Path, expected: &Plan, journals: &[Journal]) -> Result<Present, FileError> {
    let begun = journals.iter().map(|journal| &journal.plan);
    let begun = begun.filter(|plan| **plan != Plan::default());
    let other = begun.clone().find(|plan| *plan != expected);
    if let Some(plan) = other.or_else(|| begun.clone().next()) {
        return Ok(Present::Ours(plan.clone()));
    }
    if let Some(plan) = finished(root) {
        return Ok(Present::Ours(plan));
    }
    match std::fs::read_dir(root) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Present::Nothing),
        Err(error) => Err(FileError::new("list", root)(error)),
        Ok(entries) => {
            // A run that was killed right away leaves an empty journal at most.
            let names = entries.flatten().map(|entry| entry.file_name());
            let mut names = names.map(|name| name.to_string_lossy().into_owned());
            let ours = |name: &str| journal::is_journal(name) || name.starts_with(TEMPORARY_PREFIX);
            Ok(names.find(|name| !ours(name)).map_or(Present::Nothing, Present::Foreign))
        }
    }
}

/// Demands that a directory lies in no finished output: whatever that does not list would damage it.
///
/// # Errors
/// [`OutputError::Inside`].
pub(crate) fn demand_outside(root: &Path) -> Result<(), OutputError> {
    let path = std::path::absolute(root).map_err(FileError::new("find", root))?;
    // What is not there yet has no links to be followed.
    let there = path.ancestors().find_map(|above| above.canonicalize().ok().map(|at| (above, at)));
    let Some((above, at)) = there else { return Ok(()) };
    let beginning = if above == path { at.parent() } else { Some(&*at) };
    match beginning.into_iter().flat_map(Path::ancestors).find(|above| finished(above).is_some()) {
        Some(output) => {
            Err(OutputError::Inside { path: root.to_owned(), output: output.to_owned() })
        }
        None => Ok(()),
    }
}

/// What the manifest of a finished output says.
fn finished(root: &Path) -> Option<Plan> {
    let text = std::fs::read(root.join(MANIFEST)).ok()?;
    let AnyManifest { schema, fingerprint } = serde_json::from_slice(&text).ok()?;
    let (stage, _) = schema.split_once(".v")?;
    Some(Plan { stage: stage.to_owned(), fingerprint })
}

/// Whether the output is finished already, every file of it.
///
/// # Errors
/// [`OutputError::Damaged`] if it was finished, but a file is no longer what it was.
pub(super) fn is_whole(
    root: &Path,
    expected: &Plan,
    progress: &dyn Progress,
) -> Result<bool, OutputError> {
    if finished(root).as_ref() != Some(expected) {
        return Ok(false);
    }
    let damaged = |file: &str| OutputError::Damaged { path: root.to_owned(), file: file.into() };
    let text = std::fs::read_to_string(root.join(SUMS)).map_err(|_| damaged(SUMS))?;
    let sums = parse_sums(&text).map_err(|_| damaged(SUMS))?;
    progress.begin("comparing checksums", Some(sums.len() as u64));
    let differing = sums.par_iter().find_first(|(expected, name)| {
        progress.advance(1);
        !sha256_file(&root.join(name)).is_ok_and(|found| found.sha256 == *expected)
    });
    progress.end();
    match differing {
        Some((_, name)) => Err(damaged(name)),
        None if sums.iter().any(|(_, name)| *name == MANIFEST) => Ok(true),
        None => Err(damaged(SUMS)),
    }
}
