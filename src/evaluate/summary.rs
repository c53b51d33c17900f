//! From the results of single maps to the figures of a report.

use rayon::prelude::*;

use super::bootstrap::Bootstrap;
use super::distance;
use super::groups::{GroupMembers, Traits, groups};
use super::map::{MapResult, MapScore, counts};
use super::methods;
use super::report::{
    CeilingScore, Difference, Difficulty, DistanceFigures, FlightFigures, Group, GroupScore,
    Interval, LabelFigures, OracleShare, Score,
};
use crate::config::{EvaluateConfig, Method};
use crate::grid::TileId;

/// The results of all maps, in the order of their names.
#[derive(Debug, Clone, Copy)]
pub(super) struct Results<'a> {
    pub(super) config: &'a EvaluateConfig,
    pub(super) ids: &'a [TileId],
    pub(super) maps: &'a [MapResult],
}

type Value = fn(&MapScore) -> Option<f64>;

const PRECISION: Value = |score| score.precision;
const RECALL: Value = |score| score.recall;
const EXPECTED: Value = |score| score.expected;

impl Results<'_> {
    /// A value of each map; methods that do not move have the same at every k.
    fn values(&self, method: usize, k: usize, starts: usize, value: Value) -> Vec<Option<f64>> {
        let of_map = |map: &MapResult| {
            let scores = &map.methods[method].scores;
            value(&scores[k.min(scores.len() - 1)][starts])
        };
        self.maps.iter().map(of_map).collect()
    }

    fn all_starts(&self) -> usize {
        counts(self.config.starts).len() - 1
    }

    fn methods(&self) -> impl IndexedParallelIterator<Item = (usize, Method)> + '_ {
        self.config.methods.par_iter().copied().enumerate()
    }

    /// Precision and recall against starts.
    pub(super) fn scores(&self, bootstrap: &Bootstrap) -> Vec<Score> {
        let counts = counts(self.config.starts);
        self.methods()
            .flat_map_iter(|(at, method)| {
                let steps = methods::steps(method, self.config).iter().enumerate();
                let points = steps.flat_map(|(k_at, &k)| {
                    counts.iter().enumerate().map(move |(count, &starts)| (k_at, k, count, starts))
                });
                points.map(move |(k_at, k, count, starts)| {
                    let mean = |value| bootstrap.mean(&self.values(at, k_at, count, value));
                    let recall_with_indoor = mean(|score| score.recall_with_indoor);
                    let (precision, recall) = (mean(PRECISION), mean(RECALL));
                    let judged = self.values(at, k_at, count, PRECISION);
                    let maps = judged.iter().flatten().count() as u64;
                    Score {
                        method,
                        k,
                        starts,
                        maps,
                        precision,
                        recall,
                        recall_with_indoor,
                        expected_precision: mean(EXPECTED),
                        sure_holes: mean(|score| score.sure_holes),
                        sure: mean(|score| score.sure),
                    }
                })
            })
            .collect()
    }

    /// How the methods fly.
    pub(super) fn flights(&self) -> Vec<FlightFigures> {
        let methods = self.config.methods.iter().enumerate();
        methods.map(|(at, &method)| self.flights_of(at, method)).collect()
    }

    fn flights_of(&self, at: usize, method: Method) -> FlightFigures {
        let on_maps = || self.maps.iter().map(|map| &map.methods[at]);
        let found_after = sum_histograms(on_maps().map(|on_map| &on_map.found_after[..]));
        let found: u64 = found_after.iter().sum();
        let not_found = on_maps().map(|on_map| on_map.not_found).sum();
        let hops: u64 = found_after.iter().zip(0..).map(|(&flights, hops)| flights * hops).sum();
        let metres: f64 = on_maps().map(|on_map| on_map.metres).sum();
        FlightFigures {
            method,
            mean_hops: (found > 0).then(|| hops as f64 / found as f64),
            found_after,
            not_found,
            predictions: on_maps().map(|on_map| on_map.predictions).sum(),
            blocked: on_maps().map(|on_map| on_map.blocked).sum(),
            mean_flight_m: metres / (found + not_found).max(1) as f64,
        }
    }

    /// Precision relative to the oracle's.
    pub(super) fn oracle_share(&self, bootstrap: &Bootstrap) -> Vec<OracleShare> {
        let is_oracle = |method: &Method| *method == Method::Oracle;
        let Some(oracle) = self.config.methods.iter().position(is_oracle) else {
            return Vec::new();
        };
        self.each_step(|at, method, k_at, k| {
            let values = |at| self.values(at, k_at, self.all_starts(), PRECISION);
            OracleShare { method, k, precision: bootstrap.ratio(&values(at), &values(oracle)) }
        })
    }

    /// Each pair of methods once, at every k.
    pub(super) fn differences(&self, bootstrap: &Bootstrap) -> Vec<Difference> {
        let pairs: Vec<(usize, usize)> =
            (0..self.config.methods.len()).flat_map(|b| (0..b).map(move |a| (a, b))).collect();
        pairs
            .into_par_iter()
            .flat_map_iter(|(a, b)| {
                let difference = move |k_at, value: Value| -> Option<Interval> {
                    let of = |at| self.values(at, k_at, self.all_starts(), value);
                    let (of_a, of_b) = (of(a), of(b));
                    let pairs = of_a.iter().zip(&of_b).map(|(a, b)| Some((*a)? - (*b)?));
                    bootstrap.mean(&pairs.collect::<Vec<_>>())
                };
                self.config.steps.iter().enumerate().map(move |(k_at, &k)| Difference {
                    a: self.config.methods[a],
                    b: self.config.methods[b],
                    k,
                    precision: difference(k_at, PRECISION),
                    recall: difference(k_at, RECALL),
                    expected_precision: difference(k_at, EXPECTED),
                })
            })
            .collect()
    }

    /// Scores by share of holes, density, height and size of buildings, and region.
    pub(super) fn groups(&self) -> Vec<Group> {
        let traits =
            |map: &MapResult| Traits { hole_share: map.hole_share(), buildings: map.buildings };
        let traits: Vec<Traits> = self.maps.iter().map(traits).collect();
        groups(self.ids, &traits).into_iter().map(|members| self.group(members, &traits)).collect()
    }

    fn group(&self, GroupMembers { kind, name, maps }: GroupMembers, traits: &[Traits]) -> Group {
        let bootstrap = Bootstrap::new(maps.len(), self.config.bootstrap, self.config.seed);
        let scores = self.each_step(|at, method, k_at, k| {
            let mean = |value| {
                let all = self.values(at, k_at, self.all_starts(), value);
                bootstrap.mean(&maps.iter().map(|&map| all[map]).collect::<Vec<_>>())
            };
            GroupScore { method, k, precision: mean(PRECISION), recall: mean(RECALL) }
        });
        let shares = maps.iter().map(|&map| traits[map].hole_share);
        let hole_share = shares.sum::<f64>() / maps.len() as f64;
        Group { kind, name, maps: maps.len() as u64, hole_share, scores }
    }

    /// How sure the holes are; `None` if no map tells.
    pub(super) fn labels(&self, bootstrap: &Bootstrap) -> Option<LabelFigures> {
        let told = || self.maps.iter().filter_map(|map| Some((map, map.labels.as_ref()?)));
        let repeats = || told().map(|(_, labels)| labels.repeats);
        let repeats = [repeats().min()?, repeats().max()?];
        let expected: Vec<Option<f64>> =
            self.maps.iter().map(|map| Some(map.labels.as_ref()?.expected_holes)).collect();
        let outdoors: Vec<Option<f64>> = self
            .maps
            .iter()
            .map(|map| map.labels.as_ref().map(|_| map.outdoor_cells as f64))
            .collect();
        let ceiling = |at: usize, expected: bool| {
            let of_map = |map: &MapResult| {
                let of = map.labels.as_ref()?.ceiling.as_ref()?[at];
                Some(if expected { of.expected } else { of.precision })
            };
            bootstrap.mean(&self.maps.iter().map(of_map).collect::<Vec<_>>())
        };
        let has_ceiling = told().any(|(_, labels)| labels.ceiling.is_some());
        let steps = self.config.steps.iter().enumerate().filter(|_| has_ceiling);
        Some(LabelFigures {
            maps: told().count() as u64,
            repeats,
            outdoor_cells: told().map(|(map, _)| map.outdoor_cells).sum(),
            sure_holes: told().map(|(_, labels)| labels.sure_holes).sum(),
            unsure: told().map(|(_, labels)| labels.unsure).sum(),
            expected_hole_share: bootstrap.ratio(&expected, &outdoors),
            ceiling: steps
                .map(|(at, &k)| CeilingScore {
                    k,
                    precision: ceiling(at, false),
                    expected_precision: ceiling(at, true),
                })
                .collect(),
        })
    }

    /// Holes by their distance to the nearest wall.
    pub(super) fn distances(&self, bootstrap: &Bootstrap) -> Vec<DistanceFigures> {
        let counts: Vec<_> = self.maps.iter().map(|map| &*map.distances).collect();
        distance::figures(&counts, bootstrap)
    }

    /// Something for each method and each of its k, in parallel.
    fn each_step<T: Send>(&self, make: impl Fn(usize, Method, usize, u32) -> T + Sync) -> Vec<T> {
        let make = &make;
        self.methods()
            .flat_map_iter(|(at, method)| {
                let steps = methods::steps(method, self.config).iter().enumerate();
                steps.map(move |(k_at, &k)| make(at, method, k_at, k))
            })
            .collect()
    }

    /// How hard the maps are.
    pub(super) fn difficulty(&self) -> Difficulty {
        let of_maps = || self.maps.iter().map(|map| &map.difficulty);
        Difficulty {
            cells_by_hops: sum_histograms(of_maps().map(|of_map| &of_map.cells_by_hops[..])),
            unreachable: of_maps().map(|of_map| of_map.unreachable).sum(),
        }
    }
}

fn sum_histograms<'a>(histograms: impl Iterator<Item = &'a [u64]>) -> Vec<u64> {
    let mut sum = Vec::new();
    for histogram in histograms {
        sum.resize(sum.len().max(histogram.len()), 0);
        sum.iter_mut().zip(histogram).for_each(|(sum, count)| *sum += count);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn histograms_of_different_lengths_add_up() {
        let sum = sum_histograms([&[1, 2][..], &[], &[0, 1, 5]].into_iter());
        assert_eq!(sum, [1, 3, 5]);
    }
}
