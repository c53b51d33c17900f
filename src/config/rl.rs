//! `[rl]` and `[evaluate]`: the task, and how policies are judged on it.

use std::fmt;
use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{ConfigError, demand};
use crate::units::Dbm;

/// `[rl]`: the task. Nothing here needs a dataset to be built again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RlConfig {
    /// Outdoor cells below this are coverage holes, in dBm per resource element.
    pub hole_threshold_dbm: Dbm,
    /// Cells at least this high are occupied, in metres.
    pub flight_height_m: f64,
    /// Lower levels are raised to this, and cells that no path reaches have it, in dBm: what a
    /// receiver can still tell apart.
    pub floor_dbm: Dbm,
    /// Cells that one step may lead in each of the four directions (the paper's l).
    pub reach_cells: u32,
    /// Decay of the encodings with distance, per cell (the paper's c).
    pub encoding_decay: f64,
    /// Heights are divided by this before a network sees them, in metres.
    pub height_scale_m: f64,
    /// Steps after which an episode of training is cut off.
    pub max_steps: u32,
}

impl Default for RlConfig {
    fn default() -> Self {
        Self {
            hole_threshold_dbm: Dbm(-100.0),
            flight_height_m: 2.0,
            floor_dbm: Dbm(-160.0),
            reach_cells: 15,
            encoding_decay: 0.1,
            height_scale_m: 50.0,
            max_steps: 8,
        }
    }
}

impl RlConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let (Dbm(threshold), Dbm(floor)) = (self.hole_threshold_dbm, self.floor_dbm);
        demand(
            (-300.0..0.0).contains(&threshold),
            "rl.hole_threshold_dbm",
            threshold,
            "-300 to below 0 dBm: levels are normalised by it",
        )?;
        demand(
            (-500.0..threshold).contains(&floor),
            "rl.floor_dbm",
            floor,
            format!("-500 dBm to below rl.hole_threshold_dbm = {threshold}"),
        )?;
        demand(
            self.flight_height_m > 0.0 && self.flight_height_m.is_finite(),
            "rl.flight_height_m",
            self.flight_height_m,
            "more than 0 m",
        )?;
        demand(
            (1..=31).contains(&self.reach_cells),
            "rl.reach_cells",
            self.reach_cells,
            "1 to 31",
        )?;
        demand(
            self.encoding_decay > 0.0 && self.encoding_decay <= 10.0,
            "rl.encoding_decay",
            self.encoding_decay,
            "more than 0 and at most 10 per cell",
        )?;
        demand(
            self.height_scale_m > 0.0 && self.height_scale_m.is_finite(),
            "rl.height_scale_m",
            self.height_scale_m,
            "more than 0 m",
        )?;
        demand((1..=254).contains(&self.max_steps), "rl.max_steps", self.max_steps, "1 to 254")
    }
}

/// A method that is evaluated, by the name used in files and on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
#[non_exhaustive]
pub enum Method {
    /// `rsp`: the random starts themselves.
    RandomSampling,
    /// `bnp-8`: random cells at most so many metres from a wall.
    Neighbourhood(u16),
    /// `g-rsp`: descent of the coverage map from the random starts, on grid positions.
    Gradient,
    /// `g-rsp-continuous`: the same with positions kept between cells.
    GradientContinuous,
    /// `g-bnp-8`: descent from a neighbourhood's cells and within it, on grid positions.
    BoundedGradient(u16),
    /// `g-bnp-8-continuous`: the same with positions kept between cells.
    BoundedGradientContinuous(u16),
    /// `shadow`: to the nearest cell that a building hides from the base station.
    Shadow,
    /// `random-walk`: over permissible cells.
    RandomWalk,
    /// `wall-walk`: over permissible cells beside walls.
    WallWalk,
    /// `oracle`: a shortest way to a hole.
    Oracle,
    /// `leave-one-out`: to where the levels of all other cells make a hole most likely, as learned from
    /// the train split.
    LeaveOneOut,
    /// `trees`: to where boosted trees, fitted on the train split, find a hole most likely.
    Trees,
    /// `trees-told-bs`: the same, told where the base station is.
    TreesToldBs,
    /// `belief`: to where a hole is most likely by what is believed of the base station's place.
    Belief,
    /// `agent`: a trained network, which must be given.
    Agent,
    /// `predictor`: to where that network finds a hole most likely, without planning.
    Predictor,
}

