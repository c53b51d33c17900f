//! The encoding of preset `best`: the UAV is in the middle, and what decides is shown.
//!
//! The *window* shows the cells within reach and 15 more on each side at full resolution,
//! `[channels, W, W]` with W = 2 (l + 15) + 1; the *map* shows the whole map in 49 × 49 blocks,
//! `[coarse channels, 49, 49]`, the UAV in the middle of the middle one. Channels come in the
//! order of [`Channel`] in `train.channels`; those of blocks are the [coarse](Channel::is_coarse)
//! ones among them. A block holds shares of its cells (`occupied`, `beyond`), the mean of
//! their heights' channel, and levels and weights of the cell in its middle. Both squares are
//! symmetric about the UAV, so a state that is turned or flipped is encoded as it is and turned then.

use std::ops::Range;

use super::cell::{Actions, Cell};
use super::encoder::{State, decay_table};
use super::sight::Sight;
use super::world::World;
use crate::config::{Channel, RlConfig};

/// Cells that the window shows beyond the reach, on each side: an odd number, see the network.
pub(super) const CONTEXT: u32 = 15;
/// Blocks along a side of the map.
pub(super) const BLOCKS: usize = 49;
/// Heights count by their ratio to this, in metres: about a storey, the median of San Jose.
const HEIGHT_SCALE_M: f32 = 4.0;
/// Levels above the threshold are divided by this, in dB.
const LEVEL_SCALE_DB: f32 = 20.0;

/// Encodes states of maps of one size, centred on the UAV.
#[derive(Debug)]
pub struct CenteredEncoder {
    cells: usize,
    sight: Sight,
    channels: Vec<Channel>,
    /// Cells along a side of a block: odd, the least with which the blocks always hold the map.
    block: i32,
    /// 2^(-c d) at row and column distance from -(L - 1) to L - 1.
    decay: Vec<f32>,
    /// The same at the distances of the window's cells from its middle.
    location: Vec<f32>,
}

/// Levels and weights of a state, `[side, side]` each.
struct Measured {
    level: Vec<f32>,
    weight: Vec<f32>,
}

impl CenteredEncoder {
    /// For maps of `cells` × `cells`.
    #[must_use]
    pub fn new(cells: usize, config: &RlConfig, channels: &[Channel]) -> Self {
        let extent = (2 * cells).saturating_sub(1).max(1);
        let block = extent.div_ceil(BLOCKS) | 1;
        let half = (config.reach_cells + CONTEXT) as i32;
        Self {
            cells,
            sight: Sight::new(config.reach_cells),
            channels: channels.to_vec(),
            block: block as i32,
            decay: decay_table(cells as i32 - 1, config.encoding_decay),
            location: decay_table(half, config.encoding_decay),
        }
    }

    /// Cells along a side of the maps (L).
    #[must_use]
    pub fn cells(&self) -> usize {
        self.cells
    }

    /// The moves.
    #[must_use]
    pub fn actions(&self) -> Actions {
        self.sight.actions()
    }

    /// `[channels, rows, columns]` of the map and of the window.
    #[must_use]
    pub fn shapes(&self) -> [[usize; 3]; 2] {
        let coarse = self.channels.iter().filter(|channel| channel.is_coarse()).count();
        let side = 2 * self.half() as usize + 1;
        [[coarse, BLOCKS, BLOCKS], [self.channels.len(), side, side]]
    }

    /// Cells along a side of a block.
    #[must_use]
    pub fn block(&self) -> i32 {
        self.block
    }

    /// Cells of the window on each side of the UAV.
    fn half(&self) -> i32 {
        self.actions().reach() + CONTEXT as i32
    }

