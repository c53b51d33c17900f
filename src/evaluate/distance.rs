//! Where holes lie: the paper's second claim is that they are close to walls.

use super::bootstrap::Bootstrap;
use super::report::DistanceFigures;
use crate::rl::{Cell, World, wall_distances_m};

/// Where classes of distances begin, in metres; each ends where the next one begins.
pub(super) const FROM_M: [f64; 11] =
    [0.0, 4.0, 8.0, 12.0, 16.0, 20.0, 24.0, 32.0, 48.0, 64.0, 96.0];

/// Outdoor cells of a map in one class of distances.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct DistanceCount {
    pub(crate) cells: u64,
    pub(crate) holes: u64,
    /// Sum of the chances to be a hole, if the map tells.
    pub(crate) expected: Option<f64>,
}

/// Counts the outdoor cells of a map by classes of distances, which begin at `from_m` (the first at 0); none if it
/// has no wall.
pub(crate) fn by_distance(
    world: &World,
    outdoors: &[Cell],
    from_m: &[f64],
    chance: Option<&dyn Fn(Cell) -> f64>,
) -> Vec<DistanceCount> {
    let Some(distances) = wall_distances_m(world) else { return Vec::new() };
    let empty = DistanceCount { expected: chance.map(|_| 0.0), ..DistanceCount::default() };
    let mut counts = vec![empty; from_m.len()];
    for &cell in outdoors {
        let distance = distances[world.index(cell)];
        let class = from_m.partition_point(|&from| from <= distance) - 1;
        let count = &mut counts[class];
        count.cells += 1;
        count.holes += u64::from(world.is_hole(cell));
        if let (Some(sum), Some(chance)) = (&mut count.expected, chance) {
            *sum += chance(cell);
        }
    }
    counts
}

/// The classes of all maps together, from what [`by_distance`] counted on each.
pub(super) fn figures(maps: &[&[DistanceCount]], bootstrap: &Bootstrap) -> Vec<DistanceFigures> {
    let class = |at: usize| {
        let of_maps = |value: &dyn Fn(&DistanceCount) -> Option<f64>| {
            let values = maps.iter().map(|map| value(map.get(at)?));
            values.collect::<Vec<_>>()
        };
        let counts = || maps.iter().filter_map(|map| map.get(at));
        let cells = of_maps(&|count| Some(count.cells as f64));
        let holes = of_maps(&|count| Some(count.holes as f64));
        let expected = of_maps(&|count| count.expected);
        DistanceFigures {
            from_m: FROM_M[at],
            to_m: FROM_M.get(at + 1).copied(),
            cells: counts().map(|count| count.cells).sum(),
            holes: counts().map(|count| count.holes).sum(),
            hole_share: bootstrap.ratio(&holes, &cells),
            expected_hole_share: bootstrap.ratio(&expected, &cells),
        }
    };
    (0..FROM_M.len()).map(class).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::drawn_world as world;

    /// Cells of 4 m: 2 and 2.83 m from the wall, 6 and 6.3 m, 8.5 m in the corners.
    #[test]
    fn cells_and_holes_are_counted_by_their_distance() {
        let world = world("o...o\n.....\n.o#o.\n.....\n.....", 2);
        let outdoors: Vec<Cell> = world.free_cells();
        let counts = by_distance(&world, &outdoors, &FROM_M, None);
        let of = |at: usize| (counts[at].cells, counts[at].holes);
        assert_eq!([of(0), of(1), of(2), of(3)], [(8, 2), (12, 0), (4, 2), (0, 0)]);
        assert_eq!(counts[0].expected, None);
        let chance = |_: Cell| 0.25;
        let counts = by_distance(&world, &outdoors, &FROM_M, Some(&chance));
        assert_eq!([counts[1].expected, counts[3].expected], [Some(3.0), Some(0.0)]);
        let figures = figures(&[&counts, &[]], &Bootstrap::new(2, 100, 1));
        assert_eq!((figures[2].from_m, figures[2].to_m, figures[10].to_m), (8.0, Some(12.0), None));
        assert_eq!(figures[2].hole_share.map(|share| share.mean), Some(0.5));
        assert_eq!(figures[2].expected_hole_share.map(|share| share.mean), Some(0.25));
        assert_eq!((figures[3].cells, figures[3].hole_share), (0, None));
    }
}
