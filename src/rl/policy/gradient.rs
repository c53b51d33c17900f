//! G-RSP and G-BNP: descent of the coverage map, equation 17.
//!
//! They are bounds in the paper's sense, not methods: a UAV cannot measure a gradient.

use super::{Policy, View, each};
use crate::rl::cell::Cell;
use crate::rl::world::World;

/// Gradient descent on one map.
#[derive(Debug, Clone)]
pub struct Descent {
    cells: usize,
    rate: f64,
    keep_fraction: bool,
    /// Change of level along rows and columns, in dB per cell.
    gradient: Vec<[f64; 2]>,
    /// Where the UAV may be led, if not everywhere.
    within: Option<Vec<bool>>,
}

/// How descent is done.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DescentStyle {
    /// Update rate, in cells per (dB per cell); 1 in the paper.
    pub rate: f64,
    /// Standard deviation of the Gaussian that smooths the levels first, in cells; 0 for none.
    pub smoothing_cells: f64,
    /// Carry what rounding to cells leaves over to the next step. Without it, at rate 1, a gradient
    /// below half a dB per cell is no move at all, however often.
    pub keep_fraction: bool,
}

impl Descent {
    /// For a map with the levels that the method is given. `neighbourhood` are the cells that it
    /// must not leave, if there are such (G-BNP).
    #[must_use]
    pub fn new(known: &World, style: DescentStyle, neighbourhood: Option<&[Cell]>) -> Self {
        let cells = known.cells();
        let free: Vec<bool> = (0..cells * cells).map(|at| known.is_free(known.cell(at))).collect();
        let levels: Vec<f64> =
            (0..cells * cells).map(|at| f64::from(known.rsrp_dbm(known.cell(at)))).collect();
        let levels = smoothed(cells, &levels, &free, style.smoothing_cells);
        let within = neighbourhood.map(|neighbourhood| {
            let mut within = vec![false; cells * cells];
            for &cell in neighbourhood {
                within[known.index(cell)] = true;
            }
            within
        });
        Self {
            cells,
            rate: style.rate,
            keep_fraction: style.keep_fraction,
            gradient: gradient(cells, &levels, &free),
            within,
        }
    }
}

impl Policy for Descent {
    fn predict(&self, views: &mut [View<'_, '_>]) -> Vec<[f64; 2]> {
        each(views, |view| {
            let (cell, [row, column]) = (view.flight.cell(), view.flight.position());
            let [down, right] =
                self.gradient[cell.row as usize * self.cells + cell.column as usize];
            [row - self.rate * down, column - self.rate * right]
        })
    }

    fn keeps_fraction(&self) -> bool {
        self.keep_fraction
    }

    fn allows(&self, cell: Cell) -> bool {
        let at = cell.row as usize * self.cells + cell.column as usize;
        self.within.as_ref().is_none_or(|within| within[at])
    }
}

/// Central differences between free cells, in dB per cell; one-sided where one neighbour is
/// occupied or outside of the map, 0 where both are: levels indoors say nothing about outdoors.
fn gradient(cells: usize, levels: &[f64], free: &[bool]) -> Vec<[f64; 2]> {
    let along = |at: usize, before: Option<usize>, after: Option<usize>| {
        let neighbour = |at: Option<usize>| at.filter(|&at| free[at]);
        match (neighbour(before), neighbour(after)) {
            (Some(before), Some(after)) => (levels[after] - levels[before]) / 2.0,
            (Some(before), None) => levels[at] - levels[before],
            (None, Some(after)) => levels[after] - levels[at],
            (None, None) => 0.0,
        }
    };
    (0..cells * cells)
        .map(|at| {
            let (row, column) = (at / cells, at % cells);
            let inside = |holds: bool, at: usize| holds.then_some(at);
            [
                along(at, at.checked_sub(cells), inside(row + 1 < cells, at + cells)),
                along(
                    at,
                    inside(column > 0, at.wrapping_sub(1)),
                    inside(column + 1 < cells, at + 1),
                ),
            ]
        })
        .collect()
}

