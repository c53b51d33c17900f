//! `holescout evaluate`: a dataset in, a report out.

use std::path::Path;

use rayon::prelude::*;

use super::bootstrap::Bootstrap;
use super::chart::svg_to_png;
use super::fitted::{FitError, Fitted};
use super::gallery;
use super::groups::overlapping_pairs;
use super::labels::Labels;
use super::map::{self, MapResult, MethodOnMap, Scene};
use super::methods::Flying;
use super::report::{DatasetUsed, MapsUsed, Report};
use super::summary::Results;
use super::{figures, methods, page, tables};
use crate::config::{Config, Method, Split};
use crate::dataset::{Dataset, ReadError};
use crate::error::{Fault, FileError, HasFault};
use crate::grid::TileId;
use crate::manifest::{EvaluationManifest, Manifest, Software, fingerprint, to_json};
use crate::progress::Progress;
use crate::rl::policy::MakePolicy;
use crate::rl::{PoolError, Sight, World};
use crate::store::{Build, OutputError};

/// Pixels of a chart's PNG for one unit of its SVG.
const PNG_SCALE: f32 = 2.0;

/// Why an evaluation could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvaluateError {
    /// The dataset cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The output directory cannot be used.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The method `agent` is asked for, but there is none.
    #[error(
        "evaluate.methods has \"agent\", but no policy was given: pass --policy, or leave it out"
    )]
    NoAgent,
    /// The method `predictor` is asked for, but the policy predicts no holes.
    #[error(
        "evaluate.methods has \"predictor\", but the policy has no head that predicts holes: give one \
         that was trained with train.hole_prediction above 0, or leave it out"
    )]
    NoPredictor,
    /// Methods that learn cannot. Nothing was written.
    #[error(
        "{learning} learn from the train split of {dataset}: {source}. Leave them out: --methods {others}"
    )]
    Fit {
        /// The methods that learn.
        learning: String,
        /// The dataset's directory.
        dataset: String,
        /// What stands in the way.
        source: Box<FitError>,
        /// The other methods that were asked for.
        others: String,
    },
    /// The split has no records.
    #[error("the {split} split of {dataset} has no records; those that have: {others}")]
    EmptySplit {
        /// What was asked for.
        split: String,
        /// The dataset's directory.
        dataset: String,
        /// Splits that have records.
        others: String,
    },
}

impl HasFault for EvaluateError {
    fn fault(&self) -> Fault {
        match self {
            Self::Read(error) => error.fault(),
            Self::Output(error) => error.fault(),
            Self::NoAgent | Self::NoPredictor | Self::Fit { .. } | Self::EmptySplit { .. } => {
                Fault::Input
            }
        }
    }
}

impl From<FileError> for EvaluateError {
    fn from(error: FileError) -> Self {
        Self::Output(error.into())
    }
}

/// What to evaluate and where to.
#[derive(Debug, Clone, Copy)]
pub struct EvaluateJob<'a> {
    /// A dataset.
    pub dataset: &'a Path,
    /// What flies the method `agent`, and the SHA-256 of its weights.
    pub agent: Option<(&'a dyn MakePolicy, &'a str)>,
    /// Its split; all of them if `None`.
    pub split: Option<Split>,
    /// The configuration; `[rl]` and `[evaluate]` are used.
    pub config: &'a Config,
    /// The directory to fill.
    pub out: &'a Path,
    /// Replace an evaluation of other inputs that is there.
    pub overwrite: bool,
}

