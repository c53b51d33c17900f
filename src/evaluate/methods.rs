//! The methods by name: what they are told, where they start, which policy moves them.

use super::fitted::Fitted;
use super::report::{Knows, MethodInfo};
use super::track::Airspace;
use crate::config::{Config, EvaluateConfig, Method};
use crate::rl::policy::{
    Descent, DescentStyle, MakePolicy, OptimalWay, Policy, RandomWalk, ShadowSeeker, WallWalk,
};
use crate::rl::{Cell, Hops, Random, Sight, World, neighbourhood};

/// Streams of random numbers beside those of the methods.
const STARTS: u64 = 1;
const NEIGHBOURHOOD_STARTS: u64 = 2;

const FITTED_TREES: &str = "boosted trees, fitted on the train split,";

/// Whether a method moves.
pub(super) fn moves(method: Method) -> bool {
    !matches!(method, Method::RandomSampling | Method::Neighbourhood(_))
}

/// Steps after which a method is judged, of those configured: one that does not move is judged
/// where it starts.
pub(super) fn steps(method: Method, config: &EvaluateConfig) -> &[u32] {
    if moves(method) { &config.steps } else { &[0] }
}

/// What a report says about a method.
pub(super) fn info(method: Method, config: &EvaluateConfig) -> MethodInfo {
    let rate = config.gradient_rate;
    let smoothing = match config.gradient_smoothing_cells {
        0.0 => String::new(),
        cells => format!(" smoothed over {cells} cells"),
    };
    let descent = |positions: &str| {
        format!("Gradient descent of the coverage map{smoothing} at rate {rate}, {positions}.")
    };
    let (on_grid, between) =
        ("rounded to grid positions", "carrying what rounding leaves over to the next step");
    let bounded = |metres: u16, positions: &str| {
        let descent = descent(positions);
        format!("{descent} Starts and stays within {metres} m of a wall.")
    };
    let (title, knows, description) = match method {
        Method::RandomSampling => {
            ("RSP".into(), Knows::Nothing, "Random outdoor cells.".to_owned())
        }
        Method::Neighbourhood(metres) => (
            format!("BNP {metres} m"),
            Knows::Buildings,
            format!("Random outdoor cells within {metres} m of a wall."),
        ),
        Method::Gradient => ("G-RSP".into(), Knows::CoverageMap, descent(on_grid)),
        Method::GradientContinuous => {
            ("G-RSP, continuous".into(), Knows::CoverageMap, descent(between))
        }
        Method::BoundedGradient(metres) => {
            (format!("G-BNP {metres} m"), Knows::CoverageMap, bounded(metres, on_grid))
        }
        Method::BoundedGradientContinuous(metres) => {
            (format!("G-BNP {metres} m, continuous"), Knows::CoverageMap, bounded(metres, between))
        }
        Method::Shadow => (
            "Building shadow".into(),
            Knows::BaseStation,
            "To the nearest cell that a building hides from the base station.".to_owned(),
        ),
        Method::RandomWalk => (
            "Random walk".into(),
            Knows::Buildings,
            "To a permissible cell at random: a control.".to_owned(),
        ),
        Method::WallWalk => (
            "Wall walk".into(),
            Knows::Buildings,
            "To a permissible cell beside a wall at random: a control.".to_owned(),
        ),
        Method::Oracle => (
            "Oracle".into(),
            Knows::Holes,
            "A shortest way to a hole: no method can be better.".to_owned(),
        ),
        Method::Trees => (
            "Boosted trees".into(),
            Knows::Measurements,
            format!("To where {FITTED_TREES} find a hole most likely: no network, no planning."),
        ),
        Method::TreesToldBs => (
            "Boosted trees, told the base station".into(),
            Knows::BaseStation,
            format!("The same {FITTED_TREES}, told where the base station is: a ceiling."),
        ),
        Method::LeaveOneOut => (
            "All but one".into(),
            Knows::CoverageMap,
            "To where the levels around a cell, but not its own, make a hole most likely, as \
             learned from the train split: a ceiling for interpolation."
                .to_owned(),
        ),
        Method::Belief => (
            "Belief".into(),
            Knows::Measurements,
            "To where a hole is most likely by what the measurements say of the base station's place: \
             candidates weighed by Bayes' rule with a model of propagation that was fitted on the train \
             split; no network, no planning."
                .to_owned(),
        ),
        Method::Agent => (
            "Agent".into(),
            Knows::Measurements,
            "A trained Q-network, told its measurements and the building map.".to_owned(),
        ),
        Method::Predictor => (
            "Predictor".into(),
            Knows::Measurements,
            "To where the agent's network finds a hole most likely: no planning.".to_owned(),
        ),
    };
    MethodInfo { name: method, title, description, knows, multi_step: moves(method) }
}

