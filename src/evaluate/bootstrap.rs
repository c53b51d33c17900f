//! Percentile bootstrap over maps (Efron, "Bootstrap methods: another look at the jackknife", 1979).

use super::report::Interval;
use crate::rl::Random;

/// The same resamples of the maps for every figure, so that differences of figures are paired.
#[derive(Debug)]
pub(super) struct Bootstrap {
    maps: usize,
    /// One resample after the other, each of as many maps as there are.
    draws: Vec<u32>,
}

impl Bootstrap {
    pub(super) fn new(maps: usize, resamples: u32, seed: u64) -> Self {
        let mut random = Random::keyed(&[seed, maps as u64, u64::from(resamples)]);
        let draws = (0..maps * resamples as usize).map(|_| random.below(maps) as u32).collect();
        Self { maps, draws }
    }

    /// Mean and interval over the maps that have a value.
    pub(super) fn mean(&self, values: &[Option<f64>]) -> Option<Interval> {
        let weights: Vec<Option<f64>> = values.iter().map(|value| value.map(|_| 1.0)).collect();
        self.ratio(values, &weights)
    }

    /// The ratio of two sums over the maps that have both values, and its interval. `None` if no
    /// map has, or all below are 0.
    pub(super) fn ratio(&self, above: &[Option<f64>], below: &[Option<f64>]) -> Option<Interval> {
        assert_eq!((above.len(), below.len()), (self.maps, self.maps), "a value for each map");
        let pairs = above.iter().zip(below).map(|(&above, &below)| above.zip(below));
        let pairs: Vec<(f64, f64)> = pairs.map(|pair| pair.unwrap_or((0.0, 0.0))).collect();
        let ratio = |sum: (f64, f64)| (sum.1 > 0.0).then(|| sum.0 / sum.1);
        let add = |sum: (f64, f64), pair: &(f64, f64)| (sum.0 + pair.0, sum.1 + pair.1);
        let mean = ratio(pairs.iter().fold((0.0, 0.0), add))?;
        let resamples = self.draws.chunks_exact(self.maps);
        let mut means: Vec<f64> = resamples
            .filter_map(|draw| {
                ratio(draw.iter().fold((0.0, 0.0), |sum, &map| add(sum, &pairs[map as usize])))
            })
            .collect();
        means.sort_unstable_by(f64::total_cmp);
        Some(Interval { mean, low: quantile(&means, 0.025)?, high: quantile(&means, 0.975)? })
    }
}

/// Linear between the two nearest of sorted values.
fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let at = share * (sorted.len().checked_sub(1)? as f64);
    let (low, high) = (sorted[at.floor() as usize], sorted[at.ceil() as usize]);
    Some(low + (high - low) * at.fract())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_of_a_mean_is_that_of_the_normal_approximation() {
        let values: Vec<Option<f64>> = (0..400).map(|at| Some(f64::from(at % 2))).collect();
        let Interval { mean, low, high } =
            Bootstrap::new(400, 4000, 1).mean(&values).expect("there are values");
        // 1.96 * 0.5 / sqrt(400) = 0.049
        assert_eq!(mean, 0.5);
        assert!((low - 0.451).abs() < 0.006 && (high - 0.549).abs() < 0.006, "{low} {high}");
    }

    #[test]
    fn maps_without_a_value_do_not_count() {
        let bootstrap = Bootstrap::new(4, 500, 1);
        let mean = |values: [Option<f64>; 4]| bootstrap.mean(&values).map(|interval| interval.mean);
        assert_eq!(mean([Some(0.2), None, None, Some(0.4)]).map(|m| (m * 1e9).round()), Some(3e8));
        assert_eq!(mean([None; 4]), None);
        let constant = bootstrap.mean(&[Some(0.5), None, Some(0.5), None]).expect("values");
        assert_eq!((constant.low, constant.high), (0.5, 0.5));
        assert!(Bootstrap::new(0, 100, 1).mean(&[]).is_none());
    }

    #[test]
    fn ratios_are_of_sums() {
        let bootstrap = Bootstrap::new(2, 100, 1);
        let ratio = bootstrap.ratio(&[Some(1.0), Some(0.0)], &[Some(1.0), Some(3.0)]);
        assert_eq!(ratio.map(|interval| interval.mean), Some(0.25));
        assert!(bootstrap.ratio(&[Some(0.0); 2], &[Some(0.0); 2]).is_none());
    }
}