impl Method {
    /// Whether it learns from the train split before it flies.
    #[must_use]
    pub fn learns(self) -> bool {
        matches!(self, Self::Trees | Self::TreesToldBs | Self::LeaveOneOut | Self::Belief)
    }
}

/// A string that names no method.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error(
    "{0:?} is no method (expected rsp, bnp-<metres>, g-rsp, g-rsp-continuous, g-bnp-<metres>, \
     g-bnp-<metres>-continuous, shadow, random-walk, wall-walk, oracle, leave-one-out, trees, \
     trees-told-bs, belief, agent or predictor)"
)]
pub struct MethodError(pub String);

impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::RandomSampling => f.write_str("rsp"),
            Self::Neighbourhood(metres) => write!(f, "bnp-{metres}"),
            Self::Gradient => f.write_str("g-rsp"),
            Self::GradientContinuous => f.write_str("g-rsp-continuous"),
            Self::BoundedGradient(metres) => write!(f, "g-bnp-{metres}"),
            Self::BoundedGradientContinuous(metres) => write!(f, "g-bnp-{metres}-continuous"),
            Self::Shadow => f.write_str("shadow"),
            Self::RandomWalk => f.write_str("random-walk"),
            Self::WallWalk => f.write_str("wall-walk"),
            Self::Oracle => f.write_str("oracle"),
            Self::LeaveOneOut => f.write_str("leave-one-out"),
            Self::Trees => f.write_str("trees"),
            Self::TreesToldBs => f.write_str("trees-told-bs"),
            Self::Belief => f.write_str("belief"),
            Self::Agent => f.write_str("agent"),
            Self::Predictor => f.write_str("predictor"),
        }
    }
}

impl FromStr for Method {
    type Err = MethodError;

    fn from_str(name: &str) -> Result<Self, MethodError> {
        let method = match name {
            "rsp" => Some(Self::RandomSampling),
            "g-rsp" => Some(Self::Gradient),
            "g-rsp-continuous" => Some(Self::GradientContinuous),
            "shadow" => Some(Self::Shadow),
            "random-walk" => Some(Self::RandomWalk),
            "wall-walk" => Some(Self::WallWalk),
            "oracle" => Some(Self::Oracle),
            "leave-one-out" => Some(Self::LeaveOneOut),
            "trees" => Some(Self::Trees),
            "trees-told-bs" => Some(Self::TreesToldBs),
            "belief" => Some(Self::Belief),
            "agent" => Some(Self::Agent),
            "predictor" => Some(Self::Predictor),
            _ => with_distance(name),
        };
        // Only the canonical spelling: `bnp-08` and `bnp-8` must not be two methods.
        method.filter(|method| method.to_string() == name).ok_or(MethodError(name.to_owned()))
    }
}

fn with_distance(name: &str) -> Option<Method> {
    if let Some(metres) = name.strip_prefix("bnp-") {
        return Some(Method::Neighbourhood(metres.parse().ok()?));
    }
    let rest = name.strip_prefix("g-bnp-")?;
    match rest.strip_suffix("-continuous") {
        Some(metres) => Some(Method::BoundedGradientContinuous(metres.parse().ok()?)),
        None => Some(Method::BoundedGradient(rest.parse().ok()?)),
    }
}

impl TryFrom<String> for Method {
    type Error = MethodError;

    fn try_from(name: String) -> Result<Self, MethodError> {
        name.parse()
    }
}

impl From<Method> for String {
    fn from(method: Method) -> Self {
        method.to_string()
    }
}

impl JsonSchema for Method {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Method".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({
            "type": "string",
            "description": "Name of a method.",
            "pattern": "^(rsp|bnp-[0-9]+|g-rsp(-continuous)?|g-bnp-[0-9]+(-continuous)?|shadow|random-walk|wall-walk|oracle|leave-one-out|trees(-told-bs)?|belief|agent|predictor)$"
        })
    }
}

