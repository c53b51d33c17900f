//! Many cells to one.
//!
//! Downsampling 1 m maps by the linear mean with unreached cells counted as zero matches
//! a direct trace at 4 m (0.00 ± 0.32 dB); a mean in dB is biased by −1 dB and more.

use ndarray::{Array2, ArrayView2, Zip};

use crate::config::{HeightDownsampling, RsrpDownsampling};
use crate::manifest::ErrorGrids;
use crate::manifest::{MASK_BUILDING, MASK_REACHED, MASK_UNREACHED};
use crate::reliability::{relative_std_error, std_error_db};
use crate::units::Dbm;

/// Heights of blocks of `factor` × `factor` cells.
///
/// # Panics
/// If the sides are no multiples of the factor.
#[must_use]
pub fn downsample_heights(
    heights: ArrayView2<'_, f32>,
    factor: usize,
    method: HeightDownsampling,
) -> Array2<f32> {
    demand_whole(heights.dim(), factor);
    Zip::from(heights.exact_chunks((factor, factor))).map_collect(|cells| match method {
        HeightDownsampling::Max => cells.iter().copied().fold(0.0, f32::max),
        HeightDownsampling::Mean => {
            let sum: f64 = cells.iter().copied().map(f64::from).sum();
            (sum / cells.len() as f64) as f32
        }
        HeightDownsampling::Nearest => cells[[factor / 2, factor / 2]],
    })
}

/// RSRP and mask of blocks of `factor` × `factor` cells. Only outdoor cells count: a block
/// is a building if it has none, reached if one of them is, else unreached and at the floor.
///
/// # Panics
/// If the arrays differ in shape or their sides are no multiples of the factor.
#[must_use]
pub fn downsample_rsrp(
    rsrp_dbm: ArrayView2<'_, f32>,
    mask: ArrayView2<'_, u8>,
    factor: usize,
    method: RsrpDownsampling,
    floor: Dbm,
) -> (Array2<f32>, Array2<u8>) {
    assert_eq!(rsrp_dbm.dim(), mask.dim(), "RSRP and mask belong together");
    demand_whole(rsrp_dbm.dim(), factor);
    let blocks = (factor, factor);
    let of_both = Zip::from(rsrp_dbm.exact_chunks(blocks)).and(mask.exact_chunks(blocks));
    let cells = of_both.map_collect(|values, kinds| {
        let outdoor = kinds.iter().filter(|&&kind| kind != MASK_BUILDING).count();
        let reached = || {
            let pairs = values.iter().zip(kinds.iter());
            pairs.filter(|(_, kind)| **kind == MASK_REACHED).map(|(value, _)| f64::from(*value))
        };
        let count = reached().count();
        if outdoor == 0 {
            return (floor.0 as f32, MASK_BUILDING);
        }
        if count == 0 {
            return (floor.0 as f32, MASK_UNREACHED);
        }
        let level = match method {
            RsrpDownsampling::LinearMean if count == 1 && outdoor == 1 => {
                // Exactly the value, without the detour over milliwatts.
                reached().next().unwrap_or(floor.0)
            }
            RsrpDownsampling::LinearMean => {
                let sum: f64 = reached().map(|value| Dbm(value).to_milliwatts()).sum();
                Dbm::from_milliwatts(sum / outdoor as f64).0
            }
            RsrpDownsampling::MeanDb => reached().sum::<f64>() / count as f64,
            RsrpDownsampling::Nearest => {
                let center = [factor / 2, factor / 2];
                return match kinds[center] {
                    MASK_REACHED => (values[center], MASK_REACHED),
                    kind => (floor.0 as f32, kind),
                };
            }
        };
        (level as f32, MASK_REACHED)
    });
    (cells.mapv(|(value, _)| value), cells.mapv(|(_, kind)| kind))
}

/// Errors of blocks of `factor` × `factor` cells, whose levels [`downsample_rsrp`] gives.
///
/// Cells of a block are taken to err independently: within a repeat they are hit by different rays.
/// Then squares of errors add up, and sixteen cells of equal power have a quarter of the relative error
/// of one. What all of them share, such as an edge that a repeat did not find, is not averaged
/// out, and makes the error of the block too small; maps traced at the size of records are free of it.
///
/// # Panics
/// If the arrays differ in shape or their sides are no multiples of the factor.
#[must_use]
pub fn downsample_errors(
    rsrp_dbm: ArrayView2<'_, f32>,
    mask: ArrayView2<'_, u8>,
    errors: &ErrorGrids,
    factor: usize,
    method: RsrpDownsampling,
) -> ErrorGrids {
    let dim = rsrp_dbm.dim();
    assert!(mask.dim() == dim && errors.std_error_db.dim() == dim, "they belong together");
    let shares = errors.first_half_share.as_ref();
    let cells = blocks(dim, factor, |(rows, columns)| {
        let middle = (rows.start + factor / 2, columns.start + factor / 2);
        let places = rows.flat_map(|row| columns.clone().map(move |column| (row, column)));
        let reached = places.filter(|&at| mask[at] == MASK_REACHED);
        let used: Vec<(usize, usize)> = match method {
            RsrpDownsampling::Nearest => reached.filter(|&at| at == middle).collect(),
            RsrpDownsampling::LinearMean | RsrpDownsampling::MeanDb => reached.collect(),
        };
        let error = |at: &(usize, usize)| f64::from(errors.std_error_db[*at]);
        let share = |at: &(usize, usize)| shares.map_or(0.0, |shares| f64::from(shares[*at]));
        if let [at] = &used[..] {
            return [error(at) as f32, share(at) as f32];
        }
        let power = |at: &(usize, usize)| Dbm(rsrp_dbm[*at].into()).to_milliwatts();
        let sum: f64 = used.iter().map(power).sum();
        if sum <= 0.0 {
            return [0.0; 2];
        }
        let squares = |error: &dyn Fn(&(usize, usize)) -> f64| {
            libm::sqrt(used.iter().map(|at| error(at) * error(at)).sum())
        };
        let of_mean = match method {
            RsrpDownsampling::MeanDb => squares(&error) / used.len() as f64,
            _ => std_error_db(squares(&|at| relative_std_error(error(at)) * power(at)) / sum),
        };
        let first_half: f64 = used.iter().map(|at| share(at) * power(at)).sum();
        [of_mean as f32, (first_half / sum) as f32]
    });
    ErrorGrids {
        std_error_db: cells.mapv(|[error, _]| error),
        first_half_share: shares.map(|_| cells.mapv(|[_, share]| share)),
    }
}

