//! A directory that a stage fills: resumable, never half-done under a final name.
//!
//! While a build runs, the directory holds a journal (`.holescout-build.jsonl`): its first
//! line says which stage builds from which inputs, every further line names an item that
//! is done, with the digests of its files. A killed build leaves the journal and no
//! manifest; the next run with the same inputs takes over what the journal vouches for.
//! The manifest is written last and the journal removed after it, so a directory with a
//! manifest is whole.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use rayon::prelude::*;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::atomic::{TEMPORARY_PREFIX, is_at, sync_file, write_unsynced};
use super::{Digest, sha256_bytes, sha256_file, write_atomic};
use crate::error::{Fault, FileError, HasFault};

/// Name of a stage's manifest.
pub const MANIFEST: &str = "manifest.json";
/// Name of the list of checksums, in the format of `sha256sum`.
pub const SUMS: &str = "SHA256SUMS";
const JOURNAL: &str = ".holescout-build.jsonl";

/// Why a directory cannot be used or filled.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// Reading or writing failed.
    #[error(transparent)]
    File(#[from] FileError),
    /// The directory holds the output of other inputs.
    #[error(
        "{} holds {found}, not {expected}: choose another directory, \
         or pass --overwrite to replace it", path.display()
    )]
    Occupied {
        /// The directory.
        path: PathBuf,
        /// What is there.
        found: String,
        /// What would have been written.
        expected: String,
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
    /// Another process is writing there now.
    #[error("{} is being written by another run of holescout", path.display())]
    Busy {
        /// The directory.
        path: PathBuf,
    },
}

impl HasFault for OutputError {
    fn fault(&self) -> Fault {
        match self {
            Self::File(error) => error.fault(),
            Self::Occupied { .. } | Self::Foreign { .. } | Self::Busy { .. } => Fault::Input,
        }
    }
}

/// What is built: the stage, and the SHA-256 over everything that its output depends on.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Plan {
    stage: String,
    fingerprint: String,
}

#[derive(Debug, Serialize, Deserialize)]
struct Line<T> {
    key: String,
    files: Vec<(String, Digest)>,
    item: T,
}

/// The fields that all manifests share, enough to tell whose a directory is.
#[derive(Debug, Deserialize)]
struct AnyManifest {
    schema: String,
    fingerprint: String,
}

/// A directory being filled.
#[derive(Debug)]
pub struct OutputDir {
    root: PathBuf,
    journal: Mutex<File>,
    earlier: HashMap<String, Line<serde_json::Value>>,
    files: Mutex<BTreeMap<String, Digest>>,
}

impl OutputDir {
    /// Checks that a directory can take a stage's output, without changing anything.
    ///
    /// # Errors
    /// [`OutputError::Occupied`] if it holds something else.
    pub fn check(
        root: &Path,
        stage: &str,
        fingerprint: &str,
        overwrite: bool,
    ) -> Result<(), OutputError> {
        let expected = Plan { stage: stage.to_owned(), fingerprint: fingerprint.to_owned() };
        let occupied = |found: String| OutputError::Occupied {
            path: root.to_owned(),
            found,
            expected: format!("the {stage} of these inputs"),
        };
        match present(root)? {
            Present::Nothing => Ok(()),
            Present::Ours(plan) if plan == expected => Ok(()),
            Present::Ours(plan) if plan.stage == expected.stage && overwrite => Ok(()),
            Present::Ours(plan) if plan.stage == expected.stage => {
                Err(occupied(format!("the {stage} of other inputs or another configuration")))
            }
            Present::Ours(plan) => Err(OutputError::Foreign {
                path: root.to_owned(),
                example: format!("{} of another stage", plan.stage),
            }),
            Present::Foreign(example) => {
                Err(OutputError::Foreign { path: root.to_owned(), example })
            }
        }
    }

