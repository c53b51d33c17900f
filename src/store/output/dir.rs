//! The directory itself: journals, items, files.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use rayon::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::error::{Gap, OutputError};
use super::journal::{self, Done, Journal, Line, Noted, Plan, lock, write_line};
use super::part::{BuildMode, Part, Task, TaskReport};
use super::presence;
use super::removal::{directories, remove_finished, remove_inside, remove_leftovers};
use super::syncer::Syncer;
use crate::error::FileError;
use crate::progress::Progress;
use crate::store::atomic::{remove_if_there, sync_file, write_unsynced};
use crate::store::{Digest, MANIFEST, SUMS, sha256_bytes, sha256_file, stays_inside, write_atomic};

/// A directory being filled.
#[derive(Debug)]
pub(super) struct OutputDir {
    root: PathBuf,
    part: Part,
    /// The journal of this run, locked; a merge builds nothing and has none.
    journal: Option<(PathBuf, Mutex<File>)>,
    /// Journals of tasks that this run takes over, each with its lock.
    taken_over: Vec<(Journal, File)>,
    /// What earlier runs noted, unseen.
    noted: HashMap<String, Noted>,
    /// What of it has proved sound.
    sound: HashMap<String, Noted>,
    /// Items of the plan.
    planned: usize,
    /// Items that this run answers for, and what is noted of those that are done.
    items: Mutex<BTreeMap<String, String>>,
    files: Mutex<BTreeMap<String, Digest>>,
    syncer: Syncer,
}

impl OutputDir {
    /// Checks that a directory can take a stage's output, without changing anything.
    ///
    /// # Errors
    /// [`OutputError::Occupied`] if it holds something else.
    pub(super) fn check(root: &Path, plan: &Plan, mode: BuildMode) -> Result<(), OutputError> {
        presence::check(root, plan, mode)
    }

    /// The manifest, if a task or a merge finds that the output is whole already, every file of
    /// it: their work is done. A run that builds all builds it again.
    ///
    /// # Errors
    /// [`OutputError::Damaged`] if it was whole once.
    pub(super) fn whole(
        root: &Path,
        plan: &Plan,
        mode: BuildMode,
        progress: &dyn Progress,
    ) -> Result<Option<Vec<u8>>, OutputError> {
        let part_of_whole = mode.part != Part::Whole;
        if !(part_of_whole && presence::is_whole(root, plan, progress)?) {
            return Ok(None);
        }
        if let Part::Merge { .. } = mode.part {
            // A merge that was killed in its last step leaves journals that vouch for nothing more.
            for Journal { path, .. } in Journal::all(root) {
                let _lock = lock(&path, root, false)?;
                remove_if_there(&path)?;
            }
        }
        let manifest = root.join(MANIFEST);
        Ok(Some(std::fs::read(&manifest).map_err(FileError::new("read", &manifest))?))
    }

    /// Begins or resumes filling a directory. With `overwrite`, an output of the same stage
    /// from other inputs is removed first; files of anyone else never are.
    ///
    /// # Errors
    /// As [`OutputDir::check`], and when writing fails.
    pub(super) fn begin(root: &Path, plan: &Plan, mode: BuildMode) -> Result<Self, OutputError> {
        presence::check(root, plan, mode)?;
        let mut output = Self {
            root: root.to_owned(),
            part: mode.part,
            journal: None,
            taken_over: Vec::new(),
            noted: HashMap::new(),
            sound: HashMap::new(),
            planned: 0,
            items: Mutex::default(),
            files: Mutex::default(),
            syncer: Syncer::start(),
        };
        let begun = match mode.part {
            Part::Whole => output.begin_whole(plan, mode),
            Part::Task(task) => output.begin_task(plan, task, mode),
            Part::Merge { .. } => output.take_over_tasks(plan),
        };
        match (begun, &output.journal) {
            (Err(error), Some((path, _))) => {
                // An empty journal would be in the way of the run that belongs here.
                if path.metadata().is_ok_and(|journal| journal.len() == 0) {
                    remove_if_there(path)?;
                }
                Err(error)
            }
            (begun, _) => begun.map(|()| output),
        }
    }

