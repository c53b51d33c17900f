//! The task keeps its rules on any map: nothing flies through a building, nobody is pulled back
//! to where they must not be, and the oracle is as good as brute force.
//!
//! Lines of sight are checked by the robust predicates of the crate geo, which the task itself
//! does not use.
#![allow(clippy::panic, reason = "helpers of tests fail by panicking")]

mod pipeline;

use std::sync::{Arc, LazyLock};

use geo::{Intersects, Line, Rect, coord};
use holescout::config::RlConfig;
use holescout::dataset::{Dataset, Grids, Record};
use holescout::rl::policy::{
    Descent, DescentStyle, OptimalWay, Policy, RandomWalk, ShadowSeeker, View, WallWalk,
};
use holescout::rl::{
    Cell, Environment, Flight, Hops, MapList, Random, Sight, World, neighbourhood,
};
use ndarray::Array2;
use proptest::prelude::*;

use pipeline::HELSINKI;

const REACH: u32 = 4;

/// A real record, whose arrays are replaced.
static RECORD: LazyLock<Record> = LazyLock::new(|| {
    let dataset = Dataset::open(&HELSINKI.dataset).expect("opened");
    dataset.record(dataset.manifest().records[0].id).expect("read")
});
static SIGHT: LazyLock<Sight> = LazyLock::new(|| Sight::new(REACH));

/// Maps of up to 12 × 12 cells: kind (0 building, else outdoors) and level of each cell.
fn worlds() -> impl Strategy<Value = World> {
    let cell = (0..4_u8, -160.0..-40.0_f32);
    (2..12_usize).prop_flat_map(move |n| proptest::collection::vec(cell.clone(), n * n)).prop_map(
        |cells| {
            let n = cells.len().isqrt();
            let at = |(row, column): (usize, usize)| cells[row * n + column];
            let grids = Grids {
                height_m: Array2::from_shape_fn((n, n), |i| if at(i).0 == 0 { 12.0 } else { 0.0 }),
                rsrp_dbm: Array2::from_shape_fn((n, n), |i| at(i).1),
                mask: Array2::from_shape_fn((n, n), |i| u8::from(at(i).0 == 0)),
                errors: None,
            };
            let config = RlConfig { reach_cells: REACH, ..RlConfig::default() };
            World::new(&RECORD, &grids, &config)
        },
    )
}

fn cells(world: &World) -> Vec<Cell> {
    let n = world.cells() as i32;
    (0..n).flat_map(|row| (0..n).map(move |column| Cell::new(row, column))).collect()
}

/// Whether a straight flight between the centres of two cells touches no occupied cell.
fn is_clear(world: &World, from: Cell, to: Cell) -> bool {
    let at = |cell: Cell, by: f64| {
        let [row, column] = cell.center();
        coord! { x: column + by, y: row + by }
    };
    let way = Line::new(at(from, 0.0), at(to, 0.0));
    let square = |cell: &Cell| Rect::new(at(*cell, -0.5), at(*cell, 0.5));
    let mut occupied = cells(world).into_iter().filter(|&cell| world.is_occupied(cell));
    !occupied.any(|cell| way.intersects(&square(&cell)))
}

