//! `[train]`: how the Q-network is trained.

use std::num::NonZero;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{ConfigError, demand};

/// Which numbers the network computes with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    /// `bfloat16` on graphics cards and where the CPU multiplies it natively, else `float32`.
    Auto,
    /// 32 bits throughout.
    Float32,
    /// Activations and weights of 16 bits; the weights that are learned have 32.
    Bfloat16,
}

/// In which frame the network sees a state, and with it the shape of the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Encoding {
    /// `I_A` and `I_B` as published: the whole map where it lies, and its part within reach.
    Paper,
    /// Both centred on the UAV: the reach and 15 cells more at full resolution, and the whole map in
    /// blocks. Shows `train.channels`.
    Centered,
}

/// What one channel of the centred encoding shows.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Channel {
    /// 1 for occupied cells and beyond the map.
    Occupied,
    /// 1 beyond the map.
    Beyond,
    /// √(h / 4 m) of the height h of buildings.
    Height,
    /// Measured levels: the mean of (Z - ε) / 20 dB, weighed by 2^(-c d) at a distance of d cells.
    Level,
    /// The sum of these weights.
    Weight,
    /// 1 for permissible moves.
    Permissible,
    /// 1 for visited cells.
    Visited,
    /// 2^(-c d) at a distance of d cells from the UAV (equation 7).
    Location,
}

impl Channel {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Occupied,
        Self::Beyond,
        Self::Height,
        Self::Level,
        Self::Weight,
        Self::Permissible,
        Self::Visited,
        Self::Location,
    ];

    /// Whether blocks of the whole map show it too; the others say nothing beyond the reach.
    #[must_use]
    pub fn is_coarse(self) -> bool {
        !matches!(self, Self::Permissible | Self::Visited | Self::Location)
    }
}

/// How an error becomes a loss.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Loss {
    /// The square, as in the paper (equation 14).
    Squared,
    /// The square up to 1, linear beyond (Huber).
    Huber,
}

/// What becomes of a record that cannot be read: a damaged frame, a shard that is missing or cut.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnDamage {
    /// It is an error.
    #[default]
    Error,
    /// It is left out, counted and reported. What another try may mend (a network that fails, a
    /// permission) stays an error.
    Quarantine,
}

/// What settings were called before, and what they are called: the words of `CleanRL` and `Stable-Baselines3`.
pub(super) const RENAMED: [(&str, &str); 15] = [
    ("batch", "batch_size"),
    ("episodes", "num_envs"),
    ("updates_per_step", "gradient_steps"),
    ("replay", "buffer_size"),
    ("warmup", "learning_starts"),
    ("discount", "gamma"),
    ("return_steps", "n_step"),
    ("target_sync", "target_network_frequency"),
    ("target_share", "tau (1, not 0, for all of the weights)"),
    ("epsilon_start", "start_e"),
    ("epsilon_end", "end_e"),
    ("epsilon_decay", "exploration_fraction"),
    ("clip_norm", "max_grad_norm"),
    ("priority_exponent", "priority_alpha"),
    ("priority_correction", "priority_beta"),
];

