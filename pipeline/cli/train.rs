//! What `train` and `export-policy` are asked for.

use std::path::PathBuf;

use clap::{Args, ValueEnum, ValueHint};
use holescout::config::{Config, TrainConfig};
use holescout::rl::agent::DeviceChoice;

use super::{OutputArgs, RemoteFlags, set};

#[derive(Debug, Args)]
pub(crate) struct TrainArgs {
    /// A dataset with a train and a val split: a directory, or an address (feature remote)
    #[arg(long, value_name = "DATASET", value_hint = ValueHint::DirPath)]
    pub(crate) dataset: PathBuf,
    #[command(flatten)]
    pub(super) remote: RemoteFlags,
    /// Directory of the run: checkpoints, the best policy, a log
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) run: PathBuf,
    /// Where to compute: auto takes a graphics card if there is one
    #[arg(long, value_enum, value_name = "DEVICE", default_value = "auto")]
    pub(crate) device: DeviceName,
    #[command(flatten)]
    pub(super) training: TrainFlags,
}

#[derive(Debug, Args)]
pub(crate) struct ExportPolicyArgs {
    /// The checkpoint, for instance RUN/best
    #[arg(value_name = "CHECKPOINT", value_hint = ValueHint::DirPath)]
    pub(crate) checkpoint: PathBuf,
    #[command(flatten)]
    pub(crate) output: OutputArgs,
}

/// A device by name.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum DeviceName {
    Auto,
    Cpu,
    Cuda,
}

impl DeviceName {
    pub(crate) fn choice(self) -> DeviceChoice {
        match self {
            Self::Auto => DeviceChoice::Auto,
            Self::Cpu => DeviceChoice::Cpu,
            Self::Cuda => DeviceChoice::Cuda,
        }
    }
}

/// Flags for `[train]`.
#[derive(Debug, Args)]
pub(super) struct TrainFlags {
    /// Take [train] from a preset, whatever the file says: paper as published, best what works best
    #[arg(long, value_enum, value_name = "NAME")]
    preset: Option<Preset>,
    /// train.updates: gradient updates of the whole run
    #[arg(long, value_name = "N")]
    updates: Option<u64>,
    /// train.batch_size: transitions in an update
    #[arg(long, value_name = "N")]
    batch_size: Option<u32>,
    /// train.learning_rate
    #[arg(long, value_name = "F")]
    learning_rate: Option<f64>,
    /// train.seed
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// train.checkpoint_every: updates between checkpoints
    #[arg(long, value_name = "N")]
    checkpoint_every: Option<u64>,
    /// train.evaluate_every: updates between validations
    #[arg(long, value_name = "N")]
    evaluate_every: Option<u64>,
}

/// Where `[train]` begins.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Preset {
    Paper,
    Best,
}

impl TrainFlags {
    pub(super) fn apply(&self, config: &mut Config) {
        let Config { train, .. } = config;
        match self.preset {
            Some(Preset::Paper) => *train = TrainConfig::paper(),
            Some(Preset::Best) => *train = TrainConfig::default(),
            None => {}
        }
        set(&mut train.updates, self.updates.as_ref());
        set(&mut train.batch_size, self.batch_size.as_ref());
        set(&mut train.learning_rate, self.learning_rate.as_ref());
        set(&mut train.seed, self.seed.as_ref());
        set(&mut train.checkpoint_every, self.checkpoint_every.as_ref());
        set(&mut train.evaluate_every, self.evaluate_every.as_ref());
    }
}
