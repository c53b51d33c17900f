//! What the cells of imported maps and of records mean.

use ndarray::Array2;

/// An outdoor cell that some path reaches.
pub const MASK_REACHED: u8 = 0;
/// A cell that lies wholly in buildings.
pub const MASK_BUILDING: u8 = 1;
/// An outdoor cell without a path.
pub const MASK_UNREACHED: u8 = 2;

/// What repeats tell of the levels in a grid, `[n, n]`, row 0 north, column 0 west.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorGrids {
    /// Standard error of each level in dB: 10 / ln 10 times the standard error of the mean power over
    /// that mean, 0 to 4.343; 0 where there is no level.
    pub std_error_db: Array2<f32>,
    /// Share of the summed power that the first half of the repeats received, 0 to 1: the mean of that
    /// half is 2 · share · mean, the other one's 2 · (1 − share) · mean. 0 where there is no level.
    pub first_half_share: Option<Array2<f32>>,
}
