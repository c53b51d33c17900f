//! A run: a directory with checkpoints, the best policy and a log, which goes on where it was.
//!
//! `RUN/checkpoints/000001000` are the last checkpoints, `RUN/best` the one with the best score on
//! the validation split, `RUN/log.jsonl` a line for every hundred updates and every validation;
//! `RUN/events.out.tfevents.*` are the same for `TensorBoard`.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::checkpoint::{TEMPORARY, remove_whole};
use super::events::Events;
use super::judgement::Judgement;
use super::network::QNetwork;
use super::report::TrainReport;
use super::trainer::{TrainError, TrainJob, Trainer};
use crate::error::{Fault, FileError, HasFault};
use crate::grid::TileId;
use crate::rl::MapSource;
use crate::store::write_atomic;

/// Checkpoints that are kept beside the best.
const KEPT: usize = 3;
/// Updates that a report sums up.
const REPORTED: u64 = 100;
const LOCK: &str = ".holescout-lock";
const CHECKPOINTS: &str = "checkpoints";

/// Why a run cannot begin or go on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SessionError {
    /// Training failed.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// A file of the run cannot be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    /// Another process trains there.
    #[error("{} is being written by another run of holescout", path.display())]
    Busy {
        /// The directory.
        path: PathBuf,
    },
}

impl HasFault for SessionError {
    fn fault(&self) -> Fault {
        match self {
            Self::Train(error) => error.fault(),
            Self::File(error) => error.fault(),
            Self::Busy { .. } => Fault::Running,
        }
    }
}

/// How fast training went since the last report. Unlike all else it is never the same twice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pace {
    /// Transitions learned from in a second, all else that training does included.
    pub samples_per_s: f64,
    /// Share of the time that it waited for maps.
    pub waiting: f64,
}

/// Who watches a run.
pub trait Watch {
    /// The run begins, at an update after zero if it goes on from a checkpoint.
    fn begins(&mut self, trainer: &Trainer<'_>);
    /// An update was made.
    fn updated(&mut self);
    /// How it went over the last updates.
    fn reported(&mut self, report: &TrainReport, pace: Pace);
    /// Precision on the validation split, of all maps that it looks at always in the same order.
    fn judge(&mut self, network: &QNetwork) -> Judgement;
    /// Whether to save and stop.
    fn stop(&mut self) -> bool;
}

/// How a run ended.
#[derive(Debug, Clone, PartialEq)]
pub struct Ended {
    /// Updates done.
    pub updates: u64,
    /// Whether all were done or scores no longer rose, or it was stopped.
    pub complete: bool,
    /// Best score on the validation split, and the update that had it.
    pub best: Option<(f64, u64)>,
    /// Maps that were left out since they cannot be read, each with the reason.
    pub quarantined: BTreeMap<TileId, String>,
}

/// Trains in a directory, from its last checkpoint if there is one, until all updates are done, scores
/// no longer rise or the watch says stop.
///
/// # Errors
/// [`SessionError`]; what the last checkpoint holds is not lost.
pub fn train(
    job: TrainJob<'_>,
    maps: MapSource,
    run: &Path,
    watch: &mut dyn Watch,
) -> Result<Ended, SessionError> {
    std::fs::create_dir_all(run).map_err(FileError::new("create", run))?;
    let lock = File::create(run.join(LOCK)).map_err(FileError::new("create", run))?;
    match lock.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => {
            return Err(SessionError::Busy { path: run.to_owned() });
        }
        Err(TryLockError::Error(error)) => return Err(FileError::new("lock", run)(error).into()),
    }
    remove_leftovers(run)?;
    remove_leftovers(&run.join(CHECKPOINTS))?;
    let mut trainer = match checkpoints(run)?.last() {
        Some(last) => Trainer::resume(job, maps, last)?,
        None => Trainer::new(job, maps.fill().map_err(TrainError::from)?)?,
    };
    watch.begins(&trainer);
    let config = job.train;
    let mut log = Log::open(run, trainer.updates())?;
    let mut clock = Clock::start(&trainer);
    while !trainer.is_done() {
        if watch.stop() {
            save(&trainer, run)?;
            return Ok(ended(&trainer));
        }
        trainer.update()?;
        watch.updated();
        let done = trainer.updates();
        let is_due = |every: u64| done.is_multiple_of(every) || done == config.updates;
        if is_due(REPORTED) {
            let report = trainer.report()?;
            let pace = clock.pace(&trainer, config.batch);
            watch.reported(&report, pace);
            log.reported(&report, pace)?;
        }
        if is_due(config.evaluate_every) {
            clock.pause();
            let judgement = watch.judge(trainer.policy());
            log.judged(done, &judgement)?;
            if trainer.judged(judgement.scores()) {
                trainer.save(&run.join("best"))?;
            }
            clock.go_on();
        }
        if is_due(config.checkpoint_every) || trainer.is_done() {
            save(&trainer, run)?;
        }
    }
    Ok(ended(&trainer))
}

fn ended(trainer: &Trainer<'_>) -> Ended {
    Ended {
        updates: trainer.updates(),
        complete: trainer.is_done(),
        best: trainer.best(),
        quarantined: trainer.pool().quarantined().clone(),
    }
}

