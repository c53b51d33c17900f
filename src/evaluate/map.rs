//! One map: all methods fly over it, and their predictions are counted.

use std::sync::OnceLock;

use super::buildings::{Buildings, buildings};
use super::distance::{DistanceCount, FROM_M, by_distance};
use super::labels::{Labels, LabelsOnMap, is_sure, is_sure_hole};
use super::methods::{self, Flying};
use super::report::Difficulty;
use super::track::{Airspace, Track, fly};
use crate::config::{EvaluateConfig, Method};
use crate::rl::{Cell, Hops, Random, Sight, World};

const NOISE: u64 = 3;
const STALE: u64 = 4;

/// A map with the copy of it that the UAV has stored.
#[derive(Debug)]
pub(super) struct Scene {
    pub(super) truth: World,
    /// How sure its holes are, if the map tells.
    labels: Option<Labels>,
    /// Where it differs from the truth.
    stored: Option<World>,
    /// Least steps to a hole, once somebody asks.
    hops: OnceLock<Hops>,
}

impl Scene {
    pub(super) fn new(truth: World, labels: Option<Labels>, config: &EvaluateConfig) -> Self {
        let random = |what| Random::keyed(&[&[config.seed][..], &truth.key(), &[what]].concat());
        let stale = (config.stale_share > 0.0)
            .then(|| truth.with_stale_buildings(config.stale_share, &mut random(STALE)));
        let stored = if config.noise_db > 0.0 {
            let stale = stale.as_ref().unwrap_or(&truth);
            Some(stale.with_noise(config.noise_db, &mut random(NOISE)))
        } else {
            stale
        };
        Self { truth, labels, stored, hops: OnceLock::new() }
    }

    /// What a method flies in: the oracle knows the truth, and measures without error.
    fn place<'a>(&'a self, method: Method, sight: &'a Sight) -> Airspace<'a> {
        let truth = &self.truth;
        let stored = self.stored.as_ref().filter(|_| method != Method::Oracle);
        Airspace { truth, known: stored.unwrap_or(truth), sight }
    }

    fn hops(&self, sight: &Sight) -> &Hops {
        self.hops.get_or_init(|| Hops::new(&self.truth, sight))
    }

    /// The first flights of a method, `most_starts` at most.
    pub(super) fn tracks(
        &self,
        method: Method,
        flying: Flying<'_>,
        most_starts: usize,
    ) -> Vec<Track> {
        let Flying { sight, config, .. } = flying;
        let place = self.place(method, sight);
        let mut starts = methods::starts(method, place, &config.evaluate);
        starts.truncate(most_starts);
        let key = methods::key(method, place, &config.evaluate);
        let most = methods::steps(method, &config.evaluate).last().copied().unwrap_or(0);
        let hops = || self.hops(sight);
        let policy = methods::policy(method, place.known, hops, flying);
        fly(place, &*policy, &starts, most, &key)
    }

    /// What a method comes to.
    pub(super) fn judged(&self, method: Method, flying: Flying<'_>) -> MethodOnMap {
        let config = &flying.config.evaluate;
        let tracks = self.tracks(method, flying, config.starts as usize);
        let truth = Truth { world: &self.truth, labels: self.labels.as_ref() };
        judge(truth, &tracks, methods::steps(method, config), config)
    }
}

/// Precision and recall on one map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MapScore {
    pub(super) precision: Option<f64>,
    pub(super) recall: Option<f64>,
    pub(super) recall_with_indoor: Option<f64>,
    /// Mean chance that a predicted cell is a hole; none of the three without errors.
    pub(super) expected: Option<f64>,
    /// Share of predicted cells that surely are holes.
    pub(super) sure_holes: Option<f64>,
    /// Share of predicted cells that surely are holes, or surely none.
    pub(super) sure: Option<f64>,
}

/// What predictions are held against.
#[derive(Debug, Clone, Copy)]
struct Truth<'a> {
    world: &'a World,
    labels: Option<&'a Labels>,
}

/// What a method came to on one map.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MethodOnMap {
    /// For each k and, within it, each number of starts.
    pub(super) scores: Vec<Vec<MapScore>>,
    /// Flights that ended on a hole, by steps.
    pub(super) found_after: Vec<u64>,
    pub(super) not_found: u64,
    pub(super) predictions: u64,
    pub(super) blocked: u64,
    pub(super) metres: f64,
}

