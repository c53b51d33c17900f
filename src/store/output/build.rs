//! The way of a stage through its output, each step a type that only the step before gives.

use std::path::Path;

use rayon::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::dir::OutputDir;
use super::error::OutputError;
use super::journal::Plan;
use super::part::{BuildMode, Part, TaskReport};
use crate::error::FileError;
use crate::progress::Progress;
use crate::store::Digest;
use crate::store::MANIFEST;

/// What a run of a stage built.
#[derive(Debug, Clone, PartialEq)]
pub enum Built<M> {
    /// The output, which now has this manifest.
    Whole(M),
    /// A task's part.
    Part(TaskReport),
    /// Nothing: a task found that the output is whole already.
    Already,
}

impl<M> Built<M> {
    /// The manifest, unless this is a task's part.
    #[must_use]
    pub fn whole(self) -> Option<M> {
        match self {
            Self::Whole(manifest) => Some(manifest),
            Self::Part(_) | Self::Already => None,
        }
    }
}

/// What a stage learns before it reads large inputs.
#[derive(Debug)]
pub(crate) enum Opened<'a, M> {
    /// Its work is done already, as a task or a merge that is run once more finds.
    Done(Built<M>),
    /// The directory can take it.
    Ready(Build<'a>),
}

/// How items use the threads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Parallel {
    /// Several items at a time.
    Across,
    /// One item after the other, each on several threads: for items that are large.
    Within,
}

/// A directory that can take an output, and has not been touched yet.
#[derive(Debug)]
pub(crate) struct Build<'a> {
    out: &'a Path,
    plan: Plan,
    mode: BuildMode,
}

impl<'a> Build<'a> {
    /// Looks at the directory, without changing anything but what a killed merge left over.
    ///
    /// `stage` is the name of the output and of its manifest's schema, `tiles` of `tiles.v1`;
    /// `fingerprint` is a hash of all that the output depends on.
    ///
    /// # Errors
    /// [`OutputError`] if the directory holds something else, or a damaged output.
    pub(crate) fn open<M: DeserializeOwned>(
        out: &'a Path,
        stage: &str,
        fingerprint: &str,
        mode: BuildMode,
        progress: &dyn Progress,
    ) -> Result<Opened<'a, M>, OutputError> {
        let plan = Plan { stage: stage.to_owned(), fingerprint: fingerprint.to_owned() };
        let Some(manifest) = OutputDir::whole(out, &plan, mode, progress)? else {
            return Ok(Opened::Ready(Self::check(out, plan, mode)?));
        };
        if let Part::Task(_) = mode.part {
            return Ok(Opened::Done(Built::Already));
        }
        let damaged = |_| OutputError::Damaged { path: out.to_owned(), file: MANIFEST.to_owned() };
        let manifest = serde_json::from_slice(&manifest).map_err(damaged)?;
        Ok(Opened::Done(Built::Whole(manifest)))
    }

    /// The same for a stage whose output is built as a whole.
    ///
    /// # Errors
    /// [`OutputError`] if the directory holds something else.
    pub(crate) fn open_whole(
        out: &'a Path,
        stage: &str,
        fingerprint: &str,
        overwrite: bool,
    ) -> Result<Self, OutputError> {
        let plan = Plan { stage: stage.to_owned(), fingerprint: fingerprint.to_owned() };
        Self::check(out, plan, BuildMode { part: Part::Whole, overwrite })
    }

    fn check(out: &'a Path, plan: Plan, mode: BuildMode) -> Result<Self, OutputError> {
        OutputDir::check(out, &plan, mode)?;
        Ok(Self { out, plan, mode })
    }

    /// Begins an output that has no items.
    ///
    /// # Errors
    /// [`OutputError`] if the directory has been taken meanwhile, or cannot be written.
    pub(crate) fn begin(self) -> Result<Output, OutputError> {
        Ok(Output(Box::new(OutputDir::begin(self.out, &self.plan, self.mode)?)))
    }

    /// Builds the items of a plan, or those that fall to this task, and takes up what earlier runs
    /// have finished and is sound.
    ///
    /// `key` names an item in the journal; it must differ from those of all others. `build` makes
    /// one and ends with [`Item::finish`]. Results are in the order of the plan.
    ///
    /// # Errors
    /// [`OutputError`] if the directory has been taken meanwhile, cannot be written, or lacks what
    /// other tasks should have built; and the first error of `build`.
    pub(crate) fn run_items<P, T, E>(
        self,
        (label, parallel): (&str, Parallel),
        plan: &[P],
        key: impl Fn(&P) -> String + Sync,
        build: impl Fn(&P, Item<'_>) -> Result<Finished<T>, E> + Sync,
        progress: &dyn Progress,
    ) -> Result<Items<T>, E>
    where
        P: Sync,
        T: Serialize + DeserializeOwned + Send,
        E: From<OutputError> + Send,
    {
        let mut output = OutputDir::begin(self.out, &self.plan, self.mode)?;
        let mine = output.take_up(plan, &key, progress)?;
        progress.begin(label, Some(mine.len() as u64));
        let run = |item: &&P| {
            let key = key(item);
            let done = match output.finished(&key) {
                Some(done) => done,
                None => build(item, Item { key, output: &output })?.0,
            };
            progress.advance(1);
            Ok(done)
        };
        let items: Result<Vec<T>, E> = match parallel {
            Parallel::Across => mine.par_iter().map(run).collect(),
            Parallel::Within => mine.iter().map(run).collect(),
        };
        let items = items?;
        progress.end();
        Ok(match output.end_task().map_err(OutputError::from)? {
            Some(report) => Items::Part(report),
            None => Items::All(items, Output(Box::new(output))),
        })
    }
}

/// What [`Build::run_items`] gives.
#[derive(Debug)]
pub(crate) enum Items<T> {
    /// This was a task, and its part is done.
    Part(TaskReport),
    /// All items of the plan, and the directory, to be completed.
    All(Vec<T>, Output),
}

/// The place of an item that is being built.
#[derive(Debug)]
pub(crate) struct Item<'a> {
    key: String,
    output: &'a OutputDir,
}

/// What is remembered of an item whose files are written.
#[derive(Debug)]
pub(crate) struct Finished<T>(T);

impl Item<'_> {
    /// Writes the files of the item, by name and content, and notes in the journal that it is
    /// done. `item`, what is remembered of it, is given the digests of the files, in their order.
    ///
    /// # Errors
    /// When writing fails; the item then counts as not done.
    pub(crate) fn finish<T: Serialize>(
        self,
        files: &[(&str, &[u8])],
        item: impl FnOnce(&[Digest]) -> T,
    ) -> Result<Finished<T>, FileError> {
        self.output.finish_item(&self.key, files, item).map(Finished)
    }
}

/// A directory that lacks only what belongs to the output as a whole.
#[derive(Debug)]
pub(crate) struct Output(Box<OutputDir>);

impl Output {
    /// Writes a file that belongs to the output as a whole. It is on the disk for good once
    /// the output is complete.
    ///
    /// # Errors
    /// When writing fails; the file is then absent.
    pub(crate) fn write(&self, name: &str, bytes: &[u8]) -> Result<Digest, FileError> {
        self.0.write(name, bytes)
    }

    /// Completes the output: checksums, manifest, end of the journals. Returns the digest of the
    /// manifest.
    ///
    /// # Errors
    /// When writing fails; the directory then still counts as unfinished.
    pub(crate) fn complete(self, manifest: &[u8]) -> Result<Digest, FileError> {
        self.0.complete(manifest)
    }
}
