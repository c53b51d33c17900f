//! What is known of a cell before any flight: the buildings around it, and how it lies to the base station.

use crate::rl::{Cell, World, wall_distances_m};

/// Eight directions, as rows and columns.
const COMPASS: [(i32, i32); 8] =
    [(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)];
/// Cells that are looked at in each of them.
const VIEW: i32 = 40;
/// Sides of the squares over which built shares, mean heights and greatest heights are taken.
const SHARES: [usize; 4] = [3, 7, 15, 31];
const MEANS: [usize; 3] = [3, 7, 15];
const GREATEST: [usize; 2] = [5, 15];
/// Points of the line to the base station that are looked at.
const LINE: usize = 80;

/// Some values of each cell of a map.
#[derive(Debug)]
pub(super) struct Surroundings {
    columns: usize,
    /// `[cells, columns]`, row by row.
    values: Vec<f32>,
}

impl Surroundings {
    /// The values of a cell, by its index.
    pub(super) fn of(&self, index: usize) -> &[f32] {
        &self.values[index * self.columns..][..self.columns]
    }

    /// Puts columns of all cells side by side.
    fn join(columns: &[Vec<f32>]) -> Self {
        let cells = columns.first().map_or(0, Vec::len);
        let values = (0..cells).flat_map(|at| columns.iter().map(move |column| column[at]));
        Self { columns: columns.len(), values: values.collect() }
    }
}

/// How buildings lie around each cell: the distance to a wall; in eight directions the distance to a
/// building, in cells, and its height; and in squares of several sizes the built share, the mean and the
/// greatest height.
pub(super) fn buildings(world: &World) -> Surroundings {
    let n = world.cells();
    let far = (n as f64) * world.cell_m();
    let walls = wall_distances_m(world).unwrap_or_else(|| vec![far; n * n]);
    let mut columns = vec![walls.into_iter().map(|metres| metres as f32).collect()];
    for step in COMPASS {
        columns.extend(looking(world, step));
    }
    let built: Vec<f64> =
        cells(world).map(|at| f64::from(u8::from(world.is_occupied(at)))).collect();
    let heights: Vec<f64> = world.heights().iter().copied().map(f64::from).collect();
    let [built, sums] = [built, heights].map(|values| ColumnSums::new(&values, n));
    columns.extend(SHARES.map(|side| built.means(side)));
    columns.extend(MEANS.map(|side| sums.means(side)));
    columns.extend(GREATEST.map(|side| greatest(world.heights(), n, side)));
    Surroundings::join(&columns)
}

/// How each cell lies to the base station: the distance; whether the line to it is blocked, over how many
/// cells, by how many metres at most, how far before the cell it is so last, and by how many walls; the
/// base station's height and elevation.
pub(super) fn station(world: &World) -> Surroundings {
    let [row, column, z] = world.base_station();
    let (n, ground) = (world.cells() as f64, world.flight_height_m());
    let heights = world.heights();
    let values = cells(world).flat_map(|cell| {
        let [down, across] = [f64::from(cell.row) - row, f64::from(cell.column) - column];
        let distance = libm::hypot(down, across);
        let (mut blocked, mut last, mut walls, mut excess) = (0, None, 0, f64::NEG_INFINITY);
        let mut was_blocked = false;
        for point in 0..LINE {
            let t = 0.01 + 0.98 * point as f64 / (LINE - 1) as f64;
            let on_map = |at: f64| at.round().clamp(0.0, n - 1.0) as usize;
            let at = on_map(row + down * t) * world.cells() + on_map(column + across * t);
            let over = f64::from(heights[at]) - (z + (ground - z) * t);
            excess = excess.max(over);
            let is_blocked = over > 0.0;
            walls += u32::from(is_blocked && !was_blocked && point > 0);
            if is_blocked {
                (blocked, last) = (blocked + 1, Some(t));
            }
            was_blocked = is_blocked;
        }
        let elevation = libm::atan2(z - ground, distance * world.cell_m());
        let values = [
            distance,
            f64::from(u8::from(blocked > 0)),
            f64::from(blocked) / LINE as f64 * distance,
            excess,
            last.map_or(n, |t| (1.0 - t) * distance),
            z,
            elevation,
            f64::from(walls),
        ];
        values.map(|value| value as f32)
    });
    Surroundings { columns: 8, values: values.collect() }
}

/// All cells, row by row.
fn cells(world: &World) -> impl Iterator<Item = Cell> {
    (0..world.cells() * world.cells()).map(|at| world.cell(at))
}

/// For each cell the distance to the next building in a direction, in steps, and its height.
fn looking(world: &World, (rows, columns): (i32, i32)) -> [Vec<f32>; 2] {
    let mut found = [(); 2].map(|()| Vec::with_capacity(world.cells() * world.cells()));
    for cell in cells(world) {
        let steps = (1..=VIEW).map(|s| (s, cell + Cell::new(rows * s, columns * s)));
        let mut steps = steps.take_while(|&(_, at)| world.contains(at));
        let hit = steps.find(|&(_, at)| world.is_occupied(at));
        let (steps, height) =
            hit.map_or((VIEW, 0.0), |(steps, at)| (steps, world.heights()[world.index(at)]));
        found[0].push(steps as f32);
        found[1].push(height);
    }
    found
}