/// What all methods came to on one map.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct MapResult {
    pub(super) outdoor_cells: u64,
    pub(super) hole_cells: u64,
    pub(super) buildings: Buildings,
    /// Outdoor cells and holes by distance to the nearest wall.
    pub(super) distances: Vec<DistanceCount>,
    /// How sure its holes are, if the map tells.
    pub(super) labels: Option<LabelsOnMap>,
    pub(super) difficulty: Difficulty,
    /// In the order of the configuration.
    pub(super) methods: Vec<MethodOnMap>,
}

impl MapResult {
    /// Share of outdoor cells that are holes.
    pub(super) fn hole_share(&self) -> f64 {
        self.hole_cells as f64 / self.outdoor_cells.max(1) as f64
    }
}

/// Numbers of starts at which a method is judged: 1, 2, 5, 10, 20 ... and all.
pub(super) fn counts(starts: u32) -> Vec<u32> {
    let decades = (0..).map(|power| 10_u32.pow(power)).take_while(|&ten| ten < starts);
    let below = decades.flat_map(|ten| [ten, 2 * ten, 5 * ten]).filter(|&count| count < starts);
    below.chain([starts]).collect()
}

/// Evaluates all methods on a map.
pub(super) fn evaluate(scene: &Scene, flying: Flying<'_>) -> MapResult {
    let Flying { sight, config, .. } = flying;
    let truth = &scene.truth;
    let outdoors: Vec<Cell> =
        truth.free_cells().into_iter().filter(|&cell| truth.is_outdoors(cell)).collect();
    let methods = config.evaluate.methods.iter().map(|&method| scene.judged(method, flying));
    let labels = scene.labels.as_ref();
    let chance = labels.map(|labels| |cell: Cell| labels.chance(truth.index(cell)));
    let on_map = labels.map(|labels| {
        // From the starts of all methods that start anywhere.
        let place = scene.place(Method::Oracle, sight);
        let starts = methods::starts(Method::Oracle, place, &config.evaluate);
        labels.on_map(truth, sight, &outdoors, &starts, &config.evaluate.steps)
    });
    MapResult {
        outdoor_cells: outdoors.len() as u64,
        hole_cells: truth.hole_cells() as u64,
        buildings: buildings(truth),
        distances: by_distance(truth, &outdoors, &FROM_M, chance.as_ref().map(|it| it as _)),
        labels: on_map,
        difficulty: difficulty(scene.hops(sight), &outdoors),
        methods: methods.collect(),
    }
}

fn difficulty(hops: &Hops, outdoors: &[Cell]) -> Difficulty {
    let mut difficulty = Difficulty::default();
    for &cell in outdoors {
        match hops.from(cell) {
            Some(hops) => count(&mut difficulty.cells_by_hops, hops.into()),
            None => difficulty.unreachable += 1,
        }
    }
    difficulty
}

/// One more in a histogram.
fn count(counts: &mut Vec<u64>, at: usize) {
    if counts.len() <= at {
        counts.resize(at + 1, 0);
    }
    counts[at] += 1;
}

fn judge(
    truth: Truth<'_>,
    tracks: &[Track],
    steps: &[u32],
    config: &EvaluateConfig,
) -> MethodOnMap {
    let mut result = MethodOnMap {
        scores: steps.iter().map(|&k| scores(truth, tracks, k, config.starts)).collect(),
        found_after: Vec::new(),
        not_found: 0,
        predictions: tracks.iter().map(|track| track.steps() as u64).sum(),
        blocked: tracks.iter().map(|track| track.blocked).sum(),
        metres: tracks.iter().map(Track::length).sum::<f64>() * truth.world.cell_m(),
    };
    for track in tracks {
        if truth.world.is_hole(track.cell_after(u32::MAX)) {
            count(&mut result.found_after, track.steps());
        } else {
            result.not_found += 1;
        }
    }
    result
}