/// What is the same on all maps.
#[derive(Debug, Clone, Copy)]
pub(super) struct Flying<'a> {
    pub(super) sight: &'a Sight,
    pub(super) config: &'a Config,
    /// What flies the method `agent`.
    pub(super) agent: Option<&'a dyn MakePolicy>,
    /// What was learned for the methods that learn.
    pub(super) fitted: &'a Fitted,
}

/// Where a method starts: for all but the neighbourhood methods the same random outdoor cells.
/// BNP draws from the walls of the stored map, among cells that are really outdoors.
pub(super) fn starts(method: Method, place: Airspace<'_>, config: &EvaluateConfig) -> Vec<Cell> {
    let Airspace { truth, known, .. } = place;
    let (stream, cells) = match method {
        Method::Neighbourhood(metres)
        | Method::BoundedGradient(metres)
        | Method::BoundedGradientContinuous(metres) => {
            let stream = [NEIGHBOURHOOD_STARTS, metres.into()];
            (stream, neighbourhood(known, metres.into()))
        }
        _ => ([STARTS, 0], truth.free_cells()),
    };
    let outdoors: Vec<Cell> = cells.into_iter().filter(|&cell| truth.is_outdoors(cell)).collect();
    let key = [&[config.seed][..], &truth.key(), &stream].concat();
    Random::keyed(&key).sample(&outdoors, config.starts as usize)
}

/// The policy that moves a method on a map; one that does not move never asks for a waypoint.
pub(super) fn policy<'a>(
    method: Method,
    known: &World,
    hops: impl FnOnce() -> &'a Hops,
    flying: Flying<'a>,
) -> Box<dyn Policy + 'a> {
    let Flying { config, agent, fitted, .. } = flying;
    let config = &config.evaluate;
    let style = |keep_fraction| DescentStyle {
        rate: config.gradient_rate,
        smoothing_cells: config.gradient_smoothing_cells,
        keep_fraction,
    };
    let bounded = |metres: u16, keep_fraction| {
        let within = neighbourhood(known, metres.into());
        Descent::new(known, style(keep_fraction), Some(&within))
    };
    match method {
        Method::Gradient => Box::new(Descent::new(known, style(false), None)),
        Method::GradientContinuous => Box::new(Descent::new(known, style(true), None)),
        Method::BoundedGradient(metres) => Box::new(bounded(metres, false)),
        Method::BoundedGradientContinuous(metres) => Box::new(bounded(metres, true)),
        Method::Shadow => Box::new(ShadowSeeker::new(known)),
        Method::RandomSampling | Method::Neighbourhood(_) | Method::RandomWalk => {
            Box::new(RandomWalk)
        }
        Method::WallWalk => Box::new(WallWalk::new(known)),
        Method::Oracle => Box::new(OptimalWay::new(hops())),
        Method::Trees | Method::TreesToldBs | Method::LeaveOneOut | Method::Belief => {
            fitted.policy(method, known)
        }
        Method::Agent => agent.expect("checked before anything flies").policy(known),
        Method::Predictor => {
            let predictor = agent.and_then(MakePolicy::predictor);
            predictor.expect("checked before anything flies").policy(known)
        }
    }
}

/// Keys the random numbers of a method on a map.
pub(super) fn key(method: Method, place: Airspace<'_>, config: &EvaluateConfig) -> Vec<u64> {
    let name = method.to_string();
    let name = name.bytes().map(u64::from);
    [config.seed].into_iter().chain(place.truth.key()).chain(name).collect()
}