/// `[train]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[allow(clippy::struct_excessive_bools, reason = "each is a choice of its own")]
pub struct TrainConfig {
    /// Seed of weights, episodes, exploration and sampling.
    pub seed: u64,
    /// Gradient updates of the whole run.
    pub updates: u64,
    /// Transitions in an update.
    pub batch_size: u32,
    /// Episodes at a time.
    pub num_envs: u32,
    /// Updates for each step of all episodes.
    pub gradient_steps: u32,
    /// Transitions that the replay holds.
    pub buffer_size: u32,
    /// Transitions before the first update.
    pub learning_starts: u32,
    /// Learning rate of Adam, at first.
    pub learning_rate: f64,
    /// The learning rate falls along a line, to 0 at the last update.
    pub anneal_learning_rate: bool,
    /// Discount of later rewards (the paper's γ).
    pub gamma: f64,
    /// Steps whose rewards a transition adds up before it relies on a Q-value (n-step returns);
    /// 1 as in the paper.
    pub n_step: u32,
    /// Updates after which the target network takes over weights.
    pub target_network_frequency: u32,
    /// Share of the weights that it takes over then: 1 for all of them, less for Polyak averaging.
    pub tau: f64,
    /// Share of random actions at first.
    pub start_e: f64,
    /// Share of random actions in the end.
    pub end_e: f64,
    /// Updates over which it falls, as a share of all.
    pub exploration_fraction: f64,
    /// How an error of a Q-value becomes a loss.
    pub loss: Loss,
    /// Gradients longer than this are shortened to it; 0 for never.
    pub max_grad_norm: f64,
    /// Transitions are sampled in proportion to their error to this power (prioritised replay);
    /// 0 for all alike.
    pub priority_alpha: f64,
    /// How far weights make good for that at first (the β of Schaul et al., 2016); it rises to 1.
    pub priority_beta: f64,
    /// Weight of the squared reward in the loss (the paper's α). It has no gradient, and is kept
    /// so that losses compare with the paper's.
    pub squared_reward: f64,
    /// Weight of the loss of the head that predicts the rewards of all actions; 0 for no such head.
    pub reward_prediction: f64,
    /// Weight of the cross-entropy of the head that predicts for each move whether it leads to a
    /// hole, P(hole), over permissible moves to cells not yet visited; 0 for no such head.
    pub hole_prediction: f64,
    /// Q-values are (1 - P(hole)) (r + γ V), r being the reward of a step: a network learns P(hole) of
    /// all moves, and V, the value of what follows, of `value_moves` of a state.
    pub factored: bool,
    /// Moves of a state that V is learned from: the one taken and random others that lead to no hole. As many
    /// fewer states of a batch are looked at. How V differs from move to move is learned by comparing
    /// them, so 1 learns only what they have in common.
    pub value_moves: u32,
    /// Teach the Q-values of all actions that end the episode, not only of the one taken.
    pub dense_terminal: bool,
    /// Choose among permissible actions only.
    pub mask_actions: bool,
    /// Neither stay nor return to a visited cell, which is known to be no hole, while there are
    /// other permissible moves.
    pub avoid_visited: bool,
    /// Flip and rotate each sample at random, map and action together.
    pub augment: bool,
    /// Q-values are the sum of a state's value and its actions' advantages (dueling network).
    pub dueling: bool,
    /// In which frame the network sees a state.
    pub encoding: Encoding,
    /// What the centred encoding shows, each once; of no effect on that of the paper.
    pub channels: Vec<Channel>,
    /// Channels of the hidden layers. `paper`: three convolutions and a transposed one over the map,
    /// two convolutions over the surroundings, a transposed one over both. `centered`: three
    /// convolutions over the whole map, then over the surroundings at full, half and quarter
    /// resolution, and the last one.
    pub widths: [u32; 7],
    /// Numbers that the network computes with.
    pub precision: Precision,
    /// Memory for maps, in MB. If the split does not fit, a part of it is held, and replaced map by
    /// map as training goes on.
    pub map_memory_mb: u32,
    /// Steps of all episodes after which one map is replaced then.
    pub refresh_every: u32,
    /// Shards that are shuffled together then; absent for all of the split.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub block: Option<NonZero<usize>>,
    /// What becomes of maps that cannot be read.
    pub on_damage: OnDamage,
    /// Updates after which a checkpoint is written.
    pub checkpoint_every: u64,
    /// Updates after which the policy is judged on the validation split.
    pub evaluate_every: u64,
    /// Maps of the validation split on which it is, chosen at random.
    pub evaluate_maps: u32,
    /// Starts on each of them.
    pub evaluate_starts: u32,
    /// Judgements without a better score after which training stops early; 0 for never.
    pub patience: u32,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            updates: 2000,
            batch_size: 64,
            num_envs: 64,
            gradient_steps: 1,
            buffer_size: 1_000_000,
            learning_starts: 4096,
            learning_rate: 1e-3,
            anneal_learning_rate: true,
            gamma: 0.99,
            n_step: 1,
            target_network_frequency: 250,
            tau: 1.0,
            start_e: 1.0,
            end_e: 0.05,
            exploration_fraction: 0.3,
            loss: Loss::Huber,
            max_grad_norm: 10.0,
            priority_alpha: 0.0,
            priority_beta: 0.4,
            squared_reward: 0.0,
            reward_prediction: 0.0,
            hole_prediction: 1.0,
            factored: false,
            value_moves: 4,
            dense_terminal: false,
            mask_actions: true,
            avoid_visited: true,
            augment: true,
            dueling: false,
            encoding: Encoding::Centered,
            channels: Channel::ALL.to_vec(),
            widths: [16, 32, 32, 16, 32, 64, 32],
            precision: Precision::Auto,
            map_memory_mb: 2048,
            refresh_every: 8,
            block: None,
            on_damage: OnDamage::Error,
            checkpoint_every: 250,
            evaluate_every: 250,
            evaluate_maps: 100,
            evaluate_starts: 100,
            patience: 0,
        }
    }
}

