//! How sure it is that a cell is a coverage hole.
//!
//! A traced level is an estimate: the mean of R independent repeats in linear power, with the
//! standard error of that mean. The chance that the true level lies below a threshold ε follows
//! from a Student t distribution with R − 1 degrees of freedom *in dB*,
//!
//! P(RSRP < ε) = `T_{R−1}`((ε − RSRP) / σ),  σ = 10 / ln 10 · standard error / mean,
//!
//! σ being the standard error in dB by the delta method. Why in dB: power that comes by few rays is
//! skewed, so that its mean and its error rise and fall together; the logarithm takes that out to
//! first order, and gives no chance to powers below zero. `benches/label_model.py` compares it with
//! the t distribution in linear power and with others, `docs/LABELS.md` has the figures. A cell that no
//! repeat reaches is a hole for sure; a cell without any error is one or is none.
//!
//! What is modelled wrongly (walls, heights, materials) is no part of this: repeats share it.

use crate::units::Dbm;

/// The threshold that figures of imports and datasets are counted with, in dBm (the paper's default).
pub const HOLE_THRESHOLD: Dbm = Dbm(-100.0);
/// From this chance on a cell is surely a hole, and up to one less this it surely is none.
pub const SURE: f64 = 0.95;
/// The standard error in dB of a mean whose relative standard error is 1: 10 / ln 10. Repeats of
/// powers, which are not negative, cannot have a larger one: that of a single repeat that is not 0.
pub const MAX_STD_ERROR_DB: f64 = 10.0 / std::f64::consts::LN_10;
/// More degrees of freedom make no difference that matters: less than 0.0001 in probability.
const MAX_DEGREES: u32 = 1000;

/// The standard error in dB of a power with a relative standard error (standard error / mean).
#[must_use]
pub fn std_error_db(relative: f64) -> f64 {
    MAX_STD_ERROR_DB * relative
}

/// The relative standard error of a power with a standard error in dB.
#[must_use]
pub fn relative_std_error(std_error_db: f64) -> f64 {
    std_error_db / MAX_STD_ERROR_DB
}

/// What repeats tell of thresholds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HoleModel {
    degrees: u32,
    /// Standard errors between a level and the thresholds that are sure.
    quantile: f64,
}

impl HoleModel {
    /// For levels that are means of so many repeats, two at least.
    #[must_use]
    pub fn new(repeats: u32) -> Self {
        let degrees = repeats.saturating_sub(1).clamp(1, MAX_DEGREES);
        Self { degrees, quantile: quantile(SURE, degrees) }
    }

    /// The chance that a reached cell lies below the threshold, 0 to 1; its standard error is in dB.
    #[must_use]
    pub fn probability(&self, rsrp: Dbm, std_error_db: f64, threshold: Dbm) -> f64 {
        if std_error_db > 0.0 {
            student_t((threshold.0 - rsrp.0) / std_error_db, self.degrees)
        } else {
            f64::from(u8::from(rsrp.0 < threshold.0))
        }
    }

    /// By how many dB the threshold would have to differ for the cell to be surely a hole, or surely
    /// none; 0 if it is sure.
    #[must_use]
    pub fn shift_to_sure_db(&self, rsrp: Dbm, std_error_db: f64, threshold: Dbm) -> f64 {
        (self.quantile * std_error_db - (threshold.0 - rsrp.0).abs()).max(0.0)
    }
}

/// Distribution function of Student's t with a whole number of degrees of freedom: the finite
/// series of Abramowitz and Stegun, 26.7.3 and 26.7.4, the same bits on every machine.
fn student_t(t: f64, degrees: u32) -> f64 {
    let (sin, cos) = libm::sincos(libm::atan(t.abs() / libm::sqrt(f64::from(degrees))));
    let is_odd = degrees % 2 == 1;
    // Terms of the series are products of n / (n + 1) and cos², n from 2 (odd) or 1 (even) on.
    let mut term = if is_odd { cos } else { 1.0 };
    let mut sum = 0.0;
    let mut n = if is_odd { 2 } else { 1 };
    while n < degrees {
        sum += term;
        term *= f64::from(n) / f64::from(n + 1) * cos * cos;
        n += 2;
    }
    let within = if is_odd {
        (libm::atan2(sin, cos) + sin * sum) * std::f64::consts::FRAC_2_PI
    } else {
        sin * sum
    };
    let half = within.clamp(0.0, 1.0) / 2.0;
    if t < 0.0 { 0.5 - half } else { 0.5 + half }
}