/// Evaluates all methods on a split of a dataset, and returns the report that was written.
///
/// The same inputs give the same bytes at any number of threads.
///
/// # Errors
/// [`EvaluateError`]; nothing is left under a final name then.
pub fn evaluate(job: EvaluateJob<'_>, progress: &dyn Progress) -> Result<Report, EvaluateError> {
    let dataset = Dataset::open_with(job.dataset, &job.config.remote)?;
    let records = records(&dataset, job)?;
    let config = job.config;
    let split = job.split.map_or("all", Split::name).to_owned();
    if config.evaluate.methods.contains(&Method::Agent) && job.agent.is_none() {
        return Err(EvaluateError::NoAgent);
    }
    let predictor = job.agent.and_then(|(agent, _)| agent.predictor());
    if config.evaluate.methods.contains(&Method::Predictor) && predictor.is_none() {
        return Err(EvaluateError::NoPredictor);
    }
    let policy_sha256 = job.agent.map(|(_, sha256)| sha256.to_owned());
    let inputs = (dataset.digest(), &policy_sha256, &split);
    let fingerprint = fingerprint(&("evaluate", inputs, &config.rl, &config.evaluate));
    let build = Build::open_whole(job.out, "evaluation", &fingerprint, job.overwrite)?;
    let fitted = fit(&dataset, job, progress)?;
    let output = build.begin()?;

    let sight = Sight::new(config.rl.reach_cells);
    let agent = job.agent.map(|(agent, _)| agent);
    let flying = Flying { sight: &sight, config, agent, fitted: &fitted };
    let scene = |id| -> Result<Scene, ReadError> {
        let (record, grids) = dataset.record_with_grids(id)?;
        let world = World::new(&record, &grids, &config.rl);
        let labels = Labels::new(&world, &record, &grids, &config.rl);
        Ok(Scene::new(world, labels, &config.evaluate))
    };
    progress.begin("flying", Some(records.len() as u64));
    let maps = records.par_iter().map(|&(id, _)| {
        let result = map::evaluate(&scene(id)?, flying);
        progress.advance(1);
        Ok(result)
    });
    let maps: Vec<MapResult> = maps.collect::<Result<_, ReadError>>()?;
    progress.end();

    progress.begin("resampling", None);
    let ids: Vec<TileId> = records.iter().map(|(id, _)| *id).collect();
    let report = Report {
        schema: Report::SCHEMA.to_owned(),
        fingerprint,
        software: Software::this(),
        dataset: DatasetUsed::of(&dataset),
        policy_sha256,
        split,
        rl: config.rl.clone(),
        evaluate: config.evaluate.clone(),
        maps: maps_used(&ids, &maps, &dataset),
        ..summarise(&ids, &maps, config)
    };
    progress.end();

    progress.begin("drawing", None);
    let gallery = gallery::choose(&maps, config.evaluate.gallery_maps)
        .into_par_iter()
        .map(|at| {
            let (id, split) = records[at];
            Ok(gallery::show(&scene(id)?, split, &maps[at], flying))
        })
        .collect::<Result<Vec<_>, ReadError>>()?;
    let charts = figures::of_report(&report).map(|(name, chart)| (name, chart.to_svg()));
    let distance = ("distance", figures::of_distances(&report).to_svg());
    for (name, svg) in charts.iter().chain([&distance]) {
        output.write(&format!("{name}.svg"), svg.as_bytes())?;
        output.write(&format!("{name}.png"), &svg_to_png(svg, PNG_SCALE))?;
    }
    let page = page::render(&report, &charts, &distance.1, &gallery);
    output.write("report.html", page.as_bytes())?;
    progress.end();

    output.write("report.json", &to_json(&report))?;
    for (name, table) in tables::derived_tables(&report) {
        output.write(name, &table)?;
    }
    output.write("maps.csv", &tables::maps(&ids, &maps, &config.evaluate))?;
    output.write("NOTICE", notice(&report).as_bytes())?;
    output.complete(&to_json(&EvaluationManifest {
        schema: EvaluationManifest::SCHEMA.to_owned(),
        fingerprint: report.fingerprint.clone(),
        software: Software::this(),
        dataset: dataset.digest().clone(),
        policy_sha256: report.policy_sha256.clone(),
        split: report.split.clone(),
        rl: config.rl.clone(),
        evaluate: config.evaluate.clone(),
    }))?;
    Ok(report)
}