    fn begin_whole(&mut self, plan: &Plan, mode: BuildMode) -> Result<(), OutputError> {
        let path = self.open_journal(None)?;
        // Once more under the lock: another run may have been here in between.
        presence::check(&self.root, plan, mode)?;
        self.take_over_tasks(plan)?;
        self.resume(&path, plan)?;
        let lines = self.noted.values().map(|noted| &noted.line);
        let kept = lines.flat_map(|line| line.files.iter().map(|(name, _)| name.as_str()));
        Ok(remove_finished(&self.root, &kept.collect())?)
    }

    fn begin_task(&mut self, plan: &Plan, task: Task, mode: BuildMode) -> Result<(), OutputError> {
        let path = self.open_journal(Some(task))?;
        presence::check(&self.root, plan, mode)?;
        if self.root.join(MANIFEST).exists() {
            // Merged while this task started: it is to look again.
            return Err(OutputError::Busy { path: self.root.clone() });
        }
        self.resume(&path, plan)
    }

    /// Opens and locks the journal of this run.
    fn open_journal(&mut self, task: Option<Task>) -> Result<PathBuf, OutputError> {
        let root = &self.root;
        std::fs::create_dir_all(root).map_err(FileError::new("create", root))?;
        let path = root.join(journal::name(task));
        self.journal = Some((path.clone(), Mutex::new(lock(&path, root, true)?)));
        Ok(path)
    }

    /// Goes on with the journal of this run, or begins it.
    fn resume(&mut self, path: &Path, plan: &Plan) -> Result<(), OutputError> {
        let earlier = Journal::read(path, None);
        let goes_on = earlier.plan == *plan;
        if goes_on {
            self.note_all(earlier.lines);
        } else {
            // What an interrupted build of other inputs wrote, as long as its journal tells.
            remove_inside(&self.root, earlier.files())?;
        }
        self.with_journal(|journal| {
            if goes_on {
                // A torn last line must not swallow the next one.
                return journal.write_all(b"\n");
            }
            journal.set_len(0)?;
            write_line(journal, plan).map(drop)
        })?;
        Ok(())
    }

    /// Locks the journals of tasks, and takes what they noted for earlier work.
    fn take_over_tasks(&mut self, plan: &Plan) -> Result<(), OutputError> {
        for found in Journal::all(&self.root).into_iter().filter(|found| found.task.is_some()) {
            let held = lock(&found.path, &self.root, false)?;
            // Once more under the lock.
            let mut journal = Journal::read(&found.path, found.task);
            if journal.plan == *plan {
                self.note_all(std::mem::take(&mut journal.lines));
            } else if self.part == Part::Whole {
                // Of other inputs, to be replaced.
                remove_inside(&self.root, journal.files())?;
            } else {
                continue;
            }
            self.taken_over.push((journal, held));
        }
        Ok(())
    }

    fn note_all(&mut self, lines: Vec<Noted>) {
        self.noted.extend(lines.into_iter().map(|noted| (noted.line.key.clone(), noted)));
    }