    /// Writes the map and the window of a state, in the shapes of [`CenteredEncoder::shapes`].
    ///
    /// # Panics
    /// If the map has another size, nothing was measured, the UAV is in no free cell, or a buffer
    /// has another length.
    pub fn encode(&self, state: State<'_>, map: &mut [f32], window: &mut [f32]) {
        let State { world, measurements, symmetry } = state;
        let [[coarse, _, _], [fine, side, _]] = self.shapes();
        assert_eq!(world.cells(), self.cells);
        let squares = [(coarse, map, BLOCKS), (fine, window, side)];
        let center = measurements.last().expect("the start is measured").cell;
        for (at, (channels, buffer, side)) in squares.into_iter().enumerate() {
            assert_eq!(buffer.len(), channels * side * side);
            let step = if at == 0 { self.block } else { 1 };
            let measured = self.measured(state, center, side, step);
            let shown = self.channels.iter().filter(|channel| at > 0 || channel.is_coarse());
            let mut plane = vec![0.0; side * side];
            for (&channel, out) in shown.zip(buffer.chunks_exact_mut(side * side)) {
                match channel {
                    Channel::Level => plane.copy_from_slice(&measured.level),
                    Channel::Weight => plane.copy_from_slice(&measured.weight),
                    Channel::Location => plane.copy_from_slice(&self.location),
                    Channel::Permissible => self.permissible(world, center, &mut plane),
                    Channel::Visited => {
                        plane.fill(0.0);
                        let visited = measurements.iter().map(|measured| measured.cell - center);
                        let half = self.half();
                        for by in visited.filter(|by| by.reach() <= half) {
                            plane
                                [((by.row + half) as usize) * side + (by.column + half) as usize] =
                                1.0;
                        }
                    }
                    Channel::Occupied | Channel::Beyond | Channel::Height => {
                        buildings(world, channel, center, step, &mut plane);
                    }
                }
                symmetry.copy(&plane, out, side);
            }
        }
    }

    /// Levels and weights at cells `step` apart, 0 beyond the map.
    fn measured(&self, state: State<'_>, center: Cell, side: usize, step: i32) -> Measured {
        let State { world, measurements, .. } = state;
        let [mut level, mut weight] = [(); 2].map(|()| vec![0.0; side * side]);
        let (half, n) = (side as i32 / 2, self.cells as i32);
        // The first and the last column inside the map.
        let first = (-(center.column / step)).max(-half);
        let last = ((n - 1 - center.column) / step).min(half);
        for row in -half..=half {
            let map_row = center.row + row * step;
            if !(0..n).contains(&map_row) {
                continue;
            }
            let begin = ((row + half) * side as i32 + half + first) as usize;
            let range = begin..begin + (last - first + 1) as usize;
            let (levels, weights) = (&mut level[range.clone()], &mut weight[range]);
            for measurement in measurements {
                let above = measurement.rsrp_dbm - world.threshold_dbm();
                let z = above / LEVEL_SCALE_DB;
                let Cell { row, column } = measurement.cell;
                let at = (map_row - row + n - 1) * (2 * n - 1) + n - 1;
                let at = at + center.column + first * step - column;
                let decay = self.decay[at as usize..].iter().step_by(step as usize);
                for ((level, weight), decay) in levels.iter_mut().zip(&mut *weights).zip(decay) {
                    *level += z * decay;
                    *weight += decay;
                }
            }
            levels.iter_mut().zip(weights).for_each(|(level, weight)| *level /= *weight);
        }
        Measured { level, weight }
    }

    /// 1 for permissible moves.
    fn permissible(&self, world: &World, center: Cell, plane: &mut [f32]) {
        plane.fill(0.0);
        let (actions, half) = (self.actions(), self.half());
        let side = 2 * half + 1;
        for action in self.sight.permissible(world, center).iter() {
            let by = actions.offset(action);
            plane[((by.row + half) * side + by.column + half) as usize] = 1.0;
        }
    }
}