/// Precision and recall, as the paper's section "Evaluation Metric" defines them, of the
/// predictions after at most k steps from the first 1, 2, 5 ... starts.
fn scores(truth: Truth<'_>, tracks: &[Track], k: u32, starts: u32) -> Vec<MapScore> {
    let Truth { world: truth, labels } = truth;
    let holes = truth.hole_cells();
    let share = |part: usize, whole: usize| (whole > 0).then(|| part as f64 / whole as f64);
    let mut seen = vec![false; truth.cells() * truth.cells()];
    let (mut done, mut hits, mut unique) = (0, 0, 0);
    let (mut chances, mut sure_holes, mut sure) = (0.0, 0, 0);
    let counts = counts(starts);
    counts
        .into_iter()
        .map(|count| {
            let available = tracks.len().min(count as usize);
            for track in &tracks[done..available] {
                let cell = track.cell_after(k);
                if let Some(labels) = labels {
                    let chance = labels.chance(truth.index(cell));
                    chances += chance;
                    sure_holes += usize::from(is_sure_hole(chance));
                    sure += usize::from(is_sure(chance));
                }
                if truth.is_hole(cell) {
                    hits += 1;
                    unique += usize::from(!std::mem::replace(&mut seen[truth.index(cell)], true));
                }
            }
            done = available;
            MapScore {
                precision: share(hits, done),
                // Without a prediction nothing can be said about finding holes either.
                recall: share(unique, holes).filter(|_| done > 0),
                recall_with_indoor: share(unique, truth.weak_cells()).filter(|_| done > 0),
                expected: labels.filter(|_| done > 0).map(|_| chances / done as f64),
                sure_holes: labels.and_then(|_| share(sure_holes, done)),
                sure: labels.and_then(|_| share(sure, done)),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::drawn_world as world;
    use proptest::prelude::*;

    const NO_ERRORS: MapScore = MapScore {
        precision: None,
        recall: None,
        recall_with_indoor: None,
        expected: None,
        sure_holes: None,
        sure: None,
    };

    fn track(cells: &[(i32, i32)]) -> Track {
        let path = cells.iter().map(|&(row, column)| Cell::new(row, column)).collect();
        Track { predicted: vec![], rsrp_dbm: vec![], blocked: 0, path }
    }

    #[test]
    fn counts_rise_to_all_starts() {
        assert_eq!(counts(200), [1, 2, 5, 10, 20, 50, 100, 200]);
        assert_eq!(counts(1), [1]);
        assert_eq!(counts(30), [1, 2, 5, 10, 20, 30]);
    }

    /// Four holes and a building; five flights, of which two end on the same hole.
    #[test]
    fn precision_and_recall_by_hand() {
        let truth = world("oo.\n.#.\noo.", 2);
        let truth = Truth { world: &truth, labels: None };
        let tracks = [
            track(&[(0, 2), (0, 0)]),
            track(&[(1, 0), (0, 0)]),
            track(&[(2, 2)]),
            track(&[(2, 0)]),
            track(&[(1, 2), (0, 2), (2, 1)]),
        ];
        let at = |k| {
            let all = scores(truth, &tracks, k, 5);
            *all.last().expect("all starts")
        };
        let score = |precision, recall, with_indoor| MapScore {
            precision: Some(precision),
            recall: Some(recall),
            recall_with_indoor: Some(with_indoor),
            ..NO_ERRORS
        };
        assert_eq!(at(0), score(0.2, 0.25, 0.2));
        assert_eq!(at(1), score(0.6, 0.5, 0.4));
        assert_eq!(at(8), score(0.8, 0.75, 0.6));
        assert_eq!(scores(truth, &tracks, 1, 5)[1], score(1.0, 0.25, 0.2), "two starts");
        assert_eq!(scores(truth, &tracks[..2], 1, 5)[2], score(1.0, 0.25, 0.2), "all there are");
    }

    proptest! {
        #[test]
        fn scores_are_shares_and_recall_never_falls(ends in proptest::collection::vec(0..25_usize, 1..40)) {
            let truth = world(".o.o#\n##.o.\no..#.\n.oo..\n#...o", 2);
            let tracks: Vec<Track> = ends
                .iter()
                .map(|&end| truth.cell(end))
                .map(|end| track(&[(0, 0), (end.row, end.column)]))
                .collect();
            let scores = scores(Truth { world: &truth, labels: None }, &tracks, 1, 40);
            let is_share = |value: Option<f64>| value.is_some_and(|v| (0.0..=1.0).contains(&v));
            for score in &scores {
                prop_assert!(is_share(score.precision) && is_share(score.recall));
                prop_assert!(is_share(score.recall_with_indoor));
            }
            prop_assert!(scores.is_sorted_by(|a, b| a.recall <= b.recall));
        }
    }

    #[test]
    fn without_holes_there_is_no_recall_and_without_starts_nothing() {
        let truth = world("..\n..", 2);
        let without = |world| Truth { world, labels: None };
        let score = scores(without(&truth), &[track(&[(0, 0)])], 0, 1)[0];
        assert_eq!((score.precision, score.recall), (Some(0.0), None));
        let holes = world("o.\n..", 2);
        assert_eq!(scores(without(&holes), &[], 0, 1)[0].recall, None);
    }
}