    /// Takes up what earlier runs left of a plan, as far as its files are still what the journal
    /// says, and returns the items that this run answers for: those of its part, in the order of
    /// the plan.
    ///
    /// # Errors
    /// [`OutputError::Gaps`] if this is a merge, and tasks have left items undone.
    pub(super) fn take_up<'a, T>(
        &mut self,
        plan: &'a [T],
        key: impl Fn(&T) -> String,
        progress: &dyn Progress,
    ) -> Result<Vec<&'a T>, OutputError> {
        let keys: Vec<String> = plan.iter().map(key).collect();
        let takes = |at: usize| match self.part {
            Part::Task(task) => task.takes(at),
            Part::Whole | Part::Merge { .. } => true,
        };
        let mine: Vec<usize> = (0..plan.len()).filter(|at| takes(*at)).collect();
        let earlier: Vec<Noted> = mine
            .iter()
            .filter_map(|at| self.noted.remove(&keys[*at]))
            .filter(|noted| !noted.line.item.is_null())
            .collect();
        let mut damaged = HashMap::new();
        if !earlier.is_empty() {
            progress.begin("checking what is there", Some(earlier.len() as u64));
        }
        let differing = earlier.par_iter().map(|noted| {
            progress.advance(1);
            self.differing(&noted.line.files)
        });
        let differing: Vec<Option<String>> = differing.collect();
        if !earlier.is_empty() {
            progress.end();
        }
        for (noted, differing) in earlier.into_iter().zip(differing) {
            match differing {
                Some(file) => drop(damaged.insert(noted.line.key, file)),
                None => drop(self.sound.insert(noted.line.key.clone(), noted)),
            }
        }
        self.planned = plan.len();
        self.items = Mutex::new(
            self.sound.iter().map(|(key, noted)| (key.clone(), noted.sha256.clone())).collect(),
        );
        if let Part::Merge { tasks } = self.part {
            let gaps: Vec<Gap> = (0..tasks)
                .filter_map(|index| self.gap(Task { index, count: tasks }, &keys, &damaged))
                .collect();
            if !gaps.is_empty() {
                return Err(OutputError::Gaps { path: self.root.clone(), tasks, gaps });
            }
        }
        Ok(mine.into_iter().map(|at| &plan[at]).collect())
    }

    /// The first of some files that is not what it was.
    fn differing(&self, files: &[(String, Digest)]) -> Option<String> {
        let sound = |(name, digest): &&(String, Digest)| {
            stays_inside(name)
                && sha256_file(&self.root.join(name)).is_ok_and(|found| found == *digest)
        };
        files.iter().find(|file| !sound(file)).map(|(name, _)| name.clone())
    }

    /// What is missing of a task's part.
    fn gap(&self, task: Task, keys: &[String], damaged: &HashMap<String, String>) -> Option<Gap> {
        let mut taken = self.taken_over.iter().map(|(journal, _)| journal);
        let journal = taken.find(|journal| journal.task == Some(task));
        let mine = keys.iter().enumerate().filter(|(at, _)| task.takes(*at)).map(|(_, key)| key);
        let mine: Vec<&String> = mine.collect();
        let undone = mine.iter().find(|key| !self.sound.contains_key(**key));
        let done = |journal: &Journal| {
            let items = mine.iter().filter_map(|key| Some(((*key).clone(), self.sound.get(*key)?)));
            let items = items.map(|(key, noted)| (key, noted.sha256.clone())).collect();
            journal.done.as_ref() == Some(&Done::of(&items))
        };
        let reason = match (journal, undone) {
            (None, _) => "has not run here".to_owned(),
            (Some(_), Some(key)) if damaged.contains_key(*key) => {
                format!("wrote {}, which is damaged or missing", damaged[*key])
            }
            (Some(_), Some(key)) => format!("was interrupted before {key}"),
            (Some(journal), None) if !done(journal) => "was interrupted at its end".to_owned(),
            (Some(_), None) => return None,
        };
        Some(Gap { index: task.index, reason })
    }

    /// An item that an earlier run finished, of those that [`OutputDir::take_up`] found sound.
    pub(super) fn finished<T: DeserializeOwned>(&self, key: &str) -> Option<T> {
        let Noted { line, .. } = self.sound.get(key)?;
        let item = serde_json::from_value(line.item.clone()).ok()?;
        line.files.iter().for_each(|(name, digest)| self.remember(name, digest));
        Some(item)
    }

    /// Writes the files of an item, by name and content, and notes in the journal that the item
    /// `key` is done. `item` is given the digests of the files, in their order.
    ///
    /// # Errors
    /// When writing fails; the item then counts as not done.
    pub(super) fn finish_item<T: Serialize>(
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
        let sha256 = self.note(&line)?;
        self.items.lock().expect(UNPOISONED).insert(line.key, sha256);
        Ok(line.item)
    }

    /// Appends a line to the journal.
    fn note(&self, line: &impl Serialize) -> Result<String, FileError> {
        self.with_journal(|journal| write_line(journal, line))
    }

    fn with_journal<T>(
        &self,
        write: impl FnOnce(&mut File) -> std::io::Result<T>,
    ) -> Result<T, FileError> {
        let Some((path, journal)) = &self.journal else {
            // An item that is noted, whole and hashed, but cannot be understood.
            let reason = "a merge builds nothing: a task's journal is of another program";
            return Err(FileError::new("write", &self.root)(std::io::Error::other(reason)));
        };
        write(&mut journal.lock().expect(UNPOISONED)).map_err(FileError::new("write", path))
    }

    /// Writes a file that belongs to the output as a whole. It is on the disk for good once
    /// the output is complete; until then its hash in the journal is what it is trusted by.
    ///
    /// # Errors
    /// When writing fails; the file is then absent.
    pub(super) fn write(&self, name: &str, bytes: &[u8]) -> Result<Digest, FileError> {
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
        self.syncer.take(path);
        self.remember(name, digest);
        Ok(())
    }

    /// Ends the part of a task: its files are on the disk, and its journal says so in the end.
    /// `None` if this run is no task and goes on to [`OutputDir::complete`].
    ///
    /// # Errors
    /// When writing fails; the part then still counts as unfinished.
    pub(super) fn end_task(&self) -> Result<Option<TaskReport>, FileError> {
        let Part::Task(task) = self.part else {
            return Ok(None);
        };
        self.syncer.end()?;
        sync_all(&self.root, &self.files.lock().expect(UNPOISONED))?;
        let items = self.items.lock().expect(UNPOISONED);
        self.with_journal(|journal| {
            write_line(journal, &Done::of(&items))?;
            journal.sync_all()
        })?;
        let found = self.sound.len();
        Ok(Some(TaskReport { task, planned: self.planned, items: items.len(), found }))
    }

    /// Completes the output: checksums, manifest, end of the journals.
    ///
    /// # Errors
    /// When writing fails; the directory then still counts as unfinished.
    pub(super) fn complete(self, manifest: &[u8]) -> Result<Digest, FileError> {
        let digest = sha256_bytes(manifest);
        self.remember(MANIFEST, &digest);
        let files = self.files.into_inner().expect(UNPOISONED);
        let lines = files.iter().map(|(name, digest)| [&digest.sha256, "  ", name, "\n"].concat());
        let sums: String = lines.collect();
        remove_leftovers(&self.root, &files)?;
        self.syncer.end()?;
        sync_all(&self.root, &files)?;
        write_atomic(&self.root.join(SUMS), sums.as_bytes())?;
        write_atomic(&self.root.join(MANIFEST), manifest)?;
        let taken_over = self.taken_over.iter().map(|(journal, _)| &journal.path);
        for journal in taken_over.chain(self.journal.iter().map(|(path, _)| path)) {
            std::fs::remove_file(journal).map_err(FileError::new("remove", journal))?;
        }
        Ok(digest)
    }

    fn remember(&self, name: &str, digest: &Digest) {
        self.files.lock().expect(UNPOISONED).insert(name.to_owned(), digest.clone());
    }
}

