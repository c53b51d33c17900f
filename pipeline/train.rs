//! `holescout train`.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use holescout::config::Config;
use holescout::train::{Ended, TrainJob, train};
use serde_json::json;
use signal_hook::consts::{SIGINT, SIGTERM};

use crate::cli::TrainArgs;
use crate::console::{Console, Report};
use crate::failure::Failure;
use holescout::progress::Progress;

pub(crate) fn run(args: &TrainArgs, config: &Config, console: &Console) -> Result<Report, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stop)).map_err(Failure::running)?;
    }
    let job =
        TrainJob { dataset: &args.dataset, config, run: &args.run, device: args.device.choice() };
    let Ended { updates, complete, best, quarantined, .. } = train(job, console, &stop)?;
    for (id, reason) in &quarantined {
        console.note(&format!("warning: {id} was left out: {reason}"));
    }
    let state = if complete { "done" } else { "saved, run again to go on" };
    let of_best = best.map_or_else(String::new, |(score, update)| {
        format!("; best mean precision on the val split {:.1} % at update {update}", 100.0 * score)
    });
    let text = format!("{updates} updates, {state}{of_best}\n");
    let summary = json!({
        "stage": "train",
        "updates": updates, "complete": complete, "best": best, "quarantined": quarantined.len(),
    });
    Report::new(text, &summary)
}
