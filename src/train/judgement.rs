//! How good a policy is on the validation split, and whether it is better than another: maps differ far more
//! from each other than policies do, so differences are taken map by map.

use std::fmt;

/// Precision on maps of the validation split.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Judgement {
    /// Numbers of steps.
    pub steps: Vec<u32>,
    /// Precision after at most so many steps, 0 to 1: for each map a value for each of `steps`.
    pub policy: Vec<Vec<f64>>,
    /// The same of the policy's own prediction of holes, followed greedily, if it has one.
    pub predictor: Option<Vec<Vec<f64>>>,
}

/// A mean over maps.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mean {
    /// The mean.
    pub mean: f64,
    /// Its standard error; 0 for fewer than two maps.
    pub error: f64,
}

impl Mean {
    /// Of a value for each map.
    #[must_use]
    pub fn of(values: &[f64]) -> Self {
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count.max(1.0);
        let squares = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
        let error = if count > 1.0 { (squares / (count - 1.0) / count).sqrt() } else { 0.0 };
        Self { mean, error }
    }
}

impl Judgement {
    /// Mean precision after each number of steps.
    #[must_use]
    pub fn precision(&self) -> Vec<(u32, f64)> {
        self.each_step(&self.policy).into_iter().map(|(k, mean)| (k, mean.mean)).collect()
    }

    /// By how much the policy is better than the predictor, after each number of steps.
    #[must_use]
    pub fn over_predictor(&self) -> Option<Vec<(u32, Mean)>> {
        let predictor = self.predictor.as_ref()?;
        let pairs = self.policy.iter().zip(predictor);
        let differences: Vec<Vec<f64>> =
            pairs.map(|(a, b)| a.iter().zip(b).map(|(a, b)| a - b).collect()).collect();
        Some(self.each_step(&differences))
    }

    /// The score of each map: the mean precision over the numbers of steps.
    #[must_use]
    pub fn scores(&self) -> Vec<f64> {
        let mean = |of: &Vec<f64>| of.iter().sum::<f64>() / of.len().max(1) as f64;
        self.policy.iter().map(mean).collect()
    }

    fn each_step(&self, maps: &[Vec<f64>]) -> Vec<(u32, Mean)> {
        let of = |at: usize| maps.iter().map(|map| map[at]).collect::<Vec<_>>();
        self.steps.iter().enumerate().map(|(at, &k)| (k, Mean::of(&of(at)))).collect()
    }
}

/// Precision in %, and by how much it is over the predictor's with the half-width of a 95 % interval.
impl fmt::Display for Judgement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let over = self.over_predictor();
        for (at, (k, precision)) in self.precision().into_iter().enumerate() {
            let comma = if at > 0 { ", " } else { "" };
            write!(f, "{comma}{:.1} (k = {k}", 100.0 * precision)?;
            if let Some(over) = &over {
                let (_, Mean { mean, error }) = over[at];
                write!(f, ", {:+.1} ± {:.1} over the predictor", 100.0 * mean, 196.0 * error)?;
            }
            f.write_str(")")?;
        }
        Ok(())
    }
}

/// Whether scores of the same maps are better than others by more than the standard error of the
/// difference; if they are not of the same maps, whether their mean is greater.
pub(super) fn is_better(scores: &[f64], than: &[f64]) -> bool {
    if scores.len() != than.len() {
        return Mean::of(scores).mean > Mean::of(than).mean;
    }
    let differences: Vec<f64> = scores.iter().zip(than).map(|(a, b)| a - b).collect();
    let difference = Mean::of(&differences);
    difference.mean > difference.error
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_paired() {
        let judgement = Judgement {
            steps: vec![1, 4],
            policy: vec![vec![0.2, 0.4], vec![0.8, 1.0]],
            predictor: Some(vec![vec![0.1, 0.4], vec![0.7, 0.8]]),
        };
        let close = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-12);
        let [(1, one), (4, four)] = judgement.precision()[..] else { panic!("two steps") };
        close(one, 0.5);
        close(four, 0.7);
        let over = judgement.over_predictor().expect("there is one");
        close(over[0].1.mean, 0.1);
        close(over[0].1.error, 0.0);
        close(over[1].1.mean, 0.1);
        close(over[1].1.error, 0.1);
        close(judgement.scores()[1], 0.9);
        let text = "50.0 (k = 1, +10.0 ± 0.0 over the predictor), \
                    70.0 (k = 4, +10.0 ± 19.6 over the predictor)";
        assert_eq!(judgement.to_string(), text);
    }

    /// The mean rises by 0.1 each time; only the first time do the maps agree about it.
    #[test]
    fn what_is_better_is_so_on_most_maps() {
        let best = [0.2, 0.5, 0.8];
        assert!(is_better(&[0.3, 0.6, 0.9], &best));
        assert!(!is_better(&[0.9, 0.4, 0.5], &best));
        assert!(!is_better(&best, &best));
        assert!(is_better(&[0.6], &best), "of other maps");
        assert!(is_better(&[0.1], &[]), "the first");
    }
}