/// Why a lock can always be taken.
const UNPOISONED: &str = "no writer panics while it holds the lock";

/// Waits until all files and the directories that name them are on the disk.
fn sync_all(root: &Path, files: &BTreeMap<String, Digest>) -> Result<(), FileError> {
    let written: Vec<&String> = files.keys().filter(|name| *name != MANIFEST).collect();
    written.par_iter().try_for_each(|name| sync_file(&root.join(name)))?;
    directories(root, files).iter().try_for_each(|directory| sync_file(directory))
}

#[cfg(test)]
mod tests {
    use super::super::journal::JOURNAL;
    use super::*;
    use crate::progress::Silent;
    use crate::store::atomic::TEMPORARY_PREFIX;
    use crate::store::parse_sums;

    const MANIFEST_TEXT: &[u8] = br#"{"schema":"things.v1","fingerprint":"abc"}"#;

    fn plan(stage: &str, fingerprint: &str) -> Plan {
        Plan { stage: stage.to_owned(), fingerprint: fingerprint.to_owned() }
    }

    fn begin(root: &Path, fingerprint: &str, overwrite: bool) -> Result<OutputDir, OutputError> {
        let mode = BuildMode { part: Part::Whole, overwrite };
        let mut output = OutputDir::begin(root, &plan("things", fingerprint), mode)?;
        output.take_up(&["a", "b", "c"], ToString::to_string, &Silent)?;
        Ok(output)
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
        drop(resumed);
        std::fs::write(dir.path().join("a.bin"), b"B").expect("damaged");
        let resumed = begin(dir.path(), "abc", false).expect("resumed");
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
        drop(resumed);
        std::fs::write(dir.path().join("a/two.bin"), b"23").expect("damaged");
        let resumed = begin(dir.path(), "abc", false).expect("resumed");
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
        let mode = BuildMode { part: Part::Whole, overwrite: true };
        let stage = OutputDir::begin(dir.path(), &plan("others", "abc"), mode);
        let stage = stage.expect_err("other stage");
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
