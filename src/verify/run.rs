//! Runs of training: what `run.json`, checkpoints and log tell belongs together.
//!
//! A run grows for as long as it likes, so there is no list of all its files: each checkpoint has one.

use std::path::Path;

use serde::Deserialize;
use serde_json::Value;

use super::failure::{VerifyFailure, failure};
use crate::error::FileError;
use crate::manifest::{ManifestError, RunManifest, parse};
use crate::progress::Progress;
use crate::store::{SUMS, read_sealed, sealed_files};

const STATE: &str = RunManifest::STATE;
const LOG: &str = RunManifest::LOG;

/// What all checkpoints tell.
#[derive(Deserialize)]
struct CheckpointFacts {
    dataset_sha256: String,
    rl: Value,
    counters: Counted,
}

#[derive(Deserialize)]
struct Counted {
    updates: u64,
}

/// Lists what is wrong, and returns the numbers of files and checkpoints.
pub(super) fn check(
    root: &Path,
    progress: &dyn Progress,
    failures: &mut Vec<VerifyFailure>,
) -> Result<(usize, usize), ManifestError> {
    let path = root.join(RunManifest::FILE);
    let bytes = std::fs::read(&path).map_err(FileError::new("read", &path))?;
    let manifest: RunManifest = parse(&bytes, &path)?;
    let mut checkpoints: Vec<String> = std::fs::read_dir(root.join(RunManifest::CHECKPOINTS))
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| {
            format!("{}/{}", RunManifest::CHECKPOINTS, entry.file_name().to_string_lossy())
        })
        .collect();
    checkpoints.sort();
    let best = root.join(RunManifest::BEST).exists();
    checkpoints.extend(best.then(|| RunManifest::BEST.to_owned()));
    progress.begin("reading checkpoints", Some(checkpoints.len() as u64));
    let mut files = 1;
    for name in &checkpoints {
        files += check_checkpoint(&root.join(name), name, &manifest, failures);
        progress.advance(1);
    }
    progress.end();
    check_log(root, failures);
    Ok((files, checkpoints.len()))
}

fn check_checkpoint(
    directory: &Path,
    name: &str,
    manifest: &RunManifest,
    failures: &mut Vec<VerifyFailure>,
) -> usize {
    let mut wrong = |file: &str, reason: String| {
        failures.push(failure(&format!("{name}/{file}"), reason));
    };
    let files = match sealed_files(directory) {
        Ok(files) => files,
        Err(error) => {
            wrong(SUMS, error.to_string());
            return 0;
        }
    };
    // The state is read below, for what it tells.
    for file in files.iter().filter(|file| *file != STATE) {
        if let Err(error) = read_sealed(directory, file) {
            wrong(file, error.to_string());
        }
    }
    let bytes = match read_sealed(directory, STATE) {
        Ok(bytes) => bytes,
        Err(error) => {
            wrong(STATE, error.to_string());
            return files.len();
        }
    };
    match rmp_serde::from_slice::<CheckpointFacts>(&bytes) {
        Err(error) => wrong(STATE, error.to_string()),
        Ok(CheckpointFacts { dataset_sha256, rl, counters }) => {
            if dataset_sha256 != manifest.dataset.sha256 {
                wrong(STATE, format!("of another dataset than {}", RunManifest::FILE));
            }
            if serde_json::to_value(&manifest.rl).ok() != Some(rl) {
                wrong(STATE, format!("its rl is not that of {}", RunManifest::FILE));
            }
            let number = name.rsplit('/').next().and_then(|number| number.parse::<u64>().ok());
            if number.is_some_and(|number| number != counters.updates) {
                wrong(
                    STATE,
                    format!("of update {}, its directory says otherwise", counters.updates),
                );
            }
        }
    }
    files.len()
}

/// Every line of the log is JSON with an update, none before the one above it.
fn check_log(root: &Path, failures: &mut Vec<VerifyFailure>) {
    let Ok(text) = std::fs::read_to_string(root.join(LOG)) else {
        return;
    };
    let mut last = 0;
    for (number, line) in text.lines().enumerate() {
        let update = serde_json::from_str::<Value>(line).ok();
        match update.and_then(|line| line["update"].as_u64()) {
            Some(update) if update >= last => last = update,
            Some(update) => {
                let reason = format!("line {}: update {update} after {last}", number + 1);
                failures.push(failure(LOG, reason));
            }
            None => failures.push(failure(LOG, format!("line {}: no update", number + 1))),
        }
    }
}