/// Where a distribution function of Student's t has a value above one half, by bisection.
fn quantile(probability: f64, degrees: u32) -> f64 {
    /// Half of it is beyond the quantile 0.95 of one degree, 6.3.
    const BEYOND: f64 = 16.0;
    /// Steps until the interval is as narrow as float64 has it.
    const STEPS: u32 = 60;
    let (mut low, mut high) = (0.0, BEYOND);
    for _ in 0..STEPS {
        let middle = f64::midpoint(low, high);
        if student_t(middle, degrees) < probability {
            low = middle;
        } else {
            high = middle;
        }
    }
    f64::midpoint(low, high)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `scipy.stats.t.cdf(x, degrees)` of `SciPy` 1.17.1 for x of -3, -0.5, 0, 0.2, 1, 2.5 and 8, and
    /// `scipy.stats.t.ppf(0.95, degrees)`.
    #[test]
    fn the_distribution_is_that_of_scipy() {
        let at = [-3.0, -0.5, 0.0, 0.2, 1.0, 2.5, 8.0];
        #[rustfmt::skip]
        let cases = [
            (1, [0.102_416_382_349_566_72, 0.352_416_382_349_566_74, 0.5, 0.562_832_958_189_001,
                0.75, 0.878_881_058_409_156_6, 0.960_416_575_839_434_4], 6.313_751_514_675_037),
            (2, [0.047_732_983_133_354_56, 0.333_333_333_333_333_37, 0.5, 0.570_014_004_201_400_5,
                0.788_675_134_594_812_9, 0.935_194_139_889_244_6, 0.992_365_963_917_330_9],
                2.919_985_580_353_724_2),
            (3, [0.028_834_442_811_218_65, 0.325_723_982_424_075_5, 0.5, 0.572_864_835_376_860_5,
                0.804_498_890_522_114_8, 0.956_146_676_495_967_2, 0.997_961_711_206_107_2],
                2.353_363_434_801_823_3),
            (7, [0.009_971_063_065_996_268, 0.316_203_567_844_642_2, 0.5, 0.576_416_624_255_101_1,
                0.824_691_668_589_896_3, 0.979_503_890_707_123_5, 0.999_954_425_394_145_6],
                1.894_578_605_090_006_2),
            (8, [0.008_535_840_616_891_326, 0.315_268_037_778_488_2, 0.5, 0.576_764_504_299_481_3,
                0.826_703_246_456_332_9, 0.981_528_981_143_188, 0.999_978_165_869_843_3],
                1.859_548_037_530_897_3),
            (15, [0.004_486_368_738_611_663, 0.312_165_056_760_037_8, 0.5, 0.577_916_611_512_808,
                0.833_414_932_042_261_8, 0.987_747_098_376_743_1, 0.999_999_569_453_480_9],
                1.753_050_355_692_572),
            (63, [0.001_931_919_238_049_578_6, 0.309_408_544_940_207_86, 0.5,
                0.578_937_615_378_914_5, 0.839_431_984_208_687_1, 0.992_482_397_844_433_8,
                0.999_999_999_982_160_4], 1.669_402_221_706_812_7),
            (1000, [0.001_383_354_522_119_096_3, 0.308_592_540_416_937_34, 0.5,
                0.579_239_377_838_011_9, 0.841_223_790_957_663_8, 0.993_710_716_099_454_6,
                0.999_999_999_999_998_3], 1.646_378_817_285_464_3),
        ];
        for (degrees, expected, at_95) in cases {
            for (t, expected) in at.into_iter().zip(expected) {
                let found = student_t(t, degrees);
                assert!((found - expected).abs() < 1e-13, "T_{degrees}({t}) = {found}");
            }
            assert!((quantile(0.95, degrees) - at_95).abs() < 1e-11, "{degrees} degrees");
        }
    }

    /// `scipy.stats.t.cdf((threshold - rsrp) / error, repeats - 1)`.
    #[test]
    fn chances_of_holes_are_those_of_the_model() {
        let cases = [
            (-98.0, 1.0, 8, 0.042_809_664_281_488_025),
            (-101.5, 0.75, 8, 0.957_190_335_718_512),
            (-100.2, 4.34, 16, 0.518_073_967_378_989_6),
            (-104.0, 1.0, 2, 0.922_020_869_622_630_6),
        ];
        for (rsrp, error, repeats, expected) in cases {
            let model = HoleModel::new(repeats);
            let found = model.probability(Dbm(rsrp), error, HOLE_THRESHOLD);
            assert!((found - expected).abs() < 1e-13, "{rsrp} ± {error}: {found}");
            let is_sure = !(1.0 - SURE..=SURE).contains(&found);
            let shift = model.shift_to_sure_db(Dbm(rsrp), error, HOLE_THRESHOLD);
            assert_eq!(shift == 0.0, is_sure, "{shift}");
            if !is_sure {
                // Moved by that much, the threshold is where the chance is 0.05 or 0.95.
                let way = (HOLE_THRESHOLD.0 - rsrp).signum() * shift;
                let moved = model.probability(Dbm(rsrp), error, Dbm(HOLE_THRESHOLD.0 + way));
                assert!((moved - if way > 0.0 { SURE } else { 1.0 - SURE }).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn without_an_error_a_cell_is_a_hole_or_none() {
        let model = HoleModel::new(8);
        let chance = |rsrp| model.probability(Dbm(rsrp), 0.0, HOLE_THRESHOLD);
        assert_eq!([chance(-100.1), chance(-100.0), chance(-99.9)], [1.0, 0.0, 0.0]);
        assert_eq!(model.shift_to_sure_db(Dbm(-100.0), 0.0, HOLE_THRESHOLD), 0.0);
    }

    /// One repeat of eight that is not 0: mean x / 8, standard error x / 8.
    #[test]
    fn the_largest_relative_error_is_one() {
        let mean = 1.0 / 8.0;
        let squares = (1.0 - mean) * (1.0 - mean) + 7.0 * mean * mean;
        let error = libm::sqrt(squares / 7.0 / 8.0);
        assert!((error / mean - 1.0).abs() < 1e-12);
        assert!((std_error_db(1.0) - 4.342_944_819_032_518).abs() < 1e-12);
        assert!((relative_std_error(std_error_db(0.3)) - 0.3).abs() < 1e-15);
    }
}
