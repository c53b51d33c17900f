//! What a person sees: a progress bar on a terminal, plain lines otherwise, all of it on
//! standard error; and the report that ends a run.

use std::io::{IsTerminal, Write};
use std::sync::Mutex;
use std::time::Duration;

use holescout::progress::Progress;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;

use crate::failure::Failure;

/// Lines of progress in a log, per phase.
const PLAIN_STEPS: u64 = 4;

/// Standard error.
pub(crate) struct Console {
    quiet: bool,
    terminal: bool,
    phase: Mutex<Option<Phase>>,
}

struct Phase {
    name: String,
    total: Option<u64>,
    done: u64,
    /// What is said beside the progress.
    state: String,
    bar: Option<ProgressBar>,
}

impl Console {
    pub(crate) fn new(quiet: bool) -> Self {
        Self { quiet, terminal: std::io::stderr().is_terminal(), phase: Mutex::new(None) }
    }

    fn with_phase(&self, act: impl FnOnce(&mut Option<Phase>)) {
        act(&mut self.phase.lock().expect("no reporter panics while it holds the lock"));
    }
}

impl Progress for Console {
    fn begin(&self, phase: &str, total: Option<u64>) {
        if self.quiet {
            return;
        }
        let bar = self.terminal.then(|| {
            let style = ProgressStyle::with_template(
                "{msg:28} {wide_bar} {human_pos}/{human_len} {per_sec} {eta}",
            );
            let bar = ProgressBar::with_draw_target(total, ProgressDrawTarget::stderr());
            bar.set_style(style.expect("the template is valid"));
            bar.set_message(phase.to_owned());
            bar.enable_steady_tick(Duration::from_millis(200));
            bar
        });
        if bar.is_none() {
            line(&match total {
                Some(total) => format!("{phase} ({total})"),
                None => phase.to_owned(),
            });
        }
        self.with_phase(|current| {
            *current =
                Some(Phase { name: phase.to_owned(), total, done: 0, state: String::new(), bar });
        });
    }

    fn advance(&self, steps: u64) {
        self.with_phase(|phase| {
            let Some(phase) = phase else { return };
            phase.done += steps;
            match (&phase.bar, phase.total) {
                (Some(bar), _) => bar.inc(steps),
                (None, Some(total)) if total > 100 => {
                    let part = |done: u64| done * PLAIN_STEPS / total;
                    if part(phase.done) > part(phase.done - steps) {
                        let Phase { name, done, state, .. } = phase;
                        line(&format!("{name}: {done} of {total}{state}"));
                    }
                }
                (None, _) => {}
            }
        });
    }

    fn end(&self) {
        self.with_phase(|phase| {
            if let Some(Phase { bar: Some(bar), .. }) = phase.take() {
                bar.finish_and_clear();
            }
        });
    }

    /// Beside the bar; a log has a line for it where it has one for the progress.
    fn state(&self, text: &str) {
        self.with_phase(|phase| {
            let Some(phase) = phase else { return };
            match &phase.bar {
                Some(bar) => bar.set_message(text.to_owned()),
                None => phase.state = format!(": {text}"),
            }
        });
    }

    fn note(&self, text: &str) {
        self.with_phase(|phase| match phase {
            Some(Phase { bar: Some(bar), .. }) => bar.suspend(|| line(text)),
            _ => line(text),
        });
    }
}

/// A line on standard error. Nobody is left to tell when that fails.
fn line(text: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// The end of a run that failed.
pub(crate) fn report_error(failure: &Failure) {
    line(&format!("error: {failure}"));
}

/// How a run ended: for people, and for machines.
pub(crate) struct Report {
    pub(crate) text: String,
    pub(crate) json: String,
    failed: Option<String>,
}

impl Report {
    pub(crate) fn new(text: String, summary: &impl Serialize) -> Result<Self, Failure> {
        let json = serde_json::to_string(summary).map_err(Failure::running)?;
        Ok(Self { text, json, failed: None })
    }

    /// The report stands, but the run ends as invalid input for this reason.
    pub(crate) fn failed(mut self, reason: String) -> Self {
        self.failed = Some(reason);
        self
    }

    pub(crate) fn outcome(&self) -> Result<(), Failure> {
        self.failed.clone().map_or(Ok(()), |reason| Err(Failure::input(reason)))
    }
}
