//! Judging policies: precision and recall as the paper defines them, with the certainty that it
//! lacks, and a report to look at.
//!
//! All methods start on the same maps, predict through the same trait and move by the same rules.
//! Each map is evaluated by itself (`map`); a bootstrap over maps then gives means with
//! intervals, paired differences and groups (`summary`).

mod bootstrap;
mod buildings;
mod chart;
mod distance;
mod figures;
mod fitted;
mod gallery;
mod groups;
mod labels;
mod map;
mod methods;
mod page;
mod report;
mod stage;
mod summary;
mod tables;
mod track;

pub(crate) use chart::{LineChart, Point, Series, svg_to_png};
pub(crate) use distance::{DistanceCount, by_distance};
pub use fitted::FitError;
pub use report::{
    CeilingScore, DatasetUsed, Difference, Difficulty, DistanceFigures, FlightFigures, Group,
    GroupKind, GroupScore, Interval, Knows, LabelFigures, MapsUsed, MethodInfo, OracleShare,
    Report, Score,
};
pub use stage::{EvaluateError, EvaluateJob, evaluate, precision};
pub(crate) use tables::derived_tables;
