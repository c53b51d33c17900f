//! The journal of a build: what is built, and what of it is done.
//!
//! A run that builds all of an output keeps one journal; of several tasks each keeps its own
//! and ends it with a line that counts and hashes all others, so that a task that is done is told
//! from one that was killed.

use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::OutputError;
use super::part::Task;
use crate::error::FileError;
use crate::store::atomic::is_at;
use crate::store::{Digest, sha256_bytes};

/// Name of the journal of a run that builds all.
pub(super) const JOURNAL: &str = ".holescout-build.jsonl";
const TASK_PREFIX: &str = ".holescout-build.";
const TASK_SUFFIX: &str = ".jsonl";

/// What is built: the stage, and the SHA-256 over everything that its output depends on.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Plan {
    pub(super) stage: String,
    pub(super) fingerprint: String,
}

/// An item that is done; one without value is only announced.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Line<T> {
    pub(super) key: String,
    pub(super) files: Vec<(String, Digest)>,
    pub(super) item: T,
}

/// A line that was read.
#[derive(Debug)]
pub(super) struct Noted {
    pub(super) line: Line<Value>,
    /// SHA-256 of its text.
    pub(super) sha256: String,
}

/// The last line of a task's journal.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Done {
    /// Number of items that fell to the task.
    pub(super) done: u64,
    /// SHA-256 over the lines of its items, in the format of `SHA256SUMS`.
    pub(super) sha256: String,
}

impl Done {
    /// Of items by key, each with the SHA-256 of its line.
    pub(super) fn of(items: &BTreeMap<String, String>) -> Self {
        let sums = items.iter().map(|(key, sha256)| [sha256, "  ", key, "\n"].concat());
        let sums: String = sums.collect();
        Self { done: items.len() as u64, sha256: sha256_bytes(sums.as_bytes()).sha256 }
    }
}

/// A journal that was read.
#[derive(Debug, Default)]
pub(super) struct Journal {
    pub(super) path: PathBuf,
    /// Whose it is; `None` for a run that builds all.
    pub(super) task: Option<Task>,
    /// Empty if the run was killed right away.
    pub(super) plan: Plan,
    pub(super) lines: Vec<Noted>,
    /// If nothing follows it.
    pub(super) done: Option<Done>,
}

impl Journal {
    /// Reads a journal with suspicion: what is torn is left out.
    pub(super) fn read(path: &Path, task: Option<Task>) -> Self {
        let mut journal = Self { path: path.to_owned(), task, ..Self::default() };
        let bytes = std::fs::read(path).unwrap_or_default();
        let text = String::from_utf8_lossy(&bytes);
        let mut lines = text.lines();
        let plan = lines.next().map(serde_json::from_str);
        let Some(Ok(plan)) = plan else {
            return journal;
        };
        journal.plan = plan;
        for text in lines {
            if let Ok(line) = serde_json::from_str::<Line<Value>>(text) {
                let sha256 = sha256_bytes(text.as_bytes()).sha256;
                journal.lines.push(Noted { line, sha256 });
                journal.done = None;
            } else if let Ok(done) = serde_json::from_str::<Done>(text) {
                journal.done = Some(done);
            }
        }
        journal
    }

    /// The journals in a directory, that of a run that builds all first.
    pub(super) fn all(root: &Path) -> Vec<Self> {
        let entries = std::fs::read_dir(root).into_iter().flatten().flatten();
        let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
        let mut owners: Vec<Option<Task>> =
            names.filter(|name| is_journal(name)).map(|name| task_of(&name)).collect();
        owners.sort_unstable();
        owners.into_iter().map(|task| Self::read(&root.join(name(task)), task)).collect()
    }

    /// The files that its lines name.
    pub(super) fn files(&self) -> impl Iterator<Item = &str> {
        let files = self.lines.iter().flat_map(|noted| &noted.line.files);
        files.map(|(name, _)| name.as_str())
    }
}

/// The name of a journal.
pub(super) fn name(task: Option<Task>) -> String {
    match task {
        None => JOURNAL.to_owned(),
        Some(Task { index, count }) => format!("{TASK_PREFIX}{index}-of-{count}{TASK_SUFFIX}"),
    }
}

/// Whether a file is a journal, by its name.
pub(super) fn is_journal(file: &str) -> bool {
    file == JOURNAL || task_of(file).is_some()
}

/// Whose journal a file is, if it is a task's.
fn task_of(file: &str) -> Option<Task> {
    let numbers = file.strip_prefix(TASK_PREFIX)?.strip_suffix(TASK_SUFFIX)?;
    let (index, count) = numbers.split_once("-of-")?;
    let task = Task { index: index.parse().ok()?, count: count.parse().ok()? };
    // Only names that this program writes: no leading zeros, no task too many.
    (task.index < task.count && name(Some(task)) == file).then_some(task)
}

/// Appends a line and returns the SHA-256 of its text.
pub(super) fn write_line(journal: &mut File, line: &impl Serialize) -> std::io::Result<String> {
    let mut bytes = serde_json::to_vec(line)?;
    let sha256 = sha256_bytes(&bytes).sha256;
    bytes.push(b'\n');
    journal.write_all(&bytes)?;
    Ok(sha256)
}

/// Opens a file for appending, and locks it for as long as it is open: whoever fills the directory `root`.
///
/// # Errors
/// [`OutputError::Busy`] if another process has locked it.
pub(crate) fn lock(path: &Path, root: &Path, create: bool) -> Result<File, OutputError> {
    let open = File::options().create(create).append(true).open(path);
    let journal = open.map_err(FileError::new("create", path))?;
    match journal.try_lock() {
        Ok(()) if is_at(&journal, path) => Ok(journal),
        Ok(()) | Err(TryLockError::WouldBlock) => Err(OutputError::Busy { path: root.to_owned() }),
        Err(TryLockError::Error(error)) => Err(FileError::new("lock", path)(error).into()),
    }
}

/// Whether another process has locked a journal.
pub(super) fn is_locked(path: &Path) -> bool {
    let Ok(file) = File::open(path) else {
        return false;
    };
    matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_tell_whose_a_journal_is() {
        let task = Task { index: 3, count: 10 };
        assert_eq!(task_of(&name(Some(task))), Some(task));
        assert!(is_journal(&name(None)) && is_journal(&name(Some(task))));
        for other in ["10-of-10", "03-of-10", "1-of-", "of", "-1-of-2", "1-of-2-of-3"] {
            assert!(!is_journal(&format!("{TASK_PREFIX}{other}{TASK_SUFFIX}")), "{other}");
        }
        assert!(!is_journal("manifest.json"));
    }

    #[test]
    fn what_follows_a_done_marker_undoes_it() {
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join(JOURNAL);
        let plan = r#"{"stage":"things","fingerprint":"abc"}"#;
        let item = r#"{"key":"a","files":[],"item":7}"#;
        let done = r#"{"done":1,"sha256":"00"}"#;
        for (lines, items, is_done) in [
            (vec![plan, item, done], 1, true),
            (vec![plan, item, done, item], 2, false),
            (vec![plan, item, done, "{\"key\":\"b"], 1, true),
            (vec!["{\"sta"], 0, false),
        ] {
            std::fs::write(&path, lines.join("\n")).expect("written");
            let journal = Journal::read(&path, None);
            assert_eq!((journal.lines.len(), journal.done.is_some()), (items, is_done));
        }
    }
}
