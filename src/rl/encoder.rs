//! What a Q-network sees of a state: `I_A`, the whole map, and `I_B`, the surroundings.
//!
//! Both have three channels, `[3, rows, columns]` in row-major order: the encoded location of the
//! UAV (equation 7), the encoded measurements (equation 9), the heights divided by
//! `height_scale_m`. `I_A` covers the map, L × L; `I_B` is cut out of it around the UAV,
//! (2l + 1) × (2l + 1). Cells of `I_B` beyond the map are occupied: encodings 0, height 1 (that
//! is, `height_scale_m`).
//!
//! The encodings are sums of one function of distance, 2^(-c d), centred on cells. A table of it,
//! (2L - 1) × (2L - 1), holds every shift: a row of a location's encoding is a copy of a part
//! of a row of the table, and one of the measurements' a weighted sum of such parts.

use rayon::prelude::*;

use super::cell::{Actions, Cell};
use super::flight::Measurement;
use super::symmetry::Symmetry;
use super::world::World;
use crate::config::RlConfig;

/// Channels of `I_A` and `I_B`.
pub const CHANNELS: usize = 3;
/// Normalised height of cells of `I_B` beyond the map.
const BEYOND_HEIGHT: f32 = 1.0;

/// `Z_nrm = (Z - ε) / (-ε)`: positive for covered cells, 1 at 0 dBm.
#[must_use]
pub fn normalised_rsrp(rsrp_dbm: f32, threshold_dbm: f32) -> f32 {
    (rsrp_dbm - threshold_dbm) / -threshold_dbm
}

/// 2^(-c d) at row and column distance from -`last` to `last`.
pub(super) fn decay_table(last: i32, decay: f64) -> Vec<f32> {
    let distance = |row: i32, column: i32| libm::hypot(f64::from(row), f64::from(column));
    (-last..=last)
        .flat_map(|row| (-last..=last).map(move |column| (row, column)))
        .map(|(row, column)| libm::exp2(-decay * distance(row, column)) as f32)
        .collect()
}

/// Encodes states of maps of one size.
#[derive(Debug)]
pub struct Encoder {
    cells: usize,
    actions: Actions,
    height_scale_m: f32,
    /// 2^(-c d) at row and column distance from -(L - 1) to L - 1.
    decay: Vec<f32>,
}

/// A state to be encoded: the map, and what was measured; the UAV is where it measured last.
#[derive(Debug, Clone, Copy)]
pub struct State<'a> {
    /// The map.
    pub world: &'a World,
    /// The measurements, the latest last.
    pub measurements: &'a [Measurement],
    /// How the map is turned or flipped before it is encoded.
    pub symmetry: Symmetry,
}

impl<'a> State<'a> {
    /// A state as it is, north up.
    #[must_use]
    pub fn new(world: &'a World, measurements: &'a [Measurement]) -> Self {
        Self { world, measurements, symmetry: Symmetry::IDENTITY }
    }
}

impl Encoder {
    /// For maps of `cells` × `cells`.
    #[must_use]
    pub fn new(cells: usize, config: &RlConfig) -> Self {
        Self {
            cells,
            actions: Actions::new(config.reach_cells),
            height_scale_m: config.height_scale_m as f32,
            decay: decay_table(cells as i32 - 1, config.encoding_decay),
        }
    }

    /// Cells along a side of the maps (L).
    #[must_use]
    pub fn cells(&self) -> usize {
        self.cells
    }

    /// The moves that `I_B` spans.
    #[must_use]
    pub fn actions(&self) -> Actions {
        self.actions
    }

    /// The table of 2^(-c d), `[2 L - 1, 2 L - 1]`: every distance along rows and columns, 0 in the
    /// middle.
    #[must_use]
    pub fn decay(&self) -> &[f32] {
        &self.decay
    }

    /// Numbers in `I_A`: 3 L².
    #[must_use]
    pub fn map_len(&self) -> usize {
        CHANNELS * self.cells * self.cells
    }

    /// Numbers in `I_B`: 3 (2l + 1)².
    #[must_use]
    pub fn window_len(&self) -> usize {
        CHANNELS * self.actions.count()
    }

