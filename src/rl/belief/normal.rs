//! The normal distribution.

const LIMIT: f32 = 6.0;
const STEPS: f32 = 64.0;

/// Its distribution function, interpolated between 64 points a standard deviation: off by less than 10⁻⁵.
#[derive(Debug, Clone)]
pub(super) struct NormalTable(Vec<f32>);

impl NormalTable {
    pub(super) fn new() -> Self {
        let last = (2.0 * LIMIT * STEPS) as usize;
        let point =
            |at: usize| distribution(at as f64 / f64::from(STEPS) - f64::from(LIMIT)) as f32;
        // One more, so that a value may always be interpolated.
        Self((0..=last + 1).map(point).collect())
    }

    /// The chance to be below some standard deviations.
    pub(super) fn below(&self, deviations: f32) -> f32 {
        let at = (deviations.clamp(-LIMIT, LIMIT) + LIMIT) * STEPS;
        let (index, part) = (at as usize, at.fract());
        self.0[index] + part * (self.0[index + 1] - self.0[index])
    }
}

/// The distribution function.
fn distribution(deviations: f64) -> f64 {
    0.5 * libm::erfc(-deviations * std::f64::consts::FRAC_1_SQRT_2)
}

/// The value that lies above a share of the distribution, by bisection.
pub(super) fn quantile(share: f64) -> f64 {
    let (mut low, mut high) = (-f64::from(LIMIT), f64::from(LIMIT));
    for _ in 0..60 {
        let middle = f64::midpoint(low, high);
        if distribution(middle) < share {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `scipy.stats.norm`.
    #[test]
    fn shares_and_quantiles_are_those_of_tables() {
        let table = NormalTable::new();
        for (deviations, share) in
            [(0.0, 0.5), (1.0, 0.841_344_7), (-2.5, 0.006_209_665), (9.0, 1.0)]
        {
            assert!((table.below(deviations) - share).abs() < 1e-5, "{deviations}");
        }
        for (share, deviations) in [(0.5, 0.0), (0.975, 1.959_963_985), (0.01, -2.326_347_874)] {
            assert!((quantile(share) - deviations).abs() < 1e-8, "{share}");
        }
    }
}
