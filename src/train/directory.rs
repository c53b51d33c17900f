//! The directory of a run.
//!
//! `run.json` says what is trained, `checkpoints/000001000` are the last checkpoints, `best` is the one with the
//! best score on the validation split. What a run did not write itself it neither takes nor removes.

use std::fs::File;
use std::path::{Path, PathBuf};

use super::error::TrainError;
use super::judgement::Mean;
use super::log::LOG;
use crate::error::FileError;
use crate::manifest::{Manifest, RunManifest, to_json};
use crate::rl::MapSource;
use crate::rl::agent::{Checkpoint, Trainer, TrainerError, TrainerSetup, Validation};
use crate::store::{
    OutputError, demand_outside, lock, remove_sealed, remove_unsealed, write_atomic,
};

/// Checkpoints that are kept beside the best.
const KEPT: usize = 3;
const LOCK: &str = ".holescout-lock";
const MANIFEST: &str = RunManifest::FILE;
const CHECKPOINTS: &str = RunManifest::CHECKPOINTS;
const BEST: &str = RunManifest::BEST;

/// A locked run.
pub(super) struct RunDir {
    root: PathBuf,
    _lock: File,
    /// Update and scores of `best`.
    best: Option<(u64, Vec<f64>)>,
    /// Updates and judgements that the last checkpoint tells of.
    saved: Option<(u64, u64)>,
}

impl RunDir {
    /// Takes a directory that is empty, absent or a run.
    pub(super) fn open(root: &Path) -> Result<Self, TrainError> {
        demand_outside(root)?;
        demand_run(root)?;
        std::fs::create_dir_all(root).map_err(FileError::new("create", root))?;
        let lock = lock(&root.join(LOCK), root, true)?;
        remove_unsealed(root)?;
        remove_unsealed(&root.join(CHECKPOINTS))?;
        Ok(Self { root: root.to_owned(), _lock: lock, best: None, saved: None })
    }

    pub(super) fn root(&self) -> &Path {
        &self.root
    }

    /// A trainer at the beginning of the run, or where its last checkpoint is, with what the validation split
    /// had told by then.
    pub(super) fn start<'a>(
        &mut self,
        setup: TrainerSetup<'a>,
        maps: MapSource,
        manifest: &RunManifest,
    ) -> Result<(Trainer<'a>, Validation), TrainError> {
        let checkpoints = self.checkpoints()?;
        let best = self.root.join(BEST);
        if best.exists() {
            let kept = Checkpoint::read(&best).map_err(TrainerError::Checkpoint);
            let kept = kept.map_err(|error| damaged(error, &best, checkpoints.last()))?;
            self.best = Some((kept.counters.updates, kept.validation.best_scores));
        }
        // A checkpoint is written before anything is logged.
        let log = self.root.join(LOG);
        let last = checkpoints.last().or(self.best.is_some().then_some(&best));
        let started = match last {
            None if log.metadata().is_ok_and(|log| log.len() > 0) => {
                return Err(TrainError::NothingLeft { log });
            }
            None => {
                let pool = maps.fill().map_err(TrainerError::from)?;
                (Trainer::new(setup, pool)?, Validation::default())
            }
            Some(last) => {
                let before =
                    checkpoints.iter().rev().nth(1).or(self.best.is_some().then_some(&best));
                let before = before.filter(|before| *before != last);
                let resumed = Trainer::resume(setup, maps, last);
                let (trainer, validation) =
                    resumed.map_err(|error| damaged(error, last, before))?;
                if *last != best {
                    self.saved = Some((trainer.updates(), validation.judged));
                }
                (trainer, validation)
            }
        };
        write_atomic(&self.root.join(MANIFEST), &to_json(manifest))?;
        Ok(started)
    }

    /// Writes a checkpoint unless it is there, then removes the oldest.
    pub(super) fn save(
        &mut self,
        trainer: &Trainer<'_>,
        validation: &Validation,
    ) -> Result<(), TrainError> {
        let state = (trainer.updates(), validation.judged);
        if self.saved != Some(state) {
            let directory = self.root.join(CHECKPOINTS).join(format!("{:09}", trainer.updates()));
            trainer.save(&directory, validation)?;
            self.saved = Some(state);
        }
        let all = self.checkpoints()?;
        all[..all.len().saturating_sub(KEPT)].iter().try_for_each(|old| remove_sealed(old))?;
        Ok(())
    }

    /// Whether there is a checkpoint of an update.
    pub(super) fn has_saved(&self, update: u64) -> bool {
        self.saved.is_some_and(|(saved, _)| saved == update)
    }

    /// Keeps the policy as the best one. A run that went on from an earlier checkpoint may have had a better one
    /// after it, which stays until the run is as good again; `before` is the update of the best that
    /// the run knows of.
    pub(super) fn keep_best(
        &mut self,
        trainer: &Trainer<'_>,
        validation: &Validation,
        before: Option<u64>,
    ) -> Result<(), TrainError> {
        let scores = &validation.best_scores;
        let is_worse = self.best.as_ref().is_some_and(|(update, best)| {
            before.is_none_or(|before| *update > before)
                && Mean::of(scores).mean < Mean::of(best).mean
        });
        if !is_worse {
            trainer.save(&self.root.join(BEST), validation)?;
            self.best = Some((trainer.updates(), scores.clone()));
        }
        Ok(())
    }

    /// Mean score of the best policy, and the update that had it.
    pub(super) fn best(&self) -> Option<(f64, u64)> {
        self.best.as_ref().map(|(update, scores)| (Mean::of(scores).mean, *update))
    }

    /// The checkpoints, the oldest first. What a killed run left half-written has another name.
    fn checkpoints(&self) -> Result<Vec<PathBuf>, FileError> {
        let directory = self.root.join(CHECKPOINTS);
        let entries = match std::fs::read_dir(&directory) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
            other => other.map_err(FileError::new("list", &directory))?,
        };
        let is_number = |path: &PathBuf| {
            let name = path.file_name().and_then(|name| name.to_str());
            name.is_some_and(|name| name.bytes().all(|byte| byte.is_ascii_digit()))
        };
        let mut paths: Vec<PathBuf> =
            entries.flatten().map(|entry| entry.path()).filter(is_number).collect();
        paths.sort();
        Ok(paths)
    }
}

/// What to do about a checkpoint that is damaged.
fn damaged(error: TrainerError, path: &Path, before: Option<&PathBuf>) -> TrainError {
    let TrainerError::Checkpoint(source) = error else { return error.into() };
    if !source.is_damage() {
        return TrainerError::Checkpoint(source).into();
    }
    TrainError::Damaged { source: Box::new(source), path: path.to_owned(), before: before.cloned() }
}

/// Demands that a directory is a run, or holds nothing.
fn demand_run(root: &Path) -> Result<(), TrainError> {
    let entries = match std::fs::read_dir(root) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        other => other.map_err(FileError::new("list", root))?,
    };
    let manifest = root.join(MANIFEST);
    let known = std::fs::read(&manifest).ok().and_then(|text| {
        let text: serde_json::Value = serde_json::from_slice(&text).ok()?;
        Some(text["schema"] == RunManifest::SCHEMA)
    });
    if known == Some(true) {
        return Ok(());
    }
    // A run that was killed right away leaves these at most.
    let names = entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned());
    let mut names = names.filter(|name| name != LOCK && !name.starts_with(".holescout-"));
    match names.next() {
        None => Ok(()),
        Some(example) => Err(OutputError::Foreign { path: root.to_owned(), example }.into()),
    }
}
