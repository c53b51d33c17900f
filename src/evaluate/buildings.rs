//! What a map is built up with, from its occupied cells: records do not tell the types of buildings.

use crate::rl::{Cell, World, neighbours};

/// How much stands on a map, how high, and how large.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Buildings {
    /// Occupied cells as a share of all, 0 to 1.
    pub(super) share: f64,
    /// Mean height of occupied cells, in metres.
    pub(super) mean_height_m: f64,
    /// Mean footprint that an occupied cell belongs to, in m²: houses of 100 m² beside a hall of
    /// 10,000 m² on a map half of both make 5,050 m². Occupied cells that share a side are one footprint.
    pub(super) mean_footprint_m2: f64,
}

/// The buildings of a map.
pub(super) fn buildings(world: &World) -> Buildings {
    let all = world.cells() * world.cells();
    let mut seen = vec![false; all];
    let (mut occupied, mut squares, mut heights) = (0, 0, 0.0);
    for at in 0..all {
        let cells = footprint(world, world.cell(at), &mut seen);
        occupied += cells.len();
        squares += cells.len() * cells.len();
        heights += cells.iter().map(|&at| f64::from(world.heights()[at])).sum::<f64>();
    }
    let each = occupied.max(1) as f64;
    Buildings {
        share: occupied as f64 / all.max(1) as f64,
        mean_height_m: heights / each,
        mean_footprint_m2: squares as f64 * world.cell_m().powi(2) / each,
    }
}

/// The cells of the footprint at a cell, by index; none if it is free or was seen already.
fn footprint(world: &World, cell: Cell, seen: &mut [bool]) -> Vec<usize> {
    let (mut left, mut found) = (vec![cell], Vec::new());
    while let Some(cell) = left.pop() {
        if world.is_occupied(cell) && !std::mem::replace(&mut seen[world.index(cell)], true) {
            found.push(world.index(cell));
            left.extend(neighbours(cell));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::drawn_world as world;

    #[test]
    fn footprints_are_cells_that_share_a_side() {
        let found = buildings(&world("##..\n##.#\n..#.\n....", 3));
        let area = found.mean_footprint_m2;
        // Four cells of a footprint of four, two of one each; the last two meet in a corner.
        assert!((area - 16.0 * (4.0 * 4.0 + 1.0 + 1.0) / 6.0).abs() < 1e-9, "{area}");
        assert!((found.share - 6.0 / 16.0).abs() < 1e-12);
        assert!(found.mean_height_m > 2.0);
        assert_eq!(buildings(&world("..\n..", 3)), Buildings::default());
    }
}