    /// Begins or resumes filling a directory. With `overwrite`, an output of the same stage
    /// from other inputs is removed first; files of anyone else never are.
    ///
    /// # Errors
    /// As [`OutputDir::check`], and when writing fails.
    pub fn begin(
        root: &Path,
        stage: &str,
        fingerprint: &str,
        overwrite: bool,
    ) -> Result<Self, OutputError> {
        Self::check(root, stage, fingerprint, overwrite)?;
        std::fs::create_dir_all(root).map_err(FileError::new("create", root))?;
        let path = root.join(JOURNAL);
        let in_journal = |action| FileError::new(action, &path);
        let mut journal = OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path)
            .map_err(in_journal("create"))?;
        if journal.try_lock().is_err() || !is_at(&journal, &path) {
            return Err(OutputError::Busy { path: root.to_owned() });
        }
        // Once more under the lock: another run may have been here in between.
        Self::check(root, stage, fingerprint, overwrite)?;
        let plan = Plan { stage: stage.to_owned(), fingerprint: fingerprint.to_owned() };
        let (earlier_plan, lines) = read_journal(root).unwrap_or_default();
        let mut earlier = HashMap::new();
        if earlier_plan == plan {
            // A torn last line must not swallow the next one.
            journal.write_all(b"\n").map_err(in_journal("write"))?;
            earlier.extend(lines.into_iter().map(|line| (line.key.clone(), line)));
        } else {
            // What an interrupted build of other inputs wrote, as long as its journal tells.
            remove_inside(root, names(lines))?;
            journal.set_len(0).map_err(in_journal("write"))?;
            write_line(&mut journal, &plan).map_err(in_journal("write"))?;
        }
        let kept =
            earlier.values().flat_map(|line| line.files.iter().map(|(name, _)| name.as_str()));
        remove_finished(root, &kept.collect())?;
        Ok(Self {
            root: root.to_owned(),
            journal: Mutex::new(journal),
            earlier,
            files: Mutex::default(),
        })
    }

    /// An item that an earlier, interrupted run finished, if its files are still what the
    /// journal says.
    pub fn finished<T: DeserializeOwned>(&self, key: &str) -> Option<T> {
        let line = self.earlier.get(key)?;
        let item = serde_json::from_value(line.item.clone()).ok()?;
        let sound = |(name, digest): &(String, Digest)| {
            sha256_file(&self.root.join(name)).is_ok_and(|found| found == *digest)
        };
        if !line.files.iter().all(sound) {
            return None;
        }
        line.files.iter().for_each(|(name, digest)| self.remember(name, digest));
        Some(item)
    }

    /// Writes the files of an item, by name and content, and notes in the journal that the item
    /// `key` is done. `item` is given the digests of the files, in their order.
    ///
    /// # Errors
    /// When writing fails; the item then counts as not done.
    pub fn finish_item<T: Serialize>(
        &self,
        key: &str,
        files: &[(&str, &[u8])],
        item: impl FnOnce(&[Digest]) -> T,
    ) -> Result<T, FileError> {
        let digests: Vec<Digest> = files.iter().map(|(_, bytes)| sha256_bytes(bytes)).collect();
        let named = files.iter().zip(&digests);
        let files_of_item: Vec<(String, Digest)> =
            named.map(|((name, _), digest)| ((*name).to_owned(), digest.clone())).collect();
        if !files.is_empty() {
            // Announced first, so that no file is there of which the journal knows nothing.
            let announced = files_of_item.clone();
            self.note(&Line { key: key.to_owned(), files: announced, item: () })?;
        }
        for ((name, bytes), digest) in files.iter().zip(&digests) {
            self.put(name, bytes, digest)?;
        }
        let line = Line { key: key.to_owned(), files: files_of_item, item: item(&digests) };
        self.note(&line)?;
        Ok(line.item)
    }

    /// Appends a line to the journal.
    fn note(&self, line: &impl Serialize) -> Result<(), FileError> {
        let mut journal = self.journal.lock().expect("no writer panics while it holds the lock");
        write_line(&mut journal, line).map_err(FileError::new("write", &self.root.join(JOURNAL)))
    }

    /// Writes a file that belongs to the output as a whole. It is on the disk for good once
    /// the output is complete; until then its hash in the journal is what it is trusted by.
    ///
    /// # Errors
    /// When writing fails; the file is then absent.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<Digest, FileError> {
        let digest = sha256_bytes(bytes);
        self.put(name, bytes, &digest)?;
        Ok(digest)
    }

    fn put(&self, name: &str, bytes: &[u8], digest: &Digest) -> Result<(), FileError> {
        let path = self.root.join(name);
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent).map_err(FileError::new("create", parent))?;
        }
        write_unsynced(&path, bytes)?;
        self.remember(name, digest);
        Ok(())
    }

    /// Completes the output: checksums, manifest, end of the journal.
    ///
    /// # Errors
    /// When writing fails; the directory then still counts as unfinished.
    pub fn complete(self, manifest: &[u8]) -> Result<Digest, FileError> {
        let digest = sha256_bytes(manifest);
        self.remember(MANIFEST, &digest);
        let files = self.files.into_inner().expect("no writer panics while it holds the lock");
        let lines = files.iter().map(|(name, digest)| [&digest.sha256, "  ", name, "\n"].concat());
        let sums: String = lines.collect();
        remove_leftovers(&self.root, &files)?;
        sync_all(&self.root, &files)?;
        write_atomic(&self.root.join(SUMS), sums.as_bytes())?;
        write_atomic(&self.root.join(MANIFEST), manifest)?;
        let journal = self.root.join(JOURNAL);
        std::fs::remove_file(&journal).map_err(FileError::new("remove", &journal))?;
        Ok(digest)
    }

    fn remember(&self, name: &str, digest: &Digest) {
        let mut files = self.files.lock().expect("no writer panics while it holds the lock");
        files.insert(name.to_owned(), digest.clone());
    }
}

