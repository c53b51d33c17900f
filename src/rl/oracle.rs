//! The exact optimum: for each cell the least number of steps to a coverage hole.
//!
//! Breadth-first search over the graph of permissible moves, which is symmetric (a line of sight
//! is one in both directions), from all holes at once. No method can do better: whatever a UAV
//! predicts, pulled back or not, it moves along an edge of this graph.

use super::cell::Cell;
use super::sight::Sight;
use super::world::World;

/// Least steps to a hole, for all cells of a map.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Hops {
    cells: usize,
    hops: Vec<u16>,
}

const UNREACHABLE: u16 = u16::MAX;

impl Hops {
    /// Searches a map.
    #[must_use]
    pub fn new(world: &World, sight: &Sight) -> Self {
        let n = world.cells();
        let mut hops = vec![UNREACHABLE; n * n];
        let mut frontier = world.holes();
        for &hole in &frontier {
            hops[world.index(hole)] = 0;
        }
        let mut set = sight.empty();
        let mut next = Vec::new();
        for distance in 1.. {
            for &from in &frontier {
                sight.permissible_into(world, from, &mut set);
                for action in set.iter() {
                    let cell = from + sight.actions().offset(action);
                    let known = &mut hops[cell.row as usize * n + cell.column as usize];
                    if *known == UNREACHABLE {
                        *known = distance;
                        next.push(cell);
                    }
                }
            }
            if next.is_empty() {
                break;
            }
            frontier.clear();
            std::mem::swap(&mut frontier, &mut next);
        }
        Self { cells: n, hops }
    }

    /// Least number of steps from a cell of the map, 0 for a hole; `None` if no hole can be
    /// reached, or the cell is occupied.
    #[must_use]
    pub fn from(&self, cell: Cell) -> Option<u16> {
        let hops = self.hops[cell.row as usize * self.cells + cell.column as usize];
        (hops != UNREACHABLE).then_some(hops)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::world::tests::world;

    #[test]
    fn hops_by_hand() {
        // A wall with a gap in the south; reach 2.
        let world = world("..#..\n..#.o\n..#..\n..#..\n.....", 2);
        let hops = Hops::new(&world, &Sight::new(2));
        let from = |row, column| hops.from(Cell::new(row, column));
        assert_eq!(from(1, 4), Some(0));
        assert_eq!([from(0, 3), from(3, 3), from(4, 4)], [Some(1), Some(1), Some(2)]);
        assert_eq!(from(1, 2), None, "occupied");
        // Through the gap: (4, 1) - (4, 3) - (2, 3) or (3, 3) - (1, 4).
        assert_eq!([from(4, 3), from(4, 1), from(2, 1)], [Some(2), Some(3), Some(4)]);
    }

    #[test]
    fn courtyards_without_a_hole_are_unreachable() {
        let world = world("..####\n..#..#\n..#..#\n.o####\n......\n......", 3);
        let hops = Hops::new(&world, &Sight::new(3));
        assert_eq!((hops.from(Cell::new(1, 3)), hops.from(Cell::new(0, 0))), (None, Some(1)));
    }
}