/// Sums over rectangles that begin at the corner of a map (a summed-area table).
pub(super) struct ColumnSums {
    cells: usize,
    /// `[cells + 1, cells + 1]`.
    sums: Vec<f64>,
}

impl ColumnSums {
    /// Of values of all cells, row by row.
    pub(super) fn new(values: &[f64], cells: usize) -> Self {
        let side = cells + 1;
        let mut sums = vec![0.0; side * side];
        for (row, values) in values.chunks_exact(cells).enumerate() {
            let mut along = 0.0;
            for (column, value) in values.iter().enumerate() {
                along += value;
                sums[(row + 1) * side + column + 1] = sums[row * side + column + 1] + along;
            }
        }
        Self { cells, sums }
    }

    /// The sum over the square of `side` cells (an odd number) around a cell, as much as lies on the map.
    pub(super) fn around(&self, cell: Cell, side: usize) -> f64 {
        let (half, n) = ((side / 2) as i32, self.cells as i32);
        let ends = |at: i32| [at - half, at + half + 1].map(|at| at.clamp(0, n) as usize);
        let ([top, bottom], [left, right]) = (ends(cell.row), ends(cell.column));
        let at = |row: usize, column: usize| self.sums[row * (self.cells + 1) + column];
        at(bottom, right) - at(top, right) - at(bottom, left) + at(top, left)
    }

    /// The mean over the squares around all cells; what lies beyond the map counts as 0.
    fn means(&self, side: usize) -> Vec<f32> {
        let n = self.cells;
        let cells = (0..n * n).map(|at| Cell::new((at / n) as i32, (at % n) as i32));
        cells.map(|cell| (self.around(cell, side) / (side * side) as f64) as f32).collect()
    }
}

/// The greatest value in the squares of `side` cells around all cells: along rows, then along columns.
fn greatest(values: &[f32], n: usize, side: usize) -> Vec<f32> {
    let half = side / 2;
    let along = |values: &[f32], at: &dyn Fn(usize, usize) -> usize| {
        let mut out = vec![0.0; n * n];
        for line in 0..n {
            for place in 0..n {
                let near = place.saturating_sub(half)..(place + half + 1).min(n);
                out[at(line, place)] = near.map(|near| values[at(line, near)]).fold(0.0, f32::max);
            }
        }
        out
    };
    let rows = along(values, &|row, column| row * n + column);
    along(&rows, &|column, row| row * n + column)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::drawn_world as world;

    const MAP: &str = ".....\n.#...\n.....\n.....\n...#.";

    fn of(surroundings: &Surroundings, world: &World, row: i32, column: i32) -> Vec<f32> {
        surroundings.of(world.index(Cell::new(row, column))).to_vec()
    }

    /// Buildings of 10 m at (1, 1) and (4, 3); cells of 4 m.
    #[test]
    fn buildings_by_hand() {
        let world = world(MAP, 2);
        let all = buildings(&world);
        let cell = of(&all, &world, 1, 3);
        let (cell_m, height) = (world.cell_m() as f32, world.heights()[6]);
        assert_eq!(cell[0], 1.5 * cell_m, "from the centre to the wall");
        // East, south-east, south, south-west, west, as distance and height.
        let view = VIEW as f32;
        assert_eq!(cell[1..11], [view, 0.0, view, 0.0, 3.0, height, view, 0.0, 2.0, height]);
        assert_eq!(cell[17..21], [0.0, 2.0 / 49.0, 2.0 / 225.0, 2.0 / 961.0]);
        assert_eq!(cell[21..24], [0.0, 2.0 * height / 49.0, 2.0 * height / 225.0]);
        assert_eq!(cell[24..], [height, height]);
        assert_eq!(of(&all, &world, 1, 2)[17], 1.0 / 9.0);
    }

    #[test]
    fn lines_to_the_base_station() {
        let world = world(MAP, 2);
        let all = station(&world);
        let [row, column, z] = world.base_station().map(|value| value as f32);
        for (at, cell) in cells(&world).enumerate() {
            let found = all.of(at);
            let distance = (cell.row as f32 - row).hypot(cell.column as f32 - column);
            assert!((found[0] - distance).abs() < 1e-4 && found[5] == z);
            assert_eq!(found[1] > 0.0, found[3] > 0.0, "blocked is what is too high");
            assert_eq!(found[1] > 0.0, found[2] > 0.0);
        }
        assert!((0..25).any(|at| all.of(at)[1] > 0.0) && (0..25).any(|at| all.of(at)[1] == 0.0));
    }

    #[test]
    fn sums_end_at_the_edges() {
        let values: Vec<f64> = (1..=9).map(f64::from).collect();
        let sums = ColumnSums::new(&values, 3);
        assert_eq!(sums.around(Cell::new(1, 1), 3), 45.0);
        assert_eq!(sums.around(Cell::new(0, 2), 3), 2.0 + 3.0 + 5.0 + 6.0);
        assert_eq!(sums.around(Cell::new(2, 0), 1), 7.0);
    }
}
