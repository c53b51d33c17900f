//! `holescout train`.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use holescout::config::{Config, Split};
use holescout::dataset::Dataset;
use holescout::evaluate::precision;
use holescout::progress::Progress;
use holescout::rl::agent::{
    Agent, Judgement, MemoryNeed, Pace, QNetwork, TrainJob, TrainReport, Trainer, Watch,
    keep_freed_memory, train,
};
use holescout::rl::policy::MakePolicy;
use holescout::rl::{MapSource, World, load_sample};
use serde_json::json;
use signal_hook::consts::{SIGINT, SIGTERM};

use crate::cli::TrainArgs;
use crate::console::{Console, Report};
use crate::failure::Failure;

/// Steps after which a policy is judged while it is trained; the mean precision is its score.
const JUDGED_STEPS: [u32; 3] = [1, 2, 4];

pub(crate) fn run(args: &TrainArgs, config: &Config, console: &Console) -> Result<Report, Failure> {
    let Config { rl, train: how, .. } = config;
    keep_freed_memory();
    let device = args.device.choice().device()?;
    let dataset = Arc::new(Dataset::open_with(&args.dataset, &config.remote)?);
    let need = MemoryNeed::new(&dataset, config, device)?;
    need.demand()?;
    let val_maps = load_sample(&dataset, Split::Val, rl, how.evaluate_maps as usize, how.seed)?;
    let memory = how.map_memory_mb as usize * 1_000_000;
    let maps =
        MapSource::split(&dataset, Split::Train, rl, memory, how.seed).on_damage(how.on_damage);
    let dataset_sha256 = &dataset.digest().sha256;
    let job = TrainJob { dataset_sha256, rl, train: how, device };
    let stopped = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stopped)).map_err(Failure::running)?;
    }
    let mut judging = config.clone();
    judging.evaluate.steps = JUDGED_STEPS.to_vec();
    judging.evaluate.starts = how.evaluate_starts;
    let (need, stopped) = (&need, &*stopped);
    let mut watch = Watching { console, config, judging, maps: &val_maps, stopped, need };
    let ended = train(job, maps, &args.run, &mut watch)?;
    console.end();
    for (id, reason) in &ended.quarantined {
        console.note(&format!("warning: {id} was left out: {reason}"));
    }
    let state = if ended.complete { "done" } else { "saved, run again to go on" };
    let best = ended.best.map_or_else(String::new, |(score, update)| {
        format!("; best mean precision on the val split {:.1} % at update {update}", 100.0 * score)
    });
    let text = format!("{} updates, {state}{best}\n", ended.updates);
    let summary = json!({
        "stage": "train",
        "updates": ended.updates, "complete": ended.complete, "best": ended.best,
        "quarantined": ended.quarantined.len(),
    });
    Report::new(text, &summary)
}

struct Watching<'a> {
    console: &'a Console,
    config: &'a Config,
    judging: Config,
    maps: &'a [Arc<World>],
    stopped: &'a AtomicBool,
    need: &'a MemoryNeed,
}

impl Watch for Watching<'_> {
    fn begins(&mut self, trainer: &Trainer<'_>) {
        let (policy, train) = (trainer.policy(), &self.config.train);
        let maps = trainer.pool().maps().len();
        let changing = if trainer.pool().is_streamed() { ", others come and go" } else { "" };
        self.console.note(&format!(
            "{} parameters, {:?} on {:?}; {maps} maps in memory{changing}; replay of {} transitions \
             in {:.0} MB; {:.0} MB in all; from update {}",
            policy.size(),
            policy.computing().kind,
            policy.device(),
            train.replay,
            self.need.replay_bytes as f64 / 1e6,
            self.need.bytes() as f64 / 1e6,
            trainer.updates(),
        ));
        let left = train.updates.saturating_sub(trainer.updates());
        self.console.begin("training", Some(left));
    }

    fn updated(&mut self) {
        self.console.advance(1);
    }

    fn reported(&mut self, report: &TrainReport, pace: Pace) {
        let found = report.mean_return.map_or("-".into(), |of| format!("{of:.2}"));
        self.console.state(&format!(
            "return {found}, loss {:.4}, ε {:.2}, {:.0} samples/s",
            report.loss, report.epsilon, pace.samples_per_s
        ));
    }

    fn judge(&mut self, network: &QNetwork) -> Judgement {
        let Config { rl, train, .. } = self.config;
        let agent = Agent::new(network.duplicate(), self.maps[0].cells(), rl, train);
        let precision = |policy: &dyn MakePolicy| precision(policy, self.maps, &self.judging);
        let (policy, predictor) = (precision(&agent), agent.predictor().map(precision));
        let judgement = Judgement { steps: JUDGED_STEPS.to_vec(), policy, predictor };
        self.console.note(&format!("precision in %: {judgement}"));
        judgement
    }

    fn stop(&mut self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }
}