/// `[evaluate]`: how policies are judged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EvaluateConfig {
    /// Methods to evaluate.
    pub methods: Vec<Method>,
    /// Random unique starts on each map (the paper's `N_sam`).
    pub starts: u32,
    /// Numbers of steps after which the prediction is judged (the paper's k).
    pub steps: Vec<u32>,
    /// Seed of starts, random policies, noise, stale maps and resampling.
    pub seed: u64,
    /// Resamples of the maps for the 95 % intervals.
    pub bootstrap: u32,
    /// Update rate of gradient descent, in cells per (dB per cell).
    pub gradient_rate: f64,
    /// Standard deviation of the Gaussian that smooths the coverage map before its gradient is
    /// taken, in cells; 0 for none.
    pub gradient_smoothing_cells: f64,
    /// Standard deviation of the error of measured levels, in dB.
    pub noise_db: f64,
    /// Share of the buildings that the stored map lacks, 0 to 1.
    pub stale_share: f64,
    /// Maps in the report's gallery.
    pub gallery_maps: u32,
    /// Starts on each of them.
    pub gallery_starts: u32,
}

impl Default for EvaluateConfig {
    fn default() -> Self {
        Self {
            methods: vec![
                Method::RandomSampling,
                Method::Neighbourhood(32),
                Method::Neighbourhood(16),
                Method::Neighbourhood(8),
                Method::Gradient,
                Method::GradientContinuous,
                Method::BoundedGradient(8),
                Method::BoundedGradientContinuous(8),
                Method::Shadow,
                Method::RandomWalk,
                Method::WallWalk,
                Method::Trees,
                Method::Belief,
                Method::TreesToldBs,
                Method::LeaveOneOut,
                Method::Oracle,
            ],
            starts: 200,
            steps: vec![0, 1, 2, 4, 8],
            seed: 0,
            bootstrap: 2000,
            gradient_rate: 1.0,
            gradient_smoothing_cells: 0.0,
            noise_db: 0.0,
            stale_share: 0.0,
            gallery_maps: 12,
            gallery_starts: 6,
        }
    }
}

impl EvaluateConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let listed = |methods: &[Method]| {
            methods.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
        };
        let unique: std::collections::BTreeSet<_> = self.methods.iter().collect();
        demand(
            !self.methods.is_empty() && unique.len() == self.methods.len(),
            "evaluate.methods",
            format!("[{}]", listed(&self.methods)),
            "at least one method, each of them once",
        )?;
        let starts = self.starts;
        demand((1..=100_000).contains(&starts), "evaluate.starts", starts, "1 to 100000")?;
        demand(
            !self.steps.is_empty()
                && self.steps.is_sorted_by(|a, b| a < b)
                && self.steps.iter().all(|&k| k <= 1000),
            "evaluate.steps",
            format!("{:?}", self.steps),
            "numbers from 0 to 1000, rising",
        )?;
        let bootstrap = self.bootstrap;
        demand(
            (100..=100_000).contains(&bootstrap),
            "evaluate.bootstrap",
            bootstrap,
            "100 to 100000 resamples",
        )?;
        demand(
            self.gradient_rate > 0.0 && self.gradient_rate.is_finite(),
            "evaluate.gradient_rate",
            self.gradient_rate,
            "more than 0",
        )?;
        demand(
            (0.0..=50.0).contains(&self.gradient_smoothing_cells),
            "evaluate.gradient_smoothing_cells",
            self.gradient_smoothing_cells,
            "0 to 50 cells",
        )?;
        let noise = self.noise_db;
        demand((0.0..=100.0).contains(&noise), "evaluate.noise_db", noise, "0 to 100 dB")?;
        demand(
            (0.0..=1.0).contains(&self.stale_share),
            "evaluate.stale_share",
            self.stale_share,
            "a share from 0 to 1",
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn method_names_round_trip_and_have_one_spelling() {
        let trained = [Method::Agent, Method::Predictor];
        for method in EvaluateConfig::default().methods.into_iter().chain(trained) {
            assert_eq!(method.to_string().parse(), Ok(method));
        }
        for wrong in ["", "bnp", "bnp-", "bnp-08", "bnp-8m", "g-bnp--continuous", "G-RSP"] {
            assert!(wrong.parse::<Method>().is_err(), "{wrong}");
        }
    }
}
