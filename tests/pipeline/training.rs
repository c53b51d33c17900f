//! Short runs of `holescout train` on the fixtures.

use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

use super::{HELSINKI, holescout, read, run, sha256, temporary_dir, write};

/// A network that is small enough for tests.
pub(crate) const SMALL: &str = "
[train]
updates = 24
batch_size = 8
num_envs = 8
learning_starts = 64
buffer_size = 256
widths = [4, 4, 4, 4, 4, 4, 4]
target_network_frequency = 5
precision = 'float32'
checkpoint_every = 2
evaluate_every = 12
evaluate_starts = 4
";

pub(crate) fn train(run: &Path, config: &Path, options: &[&str]) -> Command {
    train_on(&HELSINKI.dataset, run, config, options)
}

pub(crate) fn train_on(dataset: &Path, run: &Path, config: &Path, options: &[&str]) -> Command {
    let mut command = holescout("train");
    command.arg("--dataset").arg(dataset).arg("--config").arg(config);
    // Sums of floating-point numbers depend on how they are split.
    command.arg("--run").arg(run).args(options).args(["--threads", "1"]);
    command
}

/// A run of some updates: a directory for the test, the configuration and the run.
pub(crate) fn trained(updates: u32) -> (TempDir, PathBuf, PathBuf) {
    let dir = temporary_dir();
    let (config, out) = (dir.path().join("small.toml"), dir.path().join("run"));
    write(&config, SMALL);
    run(&mut train(&out, &config, &["--updates", &updates.to_string()])).succeeds();
    (dir, config, out)
}

/// `evaluate` of a policy on the val split.
pub(crate) fn evaluate(dataset: &Path, policy: &Path, out: &Path) -> Command {
    let mut command = holescout("evaluate");
    command.arg("--dataset").arg(dataset).arg("--policy").arg(policy);
    command.arg("--out").arg(out).args(["--split", "val"]);
    command
}

/// Makes a checkpoint's list of checksums fit its files.
pub(crate) fn seal(checkpoint: &Path) {
    let files = ["weights.safetensors", "learning.safetensors", "state.msgpack"];
    let line = |file| format!("{}  {file}\n", sha256(&read(&checkpoint.join(file))));
    write(&checkpoint.join("SHA256SUMS"), files.map(line).concat());
}