/// Times training, without judgements.
struct Clock {
    since: Instant,
    trained: Duration,
    updates: u64,
    waited: Duration,
}

impl Clock {
    fn start(trainer: &Trainer<'_>) -> Self {
        let (updates, waited) = (trainer.updates(), trainer.pool().waited());
        Self { since: Instant::now(), trained: Duration::ZERO, updates, waited }
    }

    fn pause(&mut self) {
        self.trained += self.since.elapsed();
    }

    fn go_on(&mut self) {
        self.since = Instant::now();
    }

    /// The pace since it was asked for last.
    fn pace(&mut self, trainer: &Trainer<'_>, batch: u32) -> Pace {
        self.pause();
        let seconds = self.trained.as_secs_f64();
        let samples = (trainer.updates() - self.updates) as f64 * f64::from(batch);
        let waiting = trainer.pool().waited().saturating_sub(self.waited).as_secs_f64() / seconds;
        *self = Self::start(trainer);
        Pace { samples_per_s: samples / seconds, waiting }
    }
}

/// Writes a checkpoint, then removes the oldest.
fn save(trainer: &Trainer<'_>, run: &Path) -> Result<(), SessionError> {
    let directory = run.join(CHECKPOINTS).join(format!("{:09}", trainer.updates()));
    if !directory.exists() {
        trainer.save(&directory)?;
    }
    let all = checkpoints(run)?;
    for old in &all[..all.len().saturating_sub(KEPT)] {
        drop(remove_whole(old)?);
    }
    Ok(())
}

/// Removes checkpoints that a killed run left half-written, which have temporary names.
fn remove_leftovers(directory: &Path) -> Result<(), FileError> {
    for entry in std::fs::read_dir(directory).into_iter().flatten().flatten() {
        let path = entry.path();
        if entry.file_name().to_string_lossy().starts_with(TEMPORARY) && path.is_dir() {
            std::fs::remove_dir_all(&path).map_err(FileError::new("remove", &path))?;
        }
    }
    Ok(())
}

/// The checkpoints of a run, the oldest first. What a killed run left half-written has another name.
fn checkpoints(run: &Path) -> Result<Vec<PathBuf>, FileError> {
    let directory = run.join(CHECKPOINTS);
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

/// `log.jsonl`, of which what happened up to the checkpoint that a run goes on from is kept, and an
/// event file.
struct Log {
    path: PathBuf,
    file: File,
    events: Events,
}

impl Log {
    fn open(run: &Path, updates: u64) -> Result<Self, FileError> {
        let path = run.join("log.jsonl");
        let text = match std::fs::read_to_string(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
            other => other.map_err(FileError::new("read", &path))?,
        };
        let is_before = |line: &&str| {
            let line = serde_json::from_str::<Value>(line).ok();
            line.and_then(|line| line["update"].as_u64()).is_some_and(|update| update <= updates)
        };
        let kept: String = text.lines().filter(is_before).flat_map(|line| [line, "\n"]).collect();
        write_atomic(&path, kept.as_bytes())?;
        let file = OpenOptions::new().append(true).open(&path);
        let file = file.map_err(FileError::new("open", &path))?;
        Ok(Self { path, file, events: Events::create(run, updates)? })
    }

    fn line(&mut self, line: &Value) -> Result<(), FileError> {
        let written = writeln!(self.file, "{line}");
        written.map_err(FileError::new("write", &self.path))
    }

    fn reported(&mut self, report: &TrainReport, pace: Pace) -> Result<(), FileError> {
        let mut line = json!(report);
        line["samples_per_s"] = json!(pace.samples_per_s);
        line["waiting"] = json!(pace.waiting);
        let scalars = line.as_object().into_iter().flatten();
        let scalars = scalars.filter(|(name, _)| *name != "update");
        let scalars: Vec<(&str, f64)> =
            scalars.filter_map(|(name, value)| Some((&**name, value.as_f64()?))).collect();
        self.events.add(report.update, &scalars)?;
        self.line(&line)
    }

    fn judged(&mut self, update: u64, judgement: &Judgement) -> Result<(), FileError> {
        let mut line = json!({ "update": update });
        let mut add = |name: &str, values: Vec<(u32, f64)>| {
            let tags: Vec<String> = values.iter().map(|(k, _)| format!("{name}/{k}")).collect();
            let scalars = tags.iter().zip(&values).map(|(tag, &(_, value))| (&**tag, value));
            self.events.add(update, &scalars.collect::<Vec<_>>())?;
            let values = values.iter().map(|(k, value)| (k.to_string(), json!(value)));
            line[name] = values.collect::<serde_json::Map<_, _>>().into();
            Ok::<_, FileError>(())
        };
        add("precision", judgement.precision())?;
        if let Some(over) = judgement.over_predictor() {
            add("over_predictor", over.iter().map(|&(k, of)| (k, of.mean)).collect())?;
            add("over_predictor_error", over.iter().map(|&(k, of)| (k, of.error)).collect())?;
        }
        self.line(&line)
    }
}
