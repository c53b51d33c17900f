//! A geometric heuristic: fly to the nearest cell that a building hides from the base station.
//!
//! It needs to be told where the base station is, which the paper's UAV is not, and uses no
//! measurement but to turn away from cells that proved to be covered.

use super::walk::random_cell;
use super::{Policy, View, each};
use crate::rl::cell::Cell;
use crate::rl::world::World;

/// Cells within this reach of a measured one are not looked for again.
const SEARCHED: i32 = 2;
/// Points looked at for each cell along a ray.
const POINTS_PER_CELL: f64 = 2.0;

/// Looks for shadows on one map.
#[derive(Debug, Clone)]
pub struct ShadowSeeker {
    shadows: Vec<Cell>,
    in_shadow: Vec<bool>,
    cells: usize,
}

impl ShadowSeeker {
    /// For a map as the UAV has it stored.
    #[must_use]
    pub fn new(known: &World) -> Self {
        let hidden: Vec<Cell> =
            known.free_cells().into_iter().filter(|&cell| is_hidden(known, cell)).collect();
        let mut in_shadow = vec![false; known.cells() * known.cells()];
        for &cell in &hidden {
            in_shadow[known.index(cell)] = true;
        }
        Self { shadows: hidden, in_shadow, cells: known.cells() }
    }

    /// The nearest permissible shadow that was not searched yet; else the permissible cell that
    /// is nearest to one farther away.
    fn next(&self, view: &View<'_, '_>) -> Option<Cell> {
        let flight = view.flight;
        let (from, actions) = (flight.cell(), flight.sight().actions());
        let fresh = |cell: Cell| {
            flight.measurements().iter().all(|seen| (seen.cell - cell).reach() > SEARCHED)
        };
        let squared = |a: Cell, b: Cell| (a - b).squared_length();
        let permissible = view.permissible();
        let reachable = || permissible.iter().map(|action| from + actions.offset(action));
        let hidden = reachable()
            .filter(|&cell| self.in_shadow[cell.row as usize * self.cells + cell.column as usize]);
        hidden.filter(|&cell| fresh(cell)).min_by_key(|&cell| squared(cell, from)).or_else(|| {
            let far = self.shadows.iter().filter(|&&cell| fresh(cell));
            let &goal = far.min_by_key(|&&cell| squared(cell, from))?;
            reachable().min_by_key(|&cell| squared(cell, goal)).filter(|&cell| cell != from)
        })
    }
}

impl Policy for ShadowSeeker {
    fn predict(&self, views: &mut [View<'_, '_>]) -> Vec<[f64; 2]> {
        each(views, |view| self.next(view).unwrap_or_else(|| random_cell(view)).center())
    }
}

/// Whether the straight line from the base station's antenna to a UAV over a cell runs through a
/// building of the map. What stands outside of the map is not known.
fn is_hidden(world: &World, cell: Cell) -> bool {
    let [row, column, antenna_m] = world.base_station();
    let from = cell.center();
    let way = [row - from[0], column - from[1]];
    let length = way[0].abs().max(way[1].abs());
    let points = (length * POINTS_PER_CELL).ceil();
    let up = antenna_m - world.flight_height_m();
    // The antenna itself stands on what is below it.
    (1..points as u32).map(|point| f64::from(point) / points).any(|u| {
        let cell = Cell::at([from[0] + u * way[0], from[1] + u * way[1]]);
        let height = world.flight_height_m() + u * up;
        world.contains(cell)
            && f64::from(world.height_m()[[cell.row as usize, cell.column as usize]]) > height
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use crate::rl::flight::Flight;
    use crate::rl::sight::Sight;
    use crate::rl::world::tests::world;

    /// The base station is 1 m east, 2 m north and 12 m up of the middle, cell (4, 4) of 9; a
    /// building of 10 m is too low to hide what is far behind it.
    const MAP: &str = ".........\n.........\n.........\n.........\n.........\n....##...\n.........\n.........\n.........";

    #[test]
    fn a_building_hides_what_is_right_behind_it() {
        let map = world(MAP, 4);
        let hidden = |row, column| is_hidden(&map, Cell::new(row, column));
        assert!(hidden(6, 4), "2 m + 10 m / 2.5 at the wall is below 10 m");
        assert!(!hidden(4, 4) && !hidden(3, 0));
    }

    #[test]
    fn the_nearest_shadow_is_taken_and_not_searched_twice() {
        let (map, sight) = (world(MAP, 4), Sight::new(4));
        let seeker = ShadowSeeker::new(&map);
        let mut flight = Flight::new(&map, &map, &sight, Cell::new(8, 4));
        let mut random = Random::keyed(&[]);
        let mut next = |flight: &Flight<'_>| {
            let view = View { flight, known: &map, random: &mut random };
            Cell::at(seeker.predict(&mut [view])[0])
        };
        let first = next(&flight);
        assert!(is_hidden(&map, first), "{first:?}");
        flight.step(first.center(), false, |_| true);
        let second = next(&flight);
        assert!((second - first).reach() > SEARCHED || !is_hidden(&map, second), "{second:?}");
    }
}