/// Writes what the buildings are like in blocks of `step` × `step` cells around a cell: means over the
/// cells of a block, of which those beyond the map are occupied and of no height.
fn buildings(world: &World, channel: Channel, center: Cell, step: i32, plane: &mut [f32]) {
    let (n, side) = (world.cells(), plane.len().isqrt());
    let (heights, occupied) = (world.heights(), world.occupied());
    let corner = (side as i32 / 2) * step + step / 2;
    // The cells of each row or column of blocks that lie in the map.
    let inside = |center: i32| -> Vec<Range<usize>> {
        let bound = |at: i32| at.clamp(0, n as i32) as usize;
        let firsts = (0..side as i32).map(|block| center - corner + block * step);
        firsts.map(|first| bound(first)..bound(first + step)).collect()
    };
    let (rows, columns) = (inside(center.row), inside(center.column));
    let area = (step * step) as f32;
    for (rows, out) in rows.iter().zip(plane.chunks_exact_mut(side)) {
        for (columns, out) in columns.iter().zip(out) {
            let mut sum = 0.0;
            for row in rows.clone() {
                let cells = row * n + columns.start..row * n + columns.end;
                sum += match channel {
                    Channel::Occupied => {
                        occupied[cells].iter().map(|&it| f32::from(u8::from(it))).sum()
                    }
                    Channel::Height => heights[cells]
                        .iter()
                        .map(|height| (height.max(0.0) / HEIGHT_SCALE_M).sqrt())
                        .sum::<f32>(),
                    _ => 0.0,
                };
            }
            let beyond = area - (rows.len() * columns.len()) as f32;
            *out = (if channel == Channel::Height { sum } else { sum + beyond }) / area;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::flight::Measurement;
    use crate::rl::symmetry::Symmetry;
    use crate::rl::world::tests::world;

    const MAP: &str = ".#..o\n.....\n..#..\no....\n.....";

    struct Encoded {
        map: Vec<f32>,
        window: Vec<f32>,
    }

    impl Encoded {
        /// A channel of the window `by` cells from the UAV.
        fn at(&self, channel: Channel, by: (i32, i32)) -> f32 {
            let side = 2 * (2 + CONTEXT as i32) + 1;
            let place = (by.0 + side / 2) * side + by.1 + side / 2;
            self.window[channel as usize * (side * side) as usize + place as usize]
        }
    }

    fn encode(measurements: &[Measurement], symmetry: Symmetry) -> Encoded {
        let world = world(MAP, 2);
        let config = RlConfig { reach_cells: 2, ..RlConfig::default() };
        let encoder = CenteredEncoder::new(5, &config, &Channel::ALL);
        let [map, window] = encoder.shapes().map(|shape| vec![f32::NAN; shape.iter().product()]);
        let mut encoded = Encoded { map, window };
        let state = State { world: &world, measurements, symmetry };
        encoder.encode(state, &mut encoded.map, &mut encoded.window);
        encoded
    }

    fn measured(row: i32, column: i32, rsrp_dbm: f32) -> Measurement {
        Measurement { cell: Cell::new(row, column), rsrp_dbm }
    }

    /// The UAV stands at (1, 3), having come from (3, 1).
    #[test]
    fn channels_by_hand() {
        let visits = [measured(3, 1, -90.0), measured(1, 3, -60.0)];
        let seen = encode(&visits, Symmetry::IDENTITY);
        assert!(seen.map.iter().chain(&seen.window).all(|value| value.is_finite()));
        let flags = |channel, by: [(i32, i32); 4]| by.map(|by| seen.at(channel, by));
        // A building, the free cell beside it, two cells beyond the map.
        let by = [(-1, -2), (-1, -1), (-2, 0), (0, 2)];
        assert_eq!(flags(Channel::Occupied, by), [1.0, 0.0, 1.0, 1.0]);
        assert_eq!(flags(Channel::Beyond, by), [0.0, 0.0, 1.0, 1.0]);
        let height = (10.0_f32 / 4.0).sqrt();
        assert_eq!(flags(Channel::Height, by), [height, 0.0, 0.0, 0.0]);
        // To stay, east, into the building, beyond it.
        let by = [(0, 0), (0, 1), (1, -1), (2, -2)];
        assert_eq!(flags(Channel::Permissible, by), [1.0, 1.0, 0.0, 0.0]);
        assert_eq!(flags(Channel::Visited, by), [1.0, 0.0, 0.0, 1.0]);
        // 40 and 10 dB above the threshold: 2 and 0.5, √8 cells apart.
        let far = 2_f32.powf(-0.1 * 8_f32.sqrt());
        let close = |found: f32, expected: f32| assert!((found - expected).abs() < 1e-6);
        close(seen.at(Channel::Weight, (0, 0)), 1.0 + far);
        close(seen.at(Channel::Level, (0, 0)), (2.0 + 0.5 * far) / (1.0 + far));
        close(seen.at(Channel::Level, (2, -2)), (2.0 * far + 0.5) / (1.0 + far));
        assert_eq!(seen.at(Channel::Weight, (-2, 0)), 0.0);
        close(seen.at(Channel::Location, (0, 2)), 2_f32.powf(-0.2));
    }

    /// Blocks of a map that is smaller than they are many are its cells.
    #[test]
    fn blocks_hold_the_map() {
        let encoded = encode(&[measured(1, 3, -60.0)], Symmetry::IDENTITY);
        let area = BLOCKS * BLOCKS;
        let sum = |channel: usize| encoded.map[channel * area..][..area].iter().sum::<f32>();
        assert_eq!((sum(0), sum(1)), ((area - 25 + 2) as f32, (area - 25) as f32));
        let encoder = CenteredEncoder::new(121, &RlConfig::default(), &Channel::ALL);
        assert_eq!((encoder.block, encoder.shapes()), (5, [[5, 49, 49], [8, 61, 61]]));
    }

    /// A block of several cells holds their mean: whatever the place of the UAV, shares add up to
    /// the map's.
    #[test]
    fn blocks_are_means() {
        let rows: Vec<String> = (0..60)
            .map(|row| (0..60).map(|c| if (row * c) % 7 == 3 { '#' } else { '.' }).collect())
            .collect();
        let world = world(&rows.join("\n"), 2);
        let occupied = (0..3600).filter(|&at| world.is_occupied(world.cell(at))).count() as f32;
        for center in [Cell::new(0, 0), Cell::new(59, 59), Cell::new(31, 8)] {
            let mut planes = [Channel::Occupied, Channel::Beyond].map(|channel| {
                let mut plane = vec![0.0; BLOCKS * BLOCKS];
                buildings(&world, channel, center, 3, &mut plane);
                plane.iter().sum::<f32>() * 9.0
            });
            planes[0] -= planes[1];
            let blocks = (BLOCKS * BLOCKS * 9) as f32;
            assert!((planes[1] - (blocks - 3600.0)).abs() < 0.5, "{planes:?}");
            assert!((planes[0] - occupied).abs() < 0.5, "{planes:?}");
        }
    }

    /// Turning the state is turning what is seen of it.
    #[test]
    fn turned_states_are_turned_encodings() {
        let visits = [measured(3, 1, -90.0), measured(1, 3, -60.0)];
        let straight = encode(&visits, Symmetry::IDENTITY);
        let side = 2 * (2 + CONTEXT as usize) + 1;
        for symmetry in (0..Symmetry::COUNT).map(Symmetry::new) {
            let turned = encode(&visits, symmetry);
            for (side, straight, turned) in
                [(BLOCKS, &straight.map, &turned.map), (side, &straight.window, &turned.window)]
            {
                let channels =
                    straight.chunks_exact(side * side).zip(turned.chunks_exact(side * side));
                for (straight, turned) in channels {
                    let mut expected = vec![0.0; side * side];
                    symmetry.copy(straight, &mut expected, side);
                    assert_eq!(expected, turned, "{symmetry:?}");
                }
            }
        }
    }
}
