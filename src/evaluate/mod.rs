//! Judging policies: precision and recall as the paper defines them, with the certainty that it
//! lacks, and a report to look at.
//!
//! All methods start on the same maps, predict through the same trait and move by the same rules.
//! Each map is evaluated by itself (`map`); a bootstrap over maps then gives means with
//! intervals, paired differences and groups (`summary`).

mod bootstrap;
mod chart;
mod figures;
mod gallery;
mod groups;
mod map;
mod methods;
mod page;
mod report;
mod stage;
mod summary;
mod tables;
mod track;

pub(crate) use chart::{LineChart, Point, Series, svg_to_png};
pub use report::{
    DatasetUsed, Difference, Difficulty, FlightFigures, Group, GroupKind, GroupScore, Interval,
    Knows, MapsUsed, MethodInfo, OracleShare, Report, Score,
};
pub use stage::{EvaluateError, EvaluateJob, evaluate, precision};
