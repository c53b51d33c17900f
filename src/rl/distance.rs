//! Exact distances to walls: the paper's `d_B`, and where holes lie.

use super::cell::Cell;
use super::world::World;

/// For each cell the square of twice its distance to the nearest occupied cell, in half cells:
/// from the cell's centre to the occupied cell's square, which is its wall. Row-major;
/// `None` if the map has no building. 0 for occupied cells.
///
/// Separable (Saito and Toriwaki, 1994): nearest wall along each column, then the minimum over the
/// columns, L³ operations in integers.
fn squared_half_cells(world: &World) -> Option<Vec<u32>> {
    let n = world.cells();
    // Centre to edge: half a cell less than from centre to centre.
    let to_edge = |cells: usize| if cells == 0 { 0 } else { 2 * cells as u32 - 1 };
    let mut along_column: Vec<Option<u32>> = vec![None; n * n];
    for column in 0..n {
        let occupied = |row: usize| world.is_occupied(Cell::new(row as i32, column as i32));
        let walls: Vec<usize> = (0..n).filter(|&row| occupied(row)).collect();
        for row in 0..n {
            let nearest = walls.iter().map(|wall| to_edge(wall.abs_diff(row))).min();
            along_column[row * n + column] = nearest.map(|half_cells| half_cells * half_cells);
        }
    }
    let rows = along_column.chunks_exact(n);
    let nearest = rows.flat_map(|row| {
        (0..n).map(move |column| {
            let through = row.iter().enumerate().filter_map(|(other, squared)| {
                let across = to_edge(other.abs_diff(column));
                squared.map(|squared| squared + across * across)
            });
            through.min()
        })
    });
    nearest.collect()
}

/// Distance of each cell's centre to the nearest wall in metres, row by row; 0 in occupied cells. `None`
/// if the map has no building.
#[must_use]
pub fn wall_distances_m(world: &World) -> Option<Vec<f64>> {
    let half_cell_m = world.cell_m() / 2.0;
    let distances = squared_half_cells(world)?.into_iter();
    Some(distances.map(|squared| libm::sqrt(f64::from(squared)) * half_cell_m).collect())
}

/// Free cells whose centres are at most so many metres from a wall, row by row.
#[must_use]
pub fn neighbourhood(world: &World, metres: f64) -> Vec<Cell> {
    let Some(distances) = squared_half_cells(world) else { return Vec::new() };
    let half_cells = 2.0 * metres / world.cell_m();
    let most = half_cells * half_cells * (1.0 + 1e-12);
    let cells = distances.iter().enumerate().filter(|&(_, &squared)| f64::from(squared) <= most);
    cells.map(|(at, _)| world.cell(at)).filter(|&cell| world.is_free(cell)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::world::tests::world;

    /// Cells of 4 m: the wall is 2 m from the centres beside it, 6 m from the next, and
    /// sqrt(2² + 2²) = 2.83 m from those across the corner.
    #[test]
    fn distances_are_to_the_wall_not_to_the_centre() {
        let world = world(".....\n.....\n..#..\n.....\n.....", 2);
        let metres = wall_distances_m(&world).expect("a wall");
        assert_eq!([metres[12], metres[11], metres[10]], [0.0, 2.0, 6.0]);
        assert!((metres[6] - 8.0_f64.sqrt()).abs() < 1e-12);
        let count = |metres| neighbourhood(&world, metres).len();
        assert_eq!([count(1.99), count(2.0), count(2.82), count(2.83)], [0, 4, 4, 8]);
        // sqrt(6² + 2²) = 6.32 m, sqrt(6² + 6²) = 8.49 m.
        assert_eq!([count(6.0), count(6.33), count(8.0), count(8.5)], [12, 20, 20, 24]);
    }

    #[test]
    fn distances_equal_those_to_all_walls() {
        let map = "...#..\n......\n.#....\n.##...\n......\n.....#";
        let world = world(map, 2);
        let found = squared_half_cells(&world).expect("there are walls");
        for (at, &found) in found.iter().enumerate() {
            let cell = world.cell(at);
            let to_edge = |a: i32, b: i32| (2 * (a - b).abs() - 1).max(0);
            let squared = |wall: Cell| {
                to_edge(wall.row, cell.row).pow(2) + to_edge(wall.column, cell.column).pow(2)
            };
            let walls = (0..36).map(|at| world.cell(at)).filter(|&wall| world.is_occupied(wall));
            assert_eq!(Some(found as i32), walls.map(squared).min());
        }
    }

    #[test]
    fn without_buildings_there_is_no_neighbourhood() {
        assert!(neighbourhood(&world("..\n..", 1), 100.0).is_empty());
    }
}
