//! Walks over permissible cells: at random, beside walls, and the shortest to a hole.

use super::{Policy, View, each};
use crate::rl::cell::Cell;
use crate::rl::oracle::Hops;
use crate::rl::world::World;

/// A permissible cell at random: what any method that learns must beat.
#[derive(Debug, Clone, Copy, Default)]
pub struct RandomWalk;

pub(super) fn random_cell(view: &mut View<'_, '_>) -> Cell {
    let count = view.permissible().count();
    let n = view.random.below(count);
    let action = view.permissible().nth(n).expect("to stay is permissible");
    view.flight.cell() + view.flight.sight().actions().offset(action)
}

impl Policy for RandomWalk {
    fn predict(&self, views: &mut [View<'_, '_>]) -> Vec<[f64; 2]> {
        each(views, |view| random_cell(view).center())
    }
}

/// A permissible cell beside a wall at random (one of its eight neighbours is occupied); any
/// permissible cell where there is none.
#[derive(Debug, Clone)]
pub struct WallWalk {
    cells: usize,
    beside: Vec<bool>,
}

impl WallWalk {
    /// For a map as the UAV has it stored.
    #[must_use]
    pub fn new(known: &World) -> Self {
        let cells = known.cells();
        let beside = |cell: Cell| {
            let around =
                (-1..=1).flat_map(|row| (-1..=1).map(move |column| Cell::new(row, column)));
            known.is_free(cell) && around.into_iter().any(|by| known.is_occupied(cell + by))
        };
        Self { cells, beside: (0..cells * cells).map(|at| beside(known.cell(at))).collect() }
    }
}

impl Policy for WallWalk {
    fn predict(&self, views: &mut [View<'_, '_>]) -> Vec<[f64; 2]> {
        each(views, |view| {
            let (from, actions) = (view.flight.cell(), view.flight.sight().actions());
            let beside: Vec<Cell> = view
                .permissible()
                .iter()
                .map(|action| from + actions.offset(action))
                .filter(|cell| self.beside[cell.row as usize * self.cells + cell.column as usize])
                .collect();
            if beside.is_empty() {
                random_cell(view).center()
            } else {
                beside[view.random.below(beside.len())].center()
            }
        })
    }
}

/// A shortest way to a hole, each step as near as possible; stays where no hole can be reached.
/// It knows everything: the bound of all methods.
#[derive(Debug, Clone, Copy)]
pub struct OptimalWay<'a> {
    hops: &'a Hops,
}

impl<'a> OptimalWay<'a> {
    /// By the least steps to a hole on the true map.
    #[must_use]
    pub fn new(hops: &'a Hops) -> Self {
        Self { hops }
    }
}

impl Policy for OptimalWay<'_> {
    fn predict(&self, views: &mut [View<'_, '_>]) -> Vec<[f64; 2]> {
        each(views, |view| {
            let (from, actions) = (view.flight.cell(), view.flight.sight().actions());
            let nearer = self.hops.from(from).and_then(|hops| hops.checked_sub(1));
            let Some(nearer) = nearer else { return from.center() };
            let moves = view.flight.permissible().iter().map(|action| actions.offset(action));
            let best = moves
                .filter(|&by| self.hops.from(from + by) == Some(nearer))
                .min_by_key(|by| by.squared_length())
                .expect("a cell of n hops is next to one of n - 1");
            (from + best).center()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use crate::rl::flight::Flight;
    use crate::rl::sight::Sight;
    use crate::rl::world::tests::world;

    fn predicted(policy: &dyn Policy, map: &World, sight: &Sight, from: Cell, seed: u64) -> Cell {
        let flight = Flight::new(map, map, sight, from);
        let random = &mut Random::keyed(&[seed]);
        let waypoints = policy.predict(&mut [View { flight: &flight, known: map, random }]);
        Cell::at(waypoints[0])
    }

    #[test]
    fn walks_stay_permissible_and_reach_everything_that_is() {
        let (map, sight) = (world(".....\n.###.\n.....\n.....\n....o", 4), Sight::new(4));
        let from = Cell::new(2, 2);
        let walls = WallWalk::new(&map);
        let mut seen = std::collections::BTreeSet::new();
        let mut beside = std::collections::BTreeSet::new();
        for seed in 0..2000 {
            seen.insert(predicted(&RandomWalk, &map, &sight, from, seed));
            beside.insert(predicted(&walls, &map, &sight, from, seed));
        }
        let flight = Flight::new(&map, &map, &sight, from);
        assert_eq!(seen.len(), flight.permissible().count());
        // Of row 2 all are beside the wall; rows 0 and 1 are hidden behind it.
        assert_eq!(
            beside.into_iter().collect::<Vec<_>>(),
            (0..5).map(|column| Cell::new(2, column)).collect::<Vec<_>>()
        );
    }

    #[test]
    fn the_shortest_way_is_taken_to_its_end() {
        let (map, sight) = (world("..#..\n..#.o\n..#..\n..#..\n.....", 2), Sight::new(2));
        let hops = Hops::new(&map, &sight);
        let oracle = OptimalWay::new(&hops);
        let mut at = Cell::new(2, 1);
        let mut steps = 0;
        while !map.is_hole(at) {
            at = predicted(&oracle, &map, &sight, at, 0);
            steps += 1;
        }
        assert_eq!(steps, 4);
    }
}
