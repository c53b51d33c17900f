//! `holescout diff`.

use std::fmt::Display;

use holescout::dataset::Dataset;
use holescout::release::{Change, Diff, diff};
use serde_json::{Value, json};

use crate::cli::DiffArgs;
use crate::console::{Console, Report};
use crate::failure::Failure;

/// More of a kind are counted, not printed; `--json` has them all.
const MOST_PRINTED: usize = 10;

pub(crate) fn run(args: &DiffArgs, console: &Console) -> Result<Report, Failure> {
    let (a, b) = (Dataset::open(&args.a)?, Dataset::open(&args.b)?);
    let diff = diff(&a, &b, console)?;
    let mut summary = json!(diff);
    summary["stage"] = json!("diff");
    summary["least_version"] = json!(diff.least_version().map(|version| version.to_string()));
    summary["version_is_enough"] = json!(diff.is_enough());
    let report = Report::new(text(&diff), &summary)?;
    match (args.check, diff.is_enough()) {
        (true, Some(false)) => Ok(report.failed(verdict(&diff))),
        (true, None) => Ok(report.failed("--check compares two releases".to_owned())),
        _ => Ok(report),
    }
}

fn text(diff: &Diff) -> String {
    let Diff { records, files, .. } = diff;
    let changed = records.changed.iter().map(|it| format!("{}: {}", it.id, it.fields.join(", ")));
    let moved = records.moved.iter().map(|it| format!("{}: {} to {}", it.id, it.from, it.to));
    let parts = [
        part("records added", &records.added),
        part("records removed", &records.removed),
        part("records in another split", &moved.collect::<Vec<_>>()),
        part("records changed", &changed.collect::<Vec<_>>()),
        part("configuration", &in_words(&diff.config)),
        part("inputs", &in_words(&diff.inputs)),
        part("other", &in_words(&diff.facts)),
        part("files added", &files.added),
        part("files removed", &files.removed),
        part("files changed", &files.changed),
    ];
    let reason = diff.reasons.first().map(|reason| format!(" ({})", reason.text));
    let step = format!("step: {}{}\n", diff.step.name(), reason.unwrap_or_default());
    let verdict = diff.least_version().map(|_| format!("{}\n", verdict(diff)));
    [parts.concat(), step, verdict.unwrap_or_default()].concat()
}

fn part(title: &str, lines: &[impl Display]) -> String {
    if lines.is_empty() {
        return String::new();
    }
    let mut text = vec![format!("{title}: {}\n", lines.len())];
    text.extend(lines.iter().take(MOST_PRINTED).map(|line| format!("  {line}\n")));
    if lines.len() > MOST_PRINTED {
        text.push(format!("  and {} more\n", lines.len() - MOST_PRINTED));
    }
    text.concat()
}

fn in_words(changes: &[Change]) -> Vec<String> {
    let word = |value: &Option<Value>| match value {
        None => "absent".to_owned(),
        Some(value) => value.to_string(),
    };
    let line =
        |change: &Change| format!("{}: {} to {}", change.key, word(&change.old), word(&change.new));
    changes.iter().map(line).collect()
}

/// What the version should be.
fn verdict(diff: &Diff) -> String {
    let version = |version: &Option<String>| version.clone().unwrap_or_default();
    let (a, b) = (version(&diff.a.version), version(&diff.b.version));
    let least = diff.least_version().map(|version| version.to_string()).unwrap_or_default();
    match diff.is_enough() {
        None => format!("after {a}, a release of B must be at least {least}"),
        Some(true) => format!("{a} to {b}: far enough, at least {least}"),
        Some(false) => format!("{b} should be at least {least}, after {a}"),
    }
}
