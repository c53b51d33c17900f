//! What stands between a base station and each cell, in classes that a model can count.
//!
//! Lines run from the base station's cell to every cell of the map's border, a step in each row or column; along
//! a line the greatest slope so far is the edge over which a path must bend. A cell that several lines cross
//! has the values of the one that passes nearest to its centre. Displacements are rounded, not positions, so that a map
//! that is turned or mirrored has the same shadows, turned or mirrored.

use crate::rl::cell::Cell;
use crate::rl::world::World;

/// Where classes of distances to the base station begin, after the first, in metres.
const DISTANCE_M: [f32; 13] =
    [8.0, 16.0, 28.0, 44.0, 64.0, 90.0, 120.0, 155.0, 195.0, 240.0, 290.0, 350.0, 420.0];
/// Tangents of 0, 1, 2.5, 5, 9, 15, 25 and 40 degrees: where classes of the angle by which a path bends
/// over the highest edge begin, after that of paths that do not bend.
const BENDING: [f32; 8] = [
    0.0,
    0.017_455_065,
    0.043_660_94,
    0.087_488_66,
    0.158_384_44,
    0.267_949_2,
    0.466_307_67,
    0.839_099_6,
];
/// Where classes of the distance since the last building begin, after the first, in metres.
const SINCE_M: [f32; 4] = [6.0, 14.0, 30.0, 62.0];

const ANGLES: usize = BENDING.len() + 1;
const SINCE: usize = SINCE_M.len() + 1;
/// Classes of angle and distance since a building.
pub(super) const OBSTACLES: usize = ANGLES * SINCE;
/// Classes of the distance to the base station.
pub(super) const DISTANCES: usize = DISTANCE_M.len() + 1;
/// All classes: `distance * OBSTACLES + obstacle`.
pub(super) const CLASSES: usize = DISTANCES * OBSTACLES;

/// The class of each cell of a map as seen from one place, row by row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shadows(Vec<u16>);

/// What the lines that cross a cell tell of it.
#[derive(Debug, Clone, Copy)]
struct Crossing {
    /// How far the line passes from the cell's centre, in cells.
    off: f32,
    /// The greatest slope before the cell.
    slope: f32,
    /// Metres since the last building; infinite if there was none.
    since: f32,
}

impl Shadows {
    /// As seen from an antenna `up_m` metres above the ground in a cell of the map; cells that are
    /// occupied block.
    #[must_use]
    pub fn new(world: &World, at: Cell, up_m: f32) -> Self {
        let n = world.cells() as i32;
        let beyond =
            Crossing { off: f32::INFINITY, slope: f32::NEG_INFINITY, since: f32::INFINITY };
        let mut crossings = vec![beyond; world.cells() * world.cells()];
        for k in 0..n {
            for border in [[0, k], [n - 1, k], [k, 0], [k, n - 1]] {
                walk(world, at, up_m, Cell::new(border[0], border[1]), &mut crossings);
            }
        }
        let receiver_m = world.flight_height_m() as f32;
        let class = |(index, crossing): (usize, &Crossing)| {
            let to = world.cell(index) - at;
            let far = length(to) * world.cell_m() as f32;
            let distance = count(&DISTANCE_M, far);
            let line = (receiver_m - up_m) / far.max(1.0);
            let angle = bending(crossing.slope, line);
            let since = if angle == 0 { 0 } else { count(&SINCE_M, crossing.since) };
            (distance * OBSTACLES + angle * SINCE + since) as u16
        };
        Self(crossings.iter().enumerate().map(class).collect())
    }

    /// The class of a cell, by its index.
    pub(super) fn class(&self, index: usize) -> usize {
        self.0[index].into()
    }
}

/// Distance in cells.
fn length(by: Cell) -> f32 {
    (by.squared_length() as f32).sqrt()
}

/// How many of some rising limits a value has reached.
fn count(limits: &[f32], value: f32) -> usize {
    limits.iter().filter(|&&limit| value >= limit).count()
}

/// The class of the angle between an edge's slope and that of the line to a receiver behind it: 0 if the line
/// passes over the edge.
fn bending(edge: f32, line: f32) -> usize {
    if edge <= line {
        return 0;
    }
    // tan(a - b); beyond a right angle the denominator is not positive.
    let denominator = 1.0 + edge * line;
    if denominator <= 0.0 {
        return BENDING.len();
    }
    count(&BENDING, (edge - line) / denominator).max(1)
}