fn demand_whole((rows, columns): (usize, usize), factor: usize) {
    let whole = rows % factor == 0 && columns % factor == 0;
    assert!(whole, "{rows} × {columns} cells are no whole blocks of {factor}");
}

type CellBlock = (std::ops::Range<usize>, std::ops::Range<usize>);

fn blocks<T>(
    (rows, columns): (usize, usize),
    factor: usize,
    mut of_block: impl FnMut(CellBlock) -> T,
) -> Array2<T> {
    demand_whole((rows, columns), factor);
    Array2::from_shape_fn((rows / factor, columns / factor), |(row, column)| {
        let range = |index: usize| index * factor..(index + 1) * factor;
        of_block((range(row), range(column)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    const FLOOR: Dbm = Dbm(-160.0);

    #[test]
    fn heights() {
        let heights = array![[0.0, 4.0, 1.0, 1.0], [8.0, 0.0, 1.0, 1.0]];
        let by = |method| downsample_heights(heights.view(), 2, method);
        assert_eq!(by(HeightDownsampling::Max), array![[8.0, 1.0]]);
        assert_eq!(by(HeightDownsampling::Mean), array![[3.0, 1.0]]);
        assert_eq!(by(HeightDownsampling::Nearest), array![[0.0, 1.0]]);
    }

    #[test]
    fn rsrp_is_averaged_as_power_over_outdoor_cells() {
        let rsrp = array![[-90.0, -160.0, -100.0, -160.0], [-160.0, -160.0, -160.0, -160.0]];
        // Block 1: reached, unreached, building, building. Block 2: one outdoor cell, reached.
        let mask = array![[0, 2, 0, 1], [1, 1, 1, 1]];
        let by = |method| downsample_rsrp(rsrp.view(), mask.view(), 2, method, FLOOR);
        let (mean, kinds) = by(RsrpDownsampling::LinearMean);
        assert!((mean[[0, 0]] + 93.0103).abs() < 1e-4, "half the power of -90 dBm: {mean}");
        assert_eq!((mean[[0, 1]], kinds), (-100.0, array![[0, 0]]));
        assert_eq!(by(RsrpDownsampling::MeanDb).0, array![[-90.0, -100.0]]);
        let (nearest, kinds) = by(RsrpDownsampling::Nearest);
        assert_eq!((nearest, kinds), (array![[-160.0, -160.0]], array![[1, 1]]));
    }

    /// Half the power of a block has a relative error of 0.4, a quarter each of 0.2 and 0: √(0.2² +
    /// 0.05²) = 0.206 of the mean, 0.895 dB.
    #[test]
    fn squares_of_errors_add_up() {
        let rsrp = array![[-90.0, -93.0103], [-93.0103, -160.0]];
        let mask = array![[0, 0], [0, 2]];
        let errors = ErrorGrids {
            std_error_db: array![[0.4, 0.2], [0.0, 0.0]].mapv(|r| std_error_db(r) as f32),
            first_half_share: Some(array![[0.5, 1.0], [0.0, 0.0]]),
        };
        let by = |method| {
            let of = downsample_errors(rsrp.view(), mask.view(), &errors, 2, method);
            [of.std_error_db[[0, 0]], of.first_half_share.expect("shares")[[0, 0]]]
        };
        let close = |found: [f32; 2], expected: [f32; 2]| {
            found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-4)
        };
        // The share: 0.5 · 0.5 + 0.25 · 1.
        assert!(close(by(RsrpDownsampling::LinearMean), [0.895_35, 0.5]));
        assert!(close(by(RsrpDownsampling::MeanDb), [0.647_41, 0.5]));
        assert_eq!(by(RsrpDownsampling::Nearest), [0.0, 0.0], "an unreached cell");
        let one =
            downsample_errors(rsrp.view(), mask.view(), &errors, 1, RsrpDownsampling::LinearMean);
        assert_eq!(one, errors);
    }

    #[test]
    fn blocks_without_a_path_or_without_outdoors() {
        let rsrp = Array2::from_elem((2, 4), -160.0);
        let mask = array![[2, 1, 1, 1], [1, 1, 1, 1]];
        let (values, kinds) =
            downsample_rsrp(rsrp.view(), mask.view(), 2, RsrpDownsampling::LinearMean, FLOOR);
        assert_eq!((values, kinds), (array![[-160.0, -160.0]], array![[2, 1]]));
    }
}