    /// The part of the table that is row `row` of the map, seen from a cell.
    fn decay_row(&self, from: Cell, row: usize) -> &[f32] {
        let n = self.cells;
        let table_row = n - 1 + row - from.row as usize;
        let first = table_row * (2 * n - 1) + n - 1 - from.column as usize;
        &self.decay[first..first + n]
    }

    /// Writes `I_A` and `I_B` of a state.
    ///
    /// # Panics
    /// If the map has another size, nothing was measured, or a buffer has another length.
    pub fn encode(&self, state: State<'_>, map: &mut [f32], window: &mut [f32]) {
        let State { world, measurements, symmetry } = state;
        assert_eq!((world.cells(), map.len()), (self.cells, self.map_len()));
        let last = measurements.last().expect("the start is measured");
        let turned = |cell| symmetry.of(cell, self.cells);
        let center = turned(last.cell);
        let (location, rest) = map.split_at_mut(self.cells * self.cells);
        let (levels, heights) = rest.split_at_mut(self.cells * self.cells);
        let rows = location.chunks_exact_mut(self.cells).zip(levels.chunks_exact_mut(self.cells));
        for (row, (location, levels)) in rows.enumerate() {
            location.copy_from_slice(self.decay_row(center, row));
            levels.fill(0.0);
            for measurement in measurements {
                let weight = normalised_rsrp(measurement.rsrp_dbm, world.threshold_dbm());
                let decay = self.decay_row(turned(measurement.cell), row);
                levels.iter_mut().zip(decay).for_each(|(level, decay)| *level += weight * decay);
            }
        }
        symmetry.copy(world.heights(), heights, self.cells);
        for height in heights {
            *height /= self.height_scale_m;
        }
        self.cut_window(map, center, window);
    }

    /// `I_B` is `I_A` around a cell.
    fn cut_window(&self, map: &[f32], center: Cell, window: &mut [f32]) {
        assert_eq!(window.len(), self.window_len());
        let (n, side) = (self.cells as i32, self.actions.side());
        let reach = self.actions.reach();
        let first = (center.column - reach).max(0);
        let end = (center.column + reach + 1).min(n);
        let skipped = (first - (center.column - reach)) as usize;
        let channels = map.chunks_exact(self.cells * self.cells);
        let beyond = [0.0, 0.0, BEYOND_HEIGHT];
        for ((channel, out), beyond) in
            channels.zip(window.chunks_exact_mut(side * side)).zip(beyond)
        {
            for (out, row) in out.chunks_exact_mut(side).zip(center.row - reach..) {
                out.fill(beyond);
                if (0..n).contains(&row) {
                    let from = row as usize * self.cells;
                    let cells = &channel[from + first as usize..from + end as usize];
                    out[skipped..skipped + cells.len()].copy_from_slice(cells);
                }
            }
        }
    }

