//! Coverage holes by distance to the nearest wall, of all records together.

use std::fmt::Write;

use crate::config::RlConfig;
use crate::dataset::{Grids, Record};
use crate::evaluate::{DistanceCount, by_distance};
use crate::rl::{Cell, World};

/// Where classes of distances begin, in metres; each ends where the next one begins.
const FROM_M: [f64; 6] = [0.0, 4.0, 8.0, 16.0, 32.0, 64.0];

/// Outdoor cells in each class, and those of them that are holes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct WallCounts([DistanceCount; FROM_M.len()]);

impl WallCounts {
    /// Those of a record; none if it has no wall.
    pub(super) fn of(record: &Record, grids: &Grids) -> Self {
        let world = World::new(record, grids, &RlConfig::default());
        Self::in_world(&world)
    }

    fn in_world(world: &World) -> Self {
        let mut counts = Self::default();
        let outdoors: Vec<Cell> =
            world.free_cells().into_iter().filter(|&cell| world.is_outdoors(cell)).collect();
        let found = by_distance(world, &outdoors, &FROM_M, None);
        counts.0.iter_mut().zip(found).for_each(|(count, found)| *count = found);
        counts
    }

    pub(super) fn add(&mut self, more: &Self) {
        for (sum, more) in self.0.iter_mut().zip(more.0) {
            sum.cells += more.cells;
            sum.holes += more.holes;
        }
    }

    /// A table in Markdown.
    pub(super) fn table(&self) -> String {
        let mut text = String::from(
            "| distance to the nearest wall | outdoor cells | coverage holes |\n|---|---|---|\n",
        );
        for (class, &DistanceCount { cells, holes, .. }) in self.0.iter().enumerate() {
            let (from, to) = (FROM_M[class], FROM_M.get(class + 1));
            let distances = match to {
                Some(to) => format!("{from} to {to} m"),
                None => format!("{from} m or more"),
            };
            let share = if cells == 0 {
                String::from("–")
            } else {
                format!("{:.1} %", 100.0 * holes as f64 / cells as f64)
            };
            writeln!(text, "| {distances} | {cells} | {share} |")
                .expect("writing to a string cannot fail");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::drawn_world as world;

    /// Cells of 4 m: 2 and 2.83 m from the wall, 6 and 6.3 m, 8.5 m in the corners.
    #[test]
    fn cells_and_holes_are_counted_by_their_distance() {
        let one = WallCounts::in_world(&world("o...o\n.....\n.o#o.\n.....\n.....", 2));
        let counts = one.0.map(|count| (count.cells, count.holes));
        assert_eq!(counts[..3], [(8, 2), (12, 0), (4, 2)]);
        let mut both = one;
        both.add(&one);
        let table = both.table();
        assert!(table.contains("| 0 to 4 m | 16 | 25.0 % |\n"), "{table}");
        assert!(table.contains("| 64 m or more | 0 | – |\n"), "{table}");
    }

    #[test]
    fn a_map_without_walls_counts_nothing() {
        assert_eq!(WallCounts::in_world(&world("o..\n...\n...", 2)), WallCounts::default());
    }
}