/// Convolution with a Gaussian over free cells only, normalised by their weight (Knutsson and
/// Westin, "Normalized and differential convolution", 1993); out to four standard deviations.
fn smoothed(cells: usize, levels: &[f64], free: &[bool], sigma: f64) -> Vec<f64> {
    if sigma <= 0.0 {
        return levels.to_vec();
    }
    let radius = (4.0 * sigma).ceil() as usize;
    let kernel: Vec<f64> =
        (0..=radius).map(|d| libm::exp(-0.5 * (d as f64 / sigma) * (d as f64 / sigma))).collect();
    let blurred = |values: Vec<f64>| {
        transposed_blur(cells, &transposed_blur(cells, &values, &kernel), &kernel)
    };
    let weights: Vec<f64> = free.iter().map(|&free| f64::from(u8::from(free))).collect();
    let sums = blurred(levels.iter().zip(&weights).map(|(level, weight)| level * weight).collect());
    let weights = blurred(weights);
    // A free cell has at least its own weight; what occupied cells hold is never looked at.
    sums.iter().zip(&weights).map(|(sum, weight)| sum / weight.max(f64::MIN_POSITIVE)).collect()
}

/// Rows convolved with a symmetric kernel, then transposed: twice gives both axes in order.
fn transposed_blur(cells: usize, values: &[f64], kernel: &[f64]) -> Vec<f64> {
    let mut blurred = vec![0.0; values.len()];
    for (row, values) in values.chunks_exact(cells).enumerate() {
        for column in 0..cells {
            let first = column.saturating_sub(kernel.len() - 1);
            let end = (column + kernel.len()).min(cells);
            let sum = (first..end).map(|at| kernel[at.abs_diff(column)] * values[at]).sum();
            blurred[column * cells + row] = sum;
        }
    }
    blurred
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use crate::rl::flight::Flight;
    use crate::rl::sight::Sight;
    use crate::rl::world::tests::world;

    const GRID: DescentStyle =
        DescentStyle { rate: 1.0, smoothing_cells: 0.0, keep_fraction: false };

    /// Levels along the row: -80, -80, -120, -160 beside a building that holds -160.
    #[test]
    fn differences_are_central_and_ignore_buildings() {
        let levels = [-80.0, -84.0, -92.0, -160.0];
        let grid: Vec<f64> = levels.repeat(4);
        let free: Vec<bool> = [true, true, true, false].repeat(4);
        let gradient = gradient(4, &grid, &free);
        assert_eq!(gradient[4..7], [[0.0, -4.0], [0.0, -6.0], [0.0, -8.0]]);
    }

    /// Equation 17 by hand: 20 dB per cell to the east at column 1.
    #[test]
    fn descent_leads_to_the_weaker_side() {
        let (map, sight) = (world("..o.\n..o.\n..o.\n....", 3), Sight::new(3));
        let flight = Flight::new(&map, &map, &sight, Cell::new(1, 1));
        let mut random = Random::keyed(&[]);
        let mut predict = |style, neighbourhood: Option<&[Cell]>| {
            let descent = Descent::new(&map, style, neighbourhood);
            let view = View { flight: &flight, known: &map, random: &mut random };
            (descent.predict(&mut [view])[0], descent.allows(Cell::new(1, 2)))
        };
        assert_eq!(predict(GRID, None), ([1.0, 21.0], true));
        let slow = DescentStyle { rate: 0.1, ..GRID };
        assert_eq!(predict(slow, Some(&[Cell::new(1, 1)])), ([1.0, 3.0], false));
    }

    #[test]
    fn smoothing_keeps_a_constant_and_flattens_a_peak() {
        let free: Vec<bool> = (0..81).map(|at| at % 5 > 0).collect();
        let constant = smoothed(9, &[-90.0; 81], &free, 1.5);
        assert!(
            constant.iter().zip(&free).all(|(level, &free)| !free || (level + 90.0).abs() < 1e-9)
        );
        let mut peak = vec![0.0; 81];
        peak[40] = 1.0;
        let flat = smoothed(9, &peak, &[true; 81], 1.0);
        assert!(flat[40] < 0.2 && flat[40] > flat[41] && flat[41] > flat[42]);
        assert!((flat[31] - flat[49]).abs() < 1e-12 && (flat[39] - flat[41]).abs() < 1e-12);
    }
}
