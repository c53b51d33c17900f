//! A dataset in, a run out.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::directory::RunDir;
use super::error::TrainError;
use super::judgement::{Mean, is_better};
use super::log::{Log, Pace};
use super::validation::Judge;
use crate::config::{Config, Split};
use crate::dataset::Dataset;
use crate::grid::TileId;
use crate::manifest::{Manifest, RunManifest, Software};
use crate::progress::Progress;
use crate::rl::agent::{
    DeviceChoice, MemoryNeed, Trainer, TrainerSetup, Validation, keep_freed_memory, limit_threads,
};
use crate::rl::{MapSource, load_sample};

/// Updates that a report sums up.
const REPORTED: u64 = 100;

/// What to train on, how, and where to.
#[derive(Debug, Clone, Copy)]
pub struct TrainJob<'a> {
    /// A dataset with a train and a val split.
    pub dataset: &'a Path,
    /// The configuration; `[rl]`, `[train]` and `[remote]` are used, and `[evaluate]` to judge.
    pub config: &'a Config,
    /// The run's directory: absent, empty, or a run to go on with.
    pub run: &'a Path,
    /// Where to compute.
    pub device: DeviceChoice,
}

/// How a session of a run ended.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Ended {
    /// Updates done.
    pub updates: u64,
    /// Whether all were done or scores no longer rose, or it was stopped.
    pub complete: bool,
    /// Best score on the validation split, and the update that had it: that of `RUN/best`.
    pub best: Option<(f64, u64)>,
    /// Maps that were left out since they cannot be read, each with the reason.
    pub quarantined: BTreeMap<TileId, String>,
}

/// Trains from the last checkpoint of a run, or from the beginning, until all updates are done, scores no longer
/// rise, or `stop` is set, which is looked at after each update and while policies are judged.
///
/// # Errors
/// [`TrainError`].
pub fn train(
    job: TrainJob<'_>,
    progress: &dyn Progress,
    stop: &AtomicBool,
) -> Result<Ended, TrainError> {
    let TrainJob { config, run, .. } = job;
    let (rl, train) = (&config.rl, &config.train);
    keep_freed_memory();
    let device = job.device.device()?;
    let dataset = Arc::new(Dataset::open_with(job.dataset, &config.remote)?);
    let need = MemoryNeed::new(&dataset, config, device)?;
    need.demand()?;
    let count = train.evaluate_maps as usize;
    let validation = load_sample(&dataset, Split::Val, rl, count, train.seed)?;
    let memory = train.map_memory_mb as usize * 1_000_000;
    let maps = MapSource::split(&dataset, Split::Train, rl, memory, train.seed)
        .block(train.block)
        .on_damage(train.on_damage);
    let setup = TrainerSetup { dataset_sha256: &dataset.digest().sha256, rl, train, device };
    let manifest = RunManifest {
        schema: RunManifest::SCHEMA.to_owned(),
        software: Software::this(),
        dataset: dataset.digest().clone(),
        rl: rl.clone(),
        train: train.clone(),
    };
    let threads = limit_threads();
    let mut directory = RunDir::open(run)?;
    let (trainer, validated) = directory.start(setup, maps, &manifest)?;
    greet(&trainer, config, need, threads, progress);
    let judge = Judge::new(&validation, config, stop);
    Session { directory, trainer, validated, judge, config, progress }.go_on(stop)
}

/// Says what is about to happen.
fn greet(
    trainer: &Trainer<'_>,
    config: &Config,
    need: MemoryNeed,
    threads: usize,
    progress: &dyn Progress,
) {
    let (policy, train) = (trainer.policy(), &config.train);
    let maps = trainer.pool().maps().len();
    let changing = if trainer.pool().is_streamed() { ", others come and go" } else { "" };
    progress.note(&format!(
        "{} parameters, {:?} on {:?}, threads: {threads}; {maps} maps in memory{changing}; replay of {} \
         transitions in {:.0} MB; {:.0} MB in all; from update {}",
        policy.size(),
        policy.computing().kind,
        policy.device(),
        train.buffer_size,
        need.replay_bytes as f64 / 1e6,
        need.bytes() as f64 / 1e6,
        trainer.updates(),
    ));
    progress.begin("training", Some(train.updates.saturating_sub(trainer.updates())));
}

/// A run under way.
struct Session<'a> {
    directory: RunDir,
    trainer: Trainer<'a>,
    validated: Validation,
    judge: Judge<'a>,
    config: &'a Config,
    progress: &'a dyn Progress,
}

impl Session<'_> {
    fn go_on(mut self, stop: &AtomicBool) -> Result<Ended, TrainError> {
        let train = &self.config.train;
        // Whoever is killed before anything is logged begins anew.
        if self.trainer.updates() == 0 {
            self.directory.save(&self.trainer, &self.validated)?;
        }
        let mut log = Log::open(self.directory.root(), self.trainer.updates())?;
        let mut clock = Clock::start(&self.trainer);
        loop {
            let done = self.trainer.updates();
            let is_due = |every: u64| done.is_multiple_of(every) || done == train.updates;
            if done > self.validated.judged && is_due(train.evaluate_every) {
                clock.pause();
                let Some(judgement) = self.judge.judge(&self.trainer) else { break };
                self.progress.note(&format!("precision in %: {judgement}"));
                log.judged(done, &judgement)?;
                self.judged(judgement.scores())?;
                clock.go_on();
            }
            let is_done = self.is_done();
            if is_due(train.checkpoint_every) || is_done || self.directory.has_saved(done) {
                self.directory.save(&self.trainer, &self.validated)?;
            }
            if is_done || stop.load(Ordering::Relaxed) {
                break;
            }
            self.trainer.update()?;
            self.progress.advance(1);
            let done = self.trainer.updates();
            if done.is_multiple_of(REPORTED) || done == train.updates {
                let report = self.trainer.report()?;
                let pace = clock.pace(&self.trainer, train.batch_size);
                let found = report.mean_return.map_or("-".into(), |of| format!("{of:.2}"));
                self.progress.state(&format!(
                    "return {found}, loss {:.4}, ε {:.2}, {:.0} samples/s",
                    report.loss, report.epsilon, pace.samples_per_s
                ));
                log.reported(&report, pace)?;
            }
        }
        self.directory.save(&self.trainer, &self.validated)?;
        self.progress.end();
        Ok(Ended {
            updates: self.trainer.updates(),
            complete: self.is_done(),
            best: self.directory.best(),
            quarantined: self.trainer.pool().quarantined().clone(),
        })
    }

    /// Notes the scores of a judgement, one for each map. They are the best so far if they are better than the
    /// best by more than the standard error of the difference.
    fn judged(&mut self, scores: Vec<f64>) -> Result<(), TrainError> {
        let (validated, updates) = (&mut self.validated, self.trainer.updates());
        validated.judged = updates;
        let before = validated.best.map(|(_, update)| update);
        if before.is_some() && !is_better(&scores, &validated.best_scores) {
            validated.since_best += 1;
            return Ok(());
        }
        validated.best = Some((Mean::of(&scores).mean, updates));
        validated.best_scores = scores;
        validated.since_best = 0;
        self.directory.keep_best(&self.trainer, &self.validated, before)
    }

    /// Whether nothing is left to be done: all updates are made and judged, or scores no longer rise.
    fn is_done(&self) -> bool {
        let (train, updates) = (&self.config.train, self.trainer.updates());
        let has_patience = train.patience == 0 || self.validated.since_best < train.patience;
        updates >= train.updates && self.validated.judged == updates || !has_patience
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