fn policies<'a>(world: &World, hops: &'a Hops) -> Vec<Box<dyn Policy + 'a>> {
    let style =
        |keep_fraction, smoothing_cells| DescentStyle { rate: 1.0, smoothing_cells, keep_fraction };
    let near = neighbourhood(world, 8.0);
    vec![
        Box::new(RandomWalk),
        Box::new(WallWalk::new(world)),
        Box::new(ShadowSeeker::new(world)),
        Box::new(OptimalWay::new(hops)),
        Box::new(Descent::new(world, style(false, 0.0), None)),
        Box::new(Descent::new(world, style(true, 1.0), None)),
        Box::new(Descent::new(world, style(true, 0.0), Some(&near))),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn the_permissible_set_is_what_lines_of_sight_say(world in worlds()) {
        let actions = SIGHT.actions();
        for from in world.free_cells() {
            let set = SIGHT.permissible(&world, from);
            for action in 0..actions.count() {
                let to = from + actions.offset(action);
                let expected = world.is_free(to) && is_clear(&world, from, to);
                prop_assert_eq!(set.contains(action), expected, "{:?} to {:?}", from, to);
            }
            prop_assert_eq!(set.count(), set.iter().count());
            prop_assert!((0..set.count()).all(|n| set.nth(n) == set.iter().nth(n)));
        }
    }

    #[test]
    fn no_flight_touches_a_building(world in worlds(), seed: u64) {
        let hops = Hops::new(&world, &SIGHT);
        for policy in policies(&world, &hops) {
            for start in world.free_cells().into_iter().step_by(5) {
                let mut flight = Flight::new(&world, &world, &SIGHT, start);
                let mut random = Random::keyed(&[seed]);
                for _ in 0..4 {
                    if flight.is_over() {
                        break;
                    }
                    let view = View { flight: &flight, known: &world, random: &mut random };
                    let waypoint = policy.predict(&mut [view])[0];
                    let from = flight.cell();
                    flight.step(waypoint, policy.keeps_fraction(), |cell| policy.allows(cell));
                    prop_assert!(is_clear(&world, from, flight.cell()));
                    prop_assert!((flight.cell() - from).reach() <= REACH as i32);
                    prop_assert!(policy.allows(flight.cell()) || flight.cell() == from);
                }
                prop_assert_eq!(flight.is_over(), world.is_hole(flight.cell()));
            }
        }
    }

    #[test]
    fn pulled_back_is_permissible_and_rewards_are_three(
        world in worlds(),
        row in -20.0..30.0_f64,
        column in -20.0..30.0_f64,
    ) {
        for start in world.free_cells().into_iter().step_by(3) {
            let mut flight = Flight::new(&world, &world, &SIGHT, start);
            let permissible = flight.permissible().clone();
            let index = |cell: Cell| SIGHT.actions().index(cell - start);
            let is_permissible = |cell| index(cell).is_some_and(|at| permissible.contains(at));
            let step = flight.step([row, column], false, |_| true);
            prop_assert!(is_permissible(flight.cell()));
            prop_assert_eq!(step.permissible, is_permissible(Cell::at([row, column])));
            prop_assert!(!step.permissible || flight.cell() == Cell::at([row, column]));
            let hole = world.is_hole(flight.cell());
            let expected = if !step.permissible { -1.25 } else if hole { 0.0 } else { -0.25 };
            prop_assert_eq!(step.reward, expected);
        }
    }

    #[test]
    fn the_oracle_equals_brute_force(world in worlds()) {
        let free = world.free_cells();
        let near = |a: Cell, b: Cell| (a - b).reach() <= REACH as i32 && is_clear(&world, a, b);
        // Bellman and Ford: as many rounds as there could be hops.
        let mut hops: Vec<Option<u16>> =
            free.iter().map(|&cell| world.is_hole(cell).then_some(0)).collect();
        let edges: Vec<(usize, usize)> = (0..free.len())
            .flat_map(|a| (0..free.len()).map(move |b| (a, b)))
            .filter(|&(a, b)| a != b && near(free[a], free[b]))
            .collect();
        loop {
            let before = hops.clone();
            for &(a, b) in &edges {
                let through = hops[b].map(|hops| hops + 1);
                hops[a] = [hops[a], through].into_iter().flatten().min();
            }
            if hops == before {
                break;
            }
        }
        let oracle = Hops::new(&world, &SIGHT);
        for (&cell, &expected) in free.iter().zip(&hops) {
            prop_assert_eq!(oracle.from(cell), expected, "{:?}", cell);
        }
    }

    #[test]
    fn episodes_do_not_depend_on_threads(world in worlds(), seed: u64) {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.expect("a pool").install(|| {
                let maps = MapList::of(vec![Arc::new(world.clone())]).ok()?;
                let mut environment = Environment::new(&maps, 300, 3, seed);
                let mut random = Random::keyed(&[seed]);
                let outcomes = (0..4).map(|_| {
                    let actions: Vec<usize> = (0..300).map(|_| random.below(81)).collect();
                    environment.step(&maps, &actions)
                });
                Some(outcomes.collect::<Vec<_>>())
            })
        };
        let one = run(1);
        for outcome in one.iter().flatten().flatten() {
            prop_assert!([0.0, -0.25, -1.25].contains(&outcome.reward));
            prop_assert!(!(outcome.terminal && outcome.truncated));
        }
        prop_assert_eq!(one, run(3));
    }
}
