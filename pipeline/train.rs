//! `holescout train`.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use holescout::config::{Config, Split};
use holescout::dataset::Dataset;
use holescout::evaluate::precision;
use holescout::progress::Progress;
use holescout::rl::agent::{Agent, QNetwork, TrainJob, TrainProgress, Trainer, Watch, train};
use holescout::rl::{World, load_split};
use serde_json::json;
use signal_hook::consts::{SIGINT, SIGTERM};

use crate::cli::TrainArgs;
use crate::console::{Console, Report};
use crate::failure::Failure;

/// Steps after which a policy is judged while it is trained; the mean precision is its score.
const JUDGED_STEPS: [u32; 3] = [1, 2, 4];

pub(crate) fn run(args: &TrainArgs, config: &Config, console: &Console) -> Result<Report, Failure> {
    let dataset = Dataset::open(&args.dataset)?;
    let maps = |split| -> Result<Vec<Arc<World>>, Failure> {
        let maps = load_split(&dataset, split, &config.rl)?;
        if maps.is_empty() {
            let dataset = args.dataset.display();
            return Err(Failure::input(format!("{dataset}: its {split} split has no records")));
        }
        Ok(maps)
    };
    let (train_maps, val_maps) = (maps(Split::Train)?, maps(Split::Val)?);
    let job = TrainJob {
        maps: &train_maps,
        dataset_sha256: &dataset.digest().sha256,
        rl: &config.rl,
        train: &config.train,
    };
    let stopped = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stopped)).map_err(Failure::running)?;
    }
    let mut judging = config.clone();
    judging.evaluate.steps = JUDGED_STEPS.to_vec();
    judging.evaluate.starts = config.train.evaluate_starts;
    let mut watch = Watching { console, config, judging, maps: &val_maps, stopped: &stopped };
    let ended = train(job, &args.run, &mut watch)?;
    console.end();
    let state = if ended.complete { "done" } else { "saved, run again to go on" };
    let best = ended.best.map_or_else(String::new, |(score, update)| {
        format!("; best mean precision on the val split {:.1} % at update {update}", 100.0 * score)
    });
    let text = format!("{} updates, {state}{best}\n", ended.updates);
    let summary = json!({
        "stage": "train",
        "updates": ended.updates,
        "complete": ended.complete,
        "best": ended.best,
    });
    Report::new(text, &summary)
}

struct Watching<'a> {
    console: &'a Console,
    config: &'a Config,
    judging: Config,
    maps: &'a [Arc<World>],
    stopped: &'a AtomicBool,
}

impl Watch for Watching<'_> {
    fn begins(&mut self, trainer: &Trainer<'_>) {
        let (parameters, megabytes) =
            (trainer.policy().size(), trainer.replay_bytes() as f64 / 1e6);
        self.console.note(&format!(
            "{parameters} parameters; replay of {} transitions in {megabytes:.0} MB; from update {}",
            self.config.train.replay,
            trainer.updates(),
        ));
        let left = self.config.train.updates.saturating_sub(trainer.updates());
        self.console.begin("training", Some(left));
    }

    fn updated(&mut self, _: &TrainProgress) {
        self.console.advance(1);
    }

    fn judge(&mut self, network: &QNetwork) -> Vec<(u32, f64)> {
        let agent =
            Agent::new(network.duplicate(), &self.config.rl, self.config.train.mask_actions);
        let scores = precision(&agent, self.maps, &self.judging);
        let percent = scores.iter().map(|(k, score)| format!("{:.1} (k = {k})", 100.0 * score));
        let percent: Vec<String> = percent.collect();
        self.console.note(&format!("precision in %: {}", percent.join(", ")));
        scores
    }

    fn stop(&mut self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }
}