/// The records of the wanted splits, by name.
fn records(dataset: &Dataset, job: EvaluateJob<'_>) -> Result<Vec<(TileId, Split)>, EvaluateError> {
    let mut records = dataset.ids();
    records.retain(|(_, split)| job.split.is_none_or(|wanted| wanted == *split));
    if records.is_empty() {
        let manifest = dataset.manifest();
        let others: Vec<&str> = manifest.statistics.keys().map(|split| split.name()).collect();
        return Err(EvaluateError::EmptySplit {
            split: job.split.map_or("whole", Split::name).to_owned(),
            dataset: job.dataset.display().to_string(),
            others: if others.is_empty() { "none".to_owned() } else { others.join(", ") },
        });
    }
    Ok(records)
}

/// What the methods that learn have learned.
fn fit(
    dataset: &Dataset,
    job: EvaluateJob<'_>,
    progress: &dyn Progress,
) -> Result<Fitted, EvaluateError> {
    Fitted::fit(dataset, job.config, progress).map_err(|error| match error {
        FitError::Maps(PoolError::Read(error)) => error.into(),
        source => {
            let methods = &job.config.evaluate.methods;
            let (learning, others): (Vec<Method>, Vec<Method>) =
                methods.iter().partition(|method| method.learns());
            let list = |methods: Vec<Method>, between: &str| {
                methods.iter().map(ToString::to_string).collect::<Vec<_>>().join(between)
            };
            EvaluateError::Fit {
                learning: list(learning, ", "),
                dataset: job.dataset.display().to_string(),
                source: Box::new(source),
                others: list(others, ","),
            }
        }
    })
}

fn maps_used(ids: &[TileId], maps: &[MapResult], dataset: &Dataset) -> MapsUsed {
    let manifest = dataset.manifest();
    let count = |holds: fn(&MapResult) -> bool| maps.iter().filter(|map| holds(map)).count() as u64;
    MapsUsed {
        evaluated: maps.len() as u64,
        without_holes: count(|map| map.hole_cells == 0),
        without_starts: count(|map| map.outdoor_cells == 0),
        overlapping_pairs: overlapping_pairs(ids, f64::from(manifest.cells) * manifest.cell_m),
        outdoor_cells: maps.iter().map(|map| map.outdoor_cells).sum(),
        hole_cells: maps.iter().map(|map| map.hole_cells).sum(),
    }
}

fn notice(report: &Report) -> String {
    let DatasetUsed { attribution, licences, .. } = &report.dataset;
    format!(
        "This evaluation shows building heights of a dataset that contains information from\n\
         {}, made available under {}.\n\
         Keep this notice with report.html and everything made from it.\n",
        attribution.join(", "),
        licences.join(", "),
    )
}

/// The figures of a report; what it was made from is left empty.
fn summarise(ids: &[TileId], maps: &[MapResult], config: &Config) -> Report {
    let evaluate = &config.evaluate;
    let results = Results { config: evaluate, ids, maps };
    let bootstrap = Bootstrap::new(maps.len(), evaluate.bootstrap, evaluate.seed);
    Report {
        methods: evaluate.methods.iter().map(|&method| methods::info(method, evaluate)).collect(),
        scores: results.scores(&bootstrap),
        flights: results.flights(),
        oracle_share: results.oracle_share(&bootstrap),
        differences: results.differences(&bootstrap),
        groups: results.groups(),
        distances: results.distances(&bootstrap),
        labels: results.labels(&bootstrap),
        difficulty: results.difficulty(),
        ..Report::default()
    }
}

/// Precision of a policy after each of the configured steps, from the configured starts: a value for
/// each of the steps, of each map that has starts. What training chooses its best checkpoint by.
#[must_use]
pub fn precision(
    agent: &dyn MakePolicy,
    maps: &[std::sync::Arc<World>],
    config: &Config,
) -> Vec<Vec<f64>> {
    let sight = Sight::new(config.rl.reach_cells);
    let flying = Flying { sight: &sight, config, agent: Some(agent), fitted: &Fitted::default() };
    let scene = |map: &World| Scene::new(map.clone(), None, &config.evaluate);
    let results: Vec<MethodOnMap> =
        maps.par_iter().map(|map| scene(map).judged(Method::Agent, flying)).collect();
    let of_map = |map: MethodOnMap| -> Option<Vec<f64>> {
        map.scores.iter().map(|scores| scores.last()?.precision).collect()
    };
    results.into_iter().filter_map(of_map).collect()
}