impl TrainConfig {
    /// As published: squared loss, no clipping, α r² (which has no gradient), actions of the whole
    /// square, no augmentation and no auxiliary head. What the paper does not tell is as by default.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            loss: Loss::Squared,
            learning_rate: 5e-4,
            anneal_learning_rate: false,
            max_grad_norm: 0.0,
            squared_reward: 1.0,
            hole_prediction: 0.0,
            mask_actions: false,
            avoid_visited: false,
            augment: false,
            encoding: Encoding::Paper,
            widths: [32, 64, 128, 64, 32, 64, 32],
            ..Self::default()
        }
    }

    /// Channels that the network gets of the whole map, and of the surroundings.
    #[must_use]
    pub fn inputs(&self) -> [usize; 2] {
        match self.encoding {
            Encoding::Paper => [3; 2],
            Encoding::Centered => {
                let coarse = self.channels.iter().filter(|channel| channel.is_coarse()).count();
                [coarse, self.channels.len()]
            }
        }
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let counts = [
            ("train.batch_size", self.batch_size, 65_536),
            ("train.num_envs", self.num_envs, 65_536),
            ("train.gradient_steps", self.gradient_steps, 1000),
            ("train.buffer_size", self.buffer_size, 100_000_000),
            ("train.learning_starts", self.learning_starts, self.buffer_size),
            ("train.n_step", self.n_step, 8),
            ("train.value_moves", self.value_moves, 64),
            ("train.target_network_frequency", self.target_network_frequency, 10_000_000),
            ("train.map_memory_mb", self.map_memory_mb, 1_000_000),
            ("train.refresh_every", self.refresh_every, 10_000_000),
            ("train.evaluate_maps", self.evaluate_maps, 1_000_000),
            ("train.evaluate_starts", self.evaluate_starts, 100_000),
        ];
        for (key, value, most) in counts {
            demand((1..=most).contains(&value), key, value, format!("1 to {most}"))?;
        }
        demand(
            self.learning_starts >= self.batch_size,
            "train.learning_starts",
            self.learning_starts,
            "at least train.batch_size",
        )?;
        for (key, value) in [
            ("train.updates", self.updates),
            ("train.checkpoint_every", self.checkpoint_every),
            ("train.evaluate_every", self.evaluate_every),
        ] {
            demand(value > 0, key, value, "at least 1")?;
        }
        let shares = [
            ("train.gamma", self.gamma),
            ("train.priority_alpha", self.priority_alpha),
            ("train.priority_beta", self.priority_beta),
            ("train.start_e", self.start_e),
            ("train.end_e", self.end_e),
            ("train.exploration_fraction", self.exploration_fraction),
        ];
        for (key, value) in shares {
            demand((0.0..=1.0).contains(&value), key, value, "0 to 1")?;
        }
        demand(self.tau > 0.0 && self.tau <= 1.0, "train.tau", self.tau, "above 0, at most 1")?;
        let weights = [
            ("train.max_grad_norm", self.max_grad_norm),
            ("train.squared_reward", self.squared_reward),
            ("train.reward_prediction", self.reward_prediction),
            ("train.hole_prediction", self.hole_prediction),
        ];
        for (key, value) in weights {
            demand(value >= 0.0 && value.is_finite(), key, value, "0 or more")?;
        }
        let factored_needs = "false, or train.hole_prediction above 0, train.mask_actions, \
                              train.n_step = 1, train.priority_alpha = 0 and no \
                              train.dueling";
        let can_be_factored = self.hole_prediction > 0.0
            && self.mask_actions
            && self.n_step == 1
            && self.priority_alpha <= 0.0
            && !self.dueling;
        demand(!self.factored || can_be_factored, "train.factored", true, factored_needs)?;
        let avoid_needs = "false, or train.mask_actions";
        demand(!self.avoid_visited || self.mask_actions, "train.avoid_visited", true, avoid_needs)?;
        let unique: std::collections::BTreeSet<_> = self.channels.iter().collect();
        demand(
            unique.len() == self.channels.len()
                && self.channels.iter().any(|channel| channel.is_coarse()),
            "train.channels",
            format!("{:?}", self.channels),
            "channels, each once, of which one at least shows the whole map: occupied, beyond, \
             height, level or weight",
        )?;
        let rate = self.learning_rate;
        demand(rate > 0.0 && rate < 1.0, "train.learning_rate", rate, "between 0 and 1")?;
        demand(
            self.widths.iter().all(|width| (1..=4096).contains(width)),
            "train.widths",
            format!("{:?}", self.widths),
            "seven numbers from 1 to 4096",
        )
    }
}
