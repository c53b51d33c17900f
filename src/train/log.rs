//! `log.jsonl` of a run, and the same for `TensorBoard`.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::events::Events;
use super::judgement::Judgement;
use crate::error::FileError;
use crate::manifest::RunManifest;
use crate::rl::agent::TrainReport;
use crate::store::write_atomic;

/// How fast training went since the last report. Unlike all else it is never the same twice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pace {
    /// Transitions learned from in a second, all else that training does included.
    pub(super) samples_per_s: f64,
    /// Share of the time that it waited for maps.
    pub(super) waiting: f64,
}

/// Name of the log.
pub(super) const LOG: &str = RunManifest::LOG;

/// `log.jsonl`, of which what happened up to the checkpoint that a run goes on from is kept, for the rest will
/// happen again; and an event file.
pub(super) struct Log {
    path: PathBuf,
    file: File,
    events: Events,
}

impl Log {
    pub(super) fn open(run: &Path, updates: u64) -> Result<Self, FileError> {
        let path = run.join(LOG);
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

    pub(super) fn reported(&mut self, report: &TrainReport, pace: Pace) -> Result<(), FileError> {
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

    pub(super) fn judged(&mut self, update: u64, judgement: &Judgement) -> Result<(), FileError> {
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