/// Follows the line to a cell of the border.
fn walk(world: &World, at: Cell, up_m: f32, border: Cell, crossings: &mut [Crossing]) {
    let to = border - at;
    let steps = to.reach();
    let along = length(to) / steps.max(1) as f32 * world.cell_m() as f32;
    let (mut slope, mut last) = (f32::NEG_INFINITY, None);
    for step in 1..=steps {
        let part = step as f32 / steps as f32;
        let [rows, columns] = [to.row as f32 * part, to.column as f32 * part];
        let cell = at + Cell::new(rows.round() as i32, columns.round() as i32);
        let off = (rows - rows.round()).abs() + (columns - columns.round()).abs();
        let index = world.index(cell);
        let since = last.map_or(f32::INFINITY, |last| (step - last) as f32 * along);
        let known = &mut crossings[index];
        // Of two that pass alike the more blocked one, whatever their order.
        let is_nearer = off < known.off
            || (off == known.off
                && (slope > known.slope || (slope == known.slope && since < known.since)));
        if is_nearer {
            *known = Crossing { off, slope, since };
        }
        if world.occupied()[index] {
            slope = slope.max((world.heights()[index] - up_m) / (step as f32 * along));
            last = Some(step);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::symmetry::Symmetry;
    use crate::rl::world::tests::world;

    const MAP: &str = "........#\n.........\n..##.....\n..##.....\n.........\n.......#.\n.........\n.#.......\n.........";

    /// A building of 10 m (drawn maps have no other) 4 m before an antenna of 10 m hides what is behind it.
    #[test]
    fn what_is_behind_a_wall_lies_in_its_shadow() {
        let map = world(MAP, 4);
        let shadows = Shadows::new(&map, Cell::new(4, 2), 10.0);
        let angle =
            |row, column| shadows.class(map.index(Cell::new(row, column))) % OBSTACLES / SINCE;
        assert!(angle(1, 2) > 0 && angle(0, 2) > 0, "behind the block");
        assert_eq!((angle(4, 7), angle(8, 8), angle(4, 0)), (0, 0, 0), "nothing in between");
        let distance = |row, column| shadows.class(map.index(Cell::new(row, column))) / OBSTACLES;
        assert_eq!((distance(4, 2), distance(4, 4), distance(4, 8)), (0, 1, 2), "0, 8 and 24 m");
        let since = |row, column| shadows.class(map.index(Cell::new(row, column))) % SINCE;
        assert_eq!((since(1, 2), since(0, 2)), (0, 1), "4 m and 8 m after the wall");
    }

    /// Angles of a hand calculation: from 20 m, an edge of 15 m at 10 m hides a receiver of 2 m at 40 m.
    #[test]
    fn angles_are_those_between_edge_and_line() {
        let [edge, line] = [(15.0 - 20.0) / 10.0, (2.0 - 20.0) / 40.0];
        assert_eq!(bending(edge, line), 0, "-26.6 is below -24.2 degrees");
        assert_eq!(bending((18.0 - 20.0) / 10.0, line), 5, "-11.3 is 12.9 degrees above");
        assert_eq!(bending(5.0, -3.0), 8, "beyond a right angle");
        assert_eq!(bending(f32::NEG_INFINITY, line), 0);
    }

    #[test]
    fn a_map_turned_or_mirrored_has_its_shadows_turned_or_mirrored() {
        let (map, at) = (world(MAP, 4), Cell::new(5, 2));
        let here = Shadows::new(&map, at, 7.0);
        for symmetry in (0..Symmetry::COUNT).map(Symmetry::new) {
            let rows: Vec<&[u8]> = MAP.lines().map(str::as_bytes).collect();
            let n = rows.len();
            let mut turned = vec![b'.'; n * n];
            symmetry.copy(&rows.concat(), &mut turned, n);
            let lines =
                turned.chunks_exact(n).map(|line| std::str::from_utf8(line).expect("ASCII"));
            let other = world(&lines.collect::<Vec<_>>().join("\n"), 4);
            let there = Shadows::new(&other, symmetry.of(at, n), 7.0);
            for index in 0..n * n {
                let image = other.index(symmetry.of(map.cell(index), n));
                assert_eq!(here.class(index), there.class(image), "{symmetry:?} {index}");
            }
        }
    }
}
