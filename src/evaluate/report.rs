//! `report.json`: everything that an evaluation found out, as serde types.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::config::{EvaluateConfig, Method, RlConfig};
use crate::dataset::Dataset;
use crate::manifest::Software;

/// A mean over maps with its 95 % bootstrap interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Interval {
    /// The mean over all maps.
    pub mean: f64,
    /// 2.5 % of the resampled means are lower.
    pub low: f64,
    /// 2.5 % of the resampled means are higher.
    pub high: f64,
}

/// The dataset that was used.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DatasetUsed {
    /// SHA-256 of its manifest.
    pub sha256: String,
    /// Attributions that must stay with everything made of it.
    pub attribution: Vec<String>,
    /// Licences, as SPDX identifiers.
    pub licences: Vec<String>,
}

impl DatasetUsed {
    /// What a report says about a dataset.
    #[must_use]
    pub fn of(dataset: &Dataset) -> Self {
        let manifest = dataset.manifest();
        Self {
            sha256: dataset.digest().sha256.clone(),
            attribution: vec![manifest.attribution.clone()],
            licences: vec![manifest.licence.clone()],
        }
    }
}

/// What a method is told beside what it measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Knows {
    /// The outdoor cells only.
    Nothing,
    /// The building map.
    Buildings,
    /// The building map and what was measured on the way: the paper's UAV.
    Measurements,
    /// The building map and where the base station is.
    BaseStation,
    /// The whole coverage map: more than any UAV can know.
    CoverageMap,
    /// Where all coverage holes are: the bound.
    Holes,
}

/// A method that was evaluated.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MethodInfo {
    /// The name used everywhere else.
    pub name: Method,
    /// The name for people.
    pub title: String,
    /// What it does, in a sentence.
    pub description: String,
    /// What it is told.
    pub knows: Knows,
    /// Whether it moves; a method that does not is judged at k = 0 alone.
    pub multi_step: bool,
}

/// The maps that were used.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MapsUsed {
    /// Maps evaluated.
    pub evaluated: u64,
    /// Of these, maps without a coverage hole; they have precision but no recall.
    pub without_holes: u64,
    /// Of these, maps without an outdoor cell; they have neither.
    pub without_starts: u64,
    /// Pairs of maps that share cells: intervals then are too narrow.
    pub overlapping_pairs: u64,
    /// Outdoor cells of all maps.
    pub outdoor_cells: u64,
    /// Coverage holes of all maps.
    pub hole_cells: u64,
}

/// Precision and recall, as the paper defines them, of a method after at most k steps from
/// a number of starts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Score {
    /// The method.
    pub method: Method,
    /// Steps (k).
    pub k: u32,
    /// Starts on each map (`N_sam`); a map with fewer cells to start from uses all it has.
    pub starts: u32,
    /// Maps that have a cell to start from.
    pub maps: u64,
    /// Share of the predicted cells that are holes.
    pub precision: Option<Interval>,
    /// Share of a map's holes that are among the predicted cells.
    pub recall: Option<Interval>,
    /// The same with the paper's literal set of holes, to which indoor cells belong.
    pub recall_with_indoor: Option<Interval>,
    /// Mean chance that the predicted cells are holes: precision, if labels are not taken for sure. Over
    /// the maps that tell errors; absent if none does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected_precision: Option<Interval>,
    /// Share of the predicted cells that are holes with a chance of at least 95 %.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sure_holes: Option<Interval>,
    /// Share of the predicted cells that are holes with a chance of at least 95 % or at most 5 %: those
    /// that `sure_holes` is about. Who flies into unsure cells loses both.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sure: Option<Interval>,
}

/// How a method flies, added up over all maps and starts, with as many steps as there are.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FlightFigures {
    /// The method.
    pub method: Method,
    /// Flights that ended on a hole after 0, 1, 2 ... steps.
    pub found_after: Vec<u64>,
    /// Flights that did not.
    pub not_found: u64,
    /// Mean steps of those that did.
    pub mean_hops: Option<f64>,
    /// Waypoints that were predicted.
    pub predictions: u64,
    /// Of these, waypoints that were not permissible.
    pub blocked: u64,
    /// Mean length of a flight, in metres.
    pub mean_flight_m: f64,
}

/// Precision as a share of the oracle's at the same number of steps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OracleShare {
    /// The method.
    pub method: Method,
    /// Steps (k).
    pub k: u32,
    /// The ratio of the means.
    pub precision: Option<Interval>,
}

/// One method minus another, paired over maps, with all starts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Difference {
    /// The one.
    pub a: Method,
    /// The other.
    pub b: Method,
    /// Steps (k) of those that move.
    pub k: u32,
    /// Difference of precisions.
    pub precision: Option<Interval>,
    /// Difference of recalls.
    pub recall: Option<Interval>,
    /// Difference of expected precisions; absent if no map tells errors.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected_precision: Option<Interval>,
}