    /// Writes `I_A` and `I_B` of many states, one after the other, in parallel.
    ///
    /// # Panics
    /// As [`Encoder::encode`], for buffers of all states.
    pub fn encode_batch(&self, states: &[State<'_>], maps: &mut [f32], windows: &mut [f32]) {
        assert_eq!(maps.len(), states.len() * self.map_len());
        assert_eq!(windows.len(), states.len() * self.window_len());
        let buffers = maps
            .par_chunks_exact_mut(self.map_len())
            .zip(windows.par_chunks_exact_mut(self.window_len()));
        states.par_iter().zip(buffers).for_each(|(state, (map, window))| {
            self.encode(*state, map, window);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::world::tests::world;

    fn encoded(map: &str, reach: u32, measurements: &[Measurement]) -> (Vec<f32>, Vec<f32>) {
        let world = world(map, reach);
        let config = RlConfig { reach_cells: reach, ..RlConfig::default() };
        let encoder = Encoder::new(world.cells(), &config);
        let mut map = vec![f32::NAN; encoder.map_len()];
        let mut window = vec![f32::NAN; encoder.window_len()];
        encoder.encode(State::new(&world, measurements), &mut map, &mut window);
        (map, window)
    }

    fn measured(row: i32, column: i32, rsrp_dbm: f32) -> Measurement {
        Measurement { cell: Cell::new(row, column), rsrp_dbm }
    }

    /// Equations 7 and 9 by hand: c = 0.1, -80 dBm is 0.2, -50 dBm is 0.5.
    #[test]
    fn encodings_by_hand() {
        let (map, window) =
            encoded("...\n...\n#..", 1, &[measured(0, 0, -80.0), measured(0, 2, -50.0)]);
        let close = |found: f32, expected: f64| {
            assert!((f64::from(found) - expected).abs() < 1e-6, "{found} {expected}");
        };
        close(map[2], 1.0);
        close(map[0], 2_f64.powf(-0.2));
        close(map[9], 0.2 + 0.5 * 2_f64.powf(-0.2));
        close(
            map[9 + 4],
            0.2 * 2_f64.powf(-0.1 * 2_f64.sqrt()) + 0.5 * 2_f64.powf(-0.1 * 2_f64.sqrt()),
        );
        close(map[18 + 6], 10.0 / 50.0);
        close(map[18], 0.0);
        // The window lies around (0, 2): its first row and last column are beyond the map.
        assert_eq!(window[..3], [0.0; 3]);
        assert_eq!([window[3], window[4], window[5]], [map[1], map[2], 0.0]);
        assert_eq!(window[18..24], [1.0, 1.0, 1.0, 0.0, 0.0, 1.0]);
    }

    /// Against the formulae in float64, everywhere.
    #[test]
    fn encodings_agree_with_the_formulae() {
        let map = ["....."; 5].join("\n");
        let visits = [measured(4, 1, -91.25), measured(0, 3, -160.0), measured(2, 2, -60.5)];
        let (map, _) = encoded(&map, 2, &visits);
        let decay = |at: usize, from: Cell| {
            let (row, column) = ((at / 5) as f64, (at % 5) as f64);
            let [from_row, from_column] = from.center();
            2_f64.powf(-0.1 * ((row - from_row).powi(2) + (column - from_column).powi(2)).sqrt())
        };
        for at in 0..25 {
            let level: f64 = visits
                .iter()
                .map(|m| (f64::from(m.rsrp_dbm) + 100.0) / 100.0 * decay(at, m.cell))
                .sum();
            assert!((f64::from(map[at]) - decay(at, visits[2].cell)).abs() < 1e-6);
            assert!((f64::from(map[25 + at]) - level).abs() < 1e-6);
        }
    }

    /// Turning the state is turning what is seen of it.
    #[test]
    fn turned_states_are_turned_encodings() {
        let world = world(".#..o\n.....\n..#..\no....\n.....", 2);
        let encoder = Encoder::new(5, &RlConfig { reach_cells: 2, ..RlConfig::default() });
        let encode = |symmetry| {
            let (mut map, mut window) = (vec![0.0; 75], vec![0.0; 75]);
            let measurements = &[measured(1, 3, -70.0), measured(3, 1, -90.0)];
            encoder.encode(State { world: &world, measurements, symmetry }, &mut map, &mut window);
            [map, window]
        };
        let straight = encode(Symmetry::IDENTITY);
        for symmetry in (0..Symmetry::COUNT).map(Symmetry::new) {
            for (straight, turned) in straight.iter().zip(encode(symmetry)) {
                let channels = straight.chunks_exact(25).zip(turned.chunks_exact(25));
                for (straight, turned) in channels {
                    let mut expected = [0.0; 25];
                    symmetry.copy(straight, &mut expected, 5);
                    let close = |(a, b): (&f32, &f32)| (a - b).abs() < 1e-6;
                    assert!(expected.iter().zip(turned).all(close), "{symmetry:?}");
                }
            }
        }
    }

    #[test]
    fn normalisation_by_hand() {
        assert_eq!(normalised_rsrp(-100.0, -100.0), 0.0);
        assert_eq!(normalised_rsrp(-50.0, -100.0), 0.5);
        assert!((normalised_rsrp(-160.0, -100.0) + 0.6).abs() < 1e-6);
    }
}