/// The lines of a `SHA256SUMS` file as (digest, name).
///
/// # Errors
/// The first line that is malformed or names something outside of the directory.
pub fn parse_sums(text: &str) -> Result<Vec<(&str, &str)>, &str> {
    let sound = |&(digest, name): &(&str, &str)| digest.len() == 64 && stays_inside(name);
    text.lines().map(|line| line.split_once("  ").filter(sound).ok_or(line)).collect()
}

/// A list of files comes from a disk: it must not lead out of its directory.
fn stays_inside(name: &str) -> bool {
    Path::new(name).components().all(|part| matches!(part, std::path::Component::Normal(_)))
}

enum Present {
    Nothing,
    Ours(Plan),
    Foreign(String),
}

fn present(root: &Path) -> Result<Present, FileError> {
    if let Some((plan, _)) = read_journal(root).filter(|(plan, _)| *plan != Plan::default()) {
        return Ok(Present::Ours(plan));
    }
    if let Ok(text) = std::fs::read(root.join(MANIFEST))
        && let Ok(manifest) = serde_json::from_slice::<AnyManifest>(&text)
        && let Some((stage, _)) = manifest.schema.split_once(".v")
    {
        let (stage, fingerprint) = (stage.to_owned(), manifest.fingerprint);
        return Ok(Present::Ours(Plan { stage, fingerprint }));
    }
    match std::fs::read_dir(root) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Present::Nothing),
        Err(error) => Err(FileError::new("list", root)(error)),
        Ok(entries) => {
            // A run that was killed right away leaves an empty journal at most.
            let names = entries.flatten().map(|entry| entry.file_name());
            let mut names = names.map(|name| name.to_string_lossy().into_owned());
            let ours = |name: &str| name == JOURNAL || name.starts_with(TEMPORARY_PREFIX);
            Ok(names.find(|name| !ours(name)).map_or(Present::Nothing, Present::Foreign))
        }
    }
}

fn read_journal(root: &Path) -> Option<(Plan, Vec<Line<serde_json::Value>>)> {
    let text = std::fs::read_to_string(root.join(JOURNAL)).ok()?;
    let mut lines = text.lines();
    let plan = match lines.next() {
        // Killed between creating the journal and its first line.
        None => Plan::default(),
        Some(line) => serde_json::from_str(line).ok()?,
    };
    Some((plan, lines.filter_map(|line| serde_json::from_str(line).ok()).collect()))
}

fn write_line(journal: &mut File, line: &impl Serialize) -> std::io::Result<()> {
    let mut bytes = serde_json::to_vec(line)?;
    bytes.push(b'\n');
    journal.write_all(&bytes)
}