/// What maps of a group have in common.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GroupKind {
    /// How many of their outdoor cells are holes.
    HoleShare,
    /// How many of their cells are occupied.
    BuiltShare,
    /// The mean height of their occupied cells.
    Height,
    /// The mean footprint that an occupied cell belongs to: houses, blocks or halls.
    Footprint,
    /// Where they are: tiles less than 10 km from the next.
    Region,
}

/// Scores of a part of the maps, with all starts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Group {
    /// What its maps have in common.
    pub kind: GroupKind,
    /// Its name.
    pub name: String,
    /// Number of maps.
    pub maps: u64,
    /// Mean share of outdoor cells that are holes.
    pub hole_share: f64,
    /// The scores.
    pub scores: Vec<GroupScore>,
}

/// A score within a group.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GroupScore {
    /// The method.
    pub method: Method,
    /// Steps (k).
    pub k: u32,
    /// As in [`Score`].
    pub precision: Option<Interval>,
    /// As in [`Score`].
    pub recall: Option<Interval>,
}

/// How hard the maps are: outdoor cells by the least number of steps to a hole.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Difficulty {
    /// Cells that are 0, 1, 2 ... steps away.
    pub cells_by_hops: Vec<u64>,
    /// Cells from which no hole can be reached.
    pub unreachable: u64,
}

/// Outdoor cells at some distance from the nearest wall.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DistanceFigures {
    /// Their centres are at least this far from the wall, in metres.
    pub from_m: f64,
    /// They are nearer than this; absent for the last ones.
    pub to_m: Option<f64>,
    /// Outdoor cells of all maps that have a building.
    pub cells: u64,
    /// Of these, holes.
    pub holes: u64,
    /// Holes as a share of the cells.
    pub hole_share: Option<Interval>,
    /// Mean chance to be a hole, of the maps that tell errors; absent if none does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected_hole_share: Option<Interval>,
}

/// What the best cell by one half of the repeats is worth by the other half: no method can find more
/// that knows a map as well as half of its repeats do. From the starts of the random walk, both halves
/// choosing in turn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CeilingScore {
    /// Steps (k).
    pub k: u32,
    /// Share of the chosen cells that are holes by the other half's mean.
    pub precision: Option<Interval>,
    /// Mean chance by the other half that they are holes.
    pub expected_precision: Option<Interval>,
}

/// How sure the holes are, of the maps that tell errors, at `rl.hole_threshold_dbm`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LabelFigures {
    /// Maps that tell errors.
    pub maps: u64,
    /// Least and most repeats.
    pub repeats: [u32; 2],
    /// Their outdoor cells.
    pub outdoor_cells: u64,
    /// Cells that are holes with a chance of at least 95 %.
    pub sure_holes: u64,
    /// Cells that are holes with a chance of more than 5 % and less than 95 %.
    pub unsure: u64,
    /// Mean chance of a cell to be a hole.
    pub expected_hole_share: Option<Interval>,
    /// The label ceiling; empty if no map tells what half of its repeats gave.
    pub ceiling: Vec<CeilingScore>,
}

/// The report of an evaluation.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct Report {
    /// Always `report.v1`.
    #[schemars(extend("const" = "report.v1"))]
    pub schema: String,
    /// SHA-256 over everything that the report depends on.
    pub fingerprint: String,
    /// The program.
    pub software: Software,
    /// The dataset.
    pub dataset: DatasetUsed,
    /// SHA-256 of the weights of the method `agent`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub policy_sha256: Option<String>,
    /// `train`, `val`, `test` or `all`.
    pub split: String,
    /// The task.
    pub rl: RlConfig,
    /// How it was judged.
    pub evaluate: EvaluateConfig,
    /// The maps.
    pub maps: MapsUsed,
    /// The methods.
    pub methods: Vec<MethodInfo>,
    /// Precision and recall against starts.
    pub scores: Vec<Score>,
    /// How they fly.
    pub flights: Vec<FlightFigures>,
    /// Precision relative to the oracle; empty if the oracle was not evaluated.
    pub oracle_share: Vec<OracleShare>,
    /// Each pair of methods once.
    pub differences: Vec<Difference>,
    /// By share of holes, density and height of buildings, and region.
    pub groups: Vec<Group>,
    /// Holes by their distance to the nearest wall.
    pub distances: Vec<DistanceFigures>,
    /// How sure the holes are; `null` if that is unknown, since no map tells errors.
    pub labels: Option<LabelFigures>,
    /// How hard the maps are.
    pub difficulty: Difficulty,
}

impl Report {
    /// The value of `schema`.
    pub const SCHEMA: &'static str = "report.v1";

    /// The score of a method with all starts.
    #[must_use]
    pub fn score(&self, method: Method, k: u32) -> Option<&Score> {
        let starts = self.evaluate.starts;
        self.scores
            .iter()
            .find(|score| (score.method, score.k, score.starts) == (method, k, starts))
    }
}