/// Removes a finished output: the manifest first, so that nobody takes the rest for whole,
/// and the list of its files last, so that an interrupted removal can go on. What an interrupted
/// run has finished is kept: it may have been killed between the list and the manifest.
fn remove_finished(root: &Path, kept: &HashSet<&str>) -> Result<(), FileError> {
    remove_if_there(&root.join(MANIFEST))?;
    if let Ok(sums) = std::fs::read_to_string(root.join(SUMS)) {
        let listed = parse_sums(&sums).unwrap_or_default();
        let gone = listed.into_iter().map(|(_, name)| name).filter(|name| !kept.contains(name));
        remove_inside(root, gone.map(str::to_owned))?;
        remove_if_there(&root.join(SUMS))?;
    }
    Ok(())
}

/// The files that lines of a journal name.
fn names(lines: Vec<Line<serde_json::Value>>) -> impl Iterator<Item = String> {
    lines.into_iter().flat_map(|line| line.files).map(|(name, _)| name)
}

/// Removes files by names that come from a disk and must not lead out of their directory, and
/// the directories below it that are empty then.
fn remove_inside(root: &Path, names: impl Iterator<Item = String>) -> Result<(), FileError> {
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

/// Waits until all files and the directories that name them are on the disk.
fn sync_all(root: &Path, files: &BTreeMap<String, Digest>) -> Result<(), FileError> {
    let written: Vec<&String> = files.keys().filter(|name| *name != MANIFEST).collect();
    written.par_iter().try_for_each(|name| sync_file(&root.join(name)))?;
    directories(root, files).iter().try_for_each(|directory| sync_file(directory))
}

/// The directory of an output and those below it that hold its files.
fn directories(root: &Path, files: &BTreeMap<String, Digest>) -> BTreeSet<PathBuf> {
    let below = files.keys().filter_map(|name| root.join(name).parent().map(Path::to_owned));
    below.chain([root.to_owned()]).collect()
}

/// Removes temporary files of killed runs, and items of the journal that the finished
/// output does not list.
fn remove_leftovers(root: &Path, files: &BTreeMap<String, Digest>) -> Result<(), FileError> {
    if let Some((_, lines)) = read_journal(root) {
        remove_inside(root, names(lines).filter(|name| !files.contains_key(name)))?;
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

fn remove_if_there(path: &Path) -> Result<(), FileError> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(FileError::new("remove", path)(error))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MANIFEST_TEXT: &[u8] = br#"{"schema":"things.v1","fingerprint":"abc"}"#;

    fn begin(root: &Path, fingerprint: &str, overwrite: bool) -> Result<OutputDir, OutputError> {
        OutputDir::begin(root, "things", fingerprint, overwrite)
    }

    fn fill(output: &OutputDir) {
        output.finish_item("a", &[("a.bin", b"A")], |_| 7).expect("written");
    }

    #[test]
    fn an_interrupted_build_is_resumed_and_a_damaged_item_is_not_trusted() {
        let dir = tempfile::tempdir().expect("a directory");
        fill(&begin(dir.path(), "abc", false).expect("begun"));
        let resumed = begin(dir.path(), "abc", false).expect("resumed");
        assert_eq!(resumed.finished::<i32>("a"), Some(7));
        assert_eq!(resumed.finished::<i32>("b"), None);
        std::fs::write(dir.path().join("a.bin"), b"B").expect("damaged");
        assert_eq!(resumed.finished::<i32>("a"), None);
    }

    /// Killed between the list of files and the manifest, a run loses nothing that it finished.
    #[test]
    fn what_a_run_has_finished_outlives_the_list_of_its_files() {
        let dir = tempfile::tempdir().expect("a directory");
        let output = begin(dir.path(), "abc", false).expect("begun");
        fill(&output);
        output.write("table.csv", b"1").expect("written");
        drop(output);
        let line = |name: &str| format!("{}  {name}\n", "0".repeat(64));
        let sums = [line("a.bin"), line("table.csv")].concat();
        std::fs::write(dir.path().join(SUMS), sums).expect("written");
        let resumed = begin(dir.path(), "abc", false).expect("resumed");
        assert_eq!(resumed.finished::<i32>("a"), Some(7));
        assert!(!dir.path().join("table.csv").exists(), "written again in the end");
    }

    #[test]
    fn an_item_of_several_files_is_trusted_as_a_whole_and_removed_with_its_directory() {
        let dir = tempfile::tempdir().expect("a directory");
        let files: [(&str, &[u8]); 2] = [("a/one.bin", b"1"), ("a/two.bin", b"22")];
        let output = begin(dir.path(), "abc", false).expect("begun");
        let sizes = output.finish_item("a", &files, |digests| {
            digests.iter().map(|digest| digest.bytes).collect::<Vec<_>>()
        });
        assert_eq!(sizes.expect("written"), [1, 2]);
        drop(output);
        let resumed = begin(dir.path(), "abc", false).expect("resumed");
        assert_eq!(resumed.finished::<Vec<u64>>("a"), Some(vec![1, 2]));
        std::fs::write(dir.path().join("a/two.bin"), b"23").expect("damaged");
        assert_eq!(resumed.finished::<Vec<u64>>("a"), None);
        drop(resumed);
        drop(begin(dir.path(), "xyz", true).expect("overwritten"));
        assert!(!dir.path().join("a").exists());
    }

    #[test]
    fn a_torn_journal_line_is_ignored() {
        let dir = tempfile::tempdir().expect("a directory");
        fill(&begin(dir.path(), "abc", false).expect("begun"));
        let path = dir.path().join(JOURNAL);
        let text = std::fs::read_to_string(&path).expect("read");
        std::fs::write(&path, format!("{text}{{\"key\":\"b\",\"fi")).expect("torn");
        let resumed = begin(dir.path(), "abc", false).expect("resumed");
        resumed.finish_item("c", &[], |_| 9).expect("written");
        drop(resumed);
        let again = begin(dir.path(), "abc", false).expect("resumed");
        assert_eq!(again.finished::<i32>("a"), Some(7));
        assert_eq!(again.finished::<i32>("c"), Some(9));
    }

    #[test]
    fn a_complete_output_has_sums_and_no_journal() {
        let dir = tempfile::tempdir().expect("a directory");
        let output = begin(dir.path(), "abc", false).expect("begun");
        fill(&output);
        std::fs::write(dir.path().join(format!("{TEMPORARY_PREFIX}x")), b"").expect("leftover");
        output.complete(MANIFEST_TEXT).expect("completed");
        let mut names: Vec<_> = std::fs::read_dir(dir.path())
            .expect("listed")
            .map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8"))
            .collect();
        names.sort();
        assert_eq!(names, [SUMS, "a.bin", MANIFEST]);
        let sums = std::fs::read_to_string(dir.path().join(SUMS)).expect("read");
        assert_eq!(parse_sums(&sums).map(|sums| sums.len()), Ok(2));
        assert_eq!(parse_sums("0  ../a"), Err("0  ../a"));
    }

    #[test]
    fn other_outputs_and_foreign_files_are_safe() {
        let dir = tempfile::tempdir().expect("a directory");
        let output = begin(dir.path(), "abc", false).expect("begun");
        fill(&output);
        output.complete(MANIFEST_TEXT).expect("completed");
        let refused = begin(dir.path(), "xyz", false).expect_err("another fingerprint");
        assert!(refused.to_string().contains("--overwrite"), "{refused}");
        assert!(dir.path().join("a.bin").exists());
        let stage = OutputDir::begin(dir.path(), "others", "abc", true).expect_err("other stage");
        assert!(matches!(stage, OutputError::Foreign { .. }));
        drop(begin(dir.path(), "xyz", true).expect("overwritten"));
        assert!(!dir.path().join("a.bin").exists());

        let foreign = tempfile::tempdir().expect("a directory");
        std::fs::write(foreign.path().join("thesis.doc"), b"text").expect("written");
        let refused = begin(foreign.path(), "abc", true).expect_err("not ours");
        assert!(refused.to_string().contains("thesis.doc"), "{refused}");
    }

    #[test]
    fn two_runs_do_not_write_to_one_directory() {
        let dir = tempfile::tempdir().expect("a directory");
        let _first = begin(dir.path(), "abc", false).expect("begun");
        let second = begin(dir.path(), "abc", false).expect_err("busy");
        assert!(matches!(second, OutputError::Busy { .. }));
    }
}
