//! One UAV under way: Algorithm 1 of the paper, a step at a time, and its reward.

use super::cell::Cell;
use super::sight::{ActionSet, Sight};
use super::world::World;

/// Reward for a coverage hole, equation 13.
pub const REWARD_HOLE: f32 = 0.0;
/// Reward for predicting a waypoint that is not permissible.
pub const REWARD_BLOCKED: f32 = -1.25;
/// Reward for any other step.
pub const REWARD_STEP: f32 = -0.25;

/// A visited cell and the level measured there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// Where.
    pub cell: Cell,
    /// What, in dBm per resource element.
    pub rsrp_dbm: f32,
}

/// What a step came to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Whether the predicted waypoint was permissible; if not, the UAV was pulled back.
    pub permissible: bool,
    /// The reward, equation 13.
    pub reward: f32,
}

/// A UAV over a map, with what it has measured.
///
/// It moves in one map and measures in another of the same place: they differ when the
/// measurements are noisy. The same for both is the usual case.
#[derive(Debug, Clone)]
pub struct Flight<'a> {
    world: &'a World,
    measured: &'a World,
    sight: &'a Sight,
    position: [f64; 2],
    permissible: ActionSet,
    measurements: Vec<Measurement>,
}

impl<'a> Flight<'a> {
    /// A UAV at the centre of a cell, with the measurement that it makes there.
    ///
    /// # Panics
    /// If the cell is not free.
    #[must_use]
    pub fn new(world: &'a World, measured: &'a World, sight: &'a Sight, start: Cell) -> Self {
        let mut flight = Self {
            world,
            measured,
            sight,
            position: start.center(),
            permissible: sight.empty(),
            measurements: Vec::new(),
        };
        flight.arrive(start);
        flight
    }

    fn arrive(&mut self, cell: Cell) {
        let rsrp_dbm = self.measured.rsrp_dbm(cell);
        self.measurements.push(Measurement { cell, rsrp_dbm });
        self.sight.permissible_into(self.world, cell, &mut self.permissible);
    }

    /// The map that it moves in.
    #[must_use]
    pub fn world(&self) -> &'a World {
        self.world
    }

    /// The table of lines of sight.
    #[must_use]
    pub fn sight(&self) -> &'a Sight {
        self.sight
    }

    /// Where a policy takes it to be, in cells: the centre of [`Flight::cell`], or with positions
    /// between cells kept, that and what rounding to cells has left over.
    #[must_use]
    pub fn position(&self) -> [f64; 2] {
        self.position
    }

    /// The cell that it is in.
    ///
    /// # Panics
    /// Never: the start is measured.
    #[must_use]
    pub fn cell(&self) -> Cell {
        self.measurements.last().expect("the start is measured").cell
    }

    /// All measurements, the start's first.
    #[must_use]
    pub fn measurements(&self) -> &[Measurement] {
        &self.measurements
    }

    /// Where one step may lead, `S_prm(k)`.
    #[must_use]
    pub fn permissible(&self) -> &ActionSet {
        &self.permissible
    }

    /// Whether the level measured last lies below the threshold: the flight is over.
    ///
    /// # Panics
    /// Never: the start is measured.
    #[must_use]
    pub fn is_over(&self) -> bool {
        let last = self.measurements.last().expect("the start is measured");
        // Above a roof lower than the flight height the level says nothing about coverage outdoors.
        last.rsrp_dbm < self.world.threshold_dbm() && self.world.is_outdoors(last.cell)
    }

    /// Flies towards a waypoint (in cells): to it if it is permissible, else to the farthest
    /// permissible point on the way, and measures there. `within` narrows the permissible set
    /// further, for methods that must not leave a neighbourhood. A UAV always flies from centre to
    /// centre of cells; `keep_fraction` carries what rounding to cells leaves over to the next
    /// step, so that small moves add up.
    pub fn step(
        &mut self,
        waypoint: [f64; 2],
        keep_fraction: bool,
        within: impl Fn(Cell) -> bool,
    ) -> Step {
        let (position, permissible) =
            fly(self.sight, &self.permissible, self.position, waypoint, within);
        let cell = Cell::at(position);
        self.position = if keep_fraction { position } else { cell.center() };
        self.arrive(cell);
        Step { permissible, reward: reward(permissible, self.is_over()) }
    }
}

/// Where a UAV comes to that flies from a position towards a waypoint, and whether the
/// waypoint was permissible.
pub(super) fn fly(
    sight: &Sight,
    permissible: &ActionSet,
    from: [f64; 2],
    waypoint: [f64; 2],
    within: impl Fn(Cell) -> bool,
) -> ([f64; 2], bool) {
    let cell = Cell::at(from);
    let allowed = |to: Cell| {
        sight.actions().index(to - cell).is_some_and(|action| permissible.contains(action))
    };
    let reach = sight.actions().reach();
    let position = farthest(from, waypoint, reach, |to| to == cell || allowed(to) && within(to));
    (position, allowed(Cell::at(waypoint)))
}

/// Equation 13, the order of its cases made explicit: a waypoint that is not permissible costs
/// 1.25 wherever the UAV is pulled back to, since the level at the waypoint is never measured.
pub(super) fn reward(permissible: bool, hole: bool) -> f32 {
    match (permissible, hole) {
        (false, _) => REWARD_BLOCKED,
        (true, true) => REWARD_HOLE,
        (true, false) => REWARD_STEP,
    }
}

/// The farthest allowed point on the way from `from` to `to`, Algorithm 1: the largest u in (0, 1]
/// with `from + u (to - from)` in an allowed cell, u being a multiple of one over the length
/// along the longer axis (so that between neighbouring points no row or column is left out).
/// `from` itself if there is none.
fn farthest(from: [f64; 2], to: [f64; 2], reach: i32, allowed: impl Fn(Cell) -> bool) -> [f64; 2] {
    let way = [to[0] - from[0], to[1] - from[1]];
    let length = way[0].abs().max(way[1].abs());
    // Also false for NaN, which no policy should predict, and for staying.
    if !(length > 0.0 && length.is_finite()) {
        return from;
    }
    let points = length.ceil();
    // What lies farther away than the reach is never allowed.
    let first = points.min(((f64::from(reach) + 1.0) * points / length).ceil()) as u32;
    (1..=first)
        .rev()
        .map(|step| f64::from(step) / points)
        .map(|u| [from[0] + u * way[0], from[1] + u * way[1]])
        .find(|&point| allowed(Cell::at(point)))
        .unwrap_or(from)
}

/// The rewards of all actions, equation 13, and whether each would end the episode: what training
/// may know of a state for free.
pub fn rewards_into(
    sight: &Sight,
    world: &World,
    from: Cell,
    permissible: &ActionSet,
    mut store: impl FnMut(usize, f32, bool),
) {
    for action in 0..sight.actions().count() {
        let is_permissible = permissible.contains(action);
        let is_hole = is_permissible && world.is_hole(from + sight.actions().offset(action));
        store(action, reward(is_permissible, is_hole), is_hole);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::world::tests::world;

    const MAP: &str = "......\n......\n..##..\n..##..\n.....o\n.....o";

    fn fly(start: Cell, waypoint: [f64; 2]) -> (Cell, Step) {
        let (world, sight) = (world(MAP, 5), Sight::new(5));
        let mut flight = Flight::new(&world, &world, &sight, start);
        let step = flight.step(waypoint, false, |_| true);
        (flight.cell(), step)
    }

    #[test]
    fn a_permissible_waypoint_is_reached() {
        let (cell, step) = fly(Cell::new(0, 0), [0.0, 5.0]);
        assert_eq!(
            (cell, step),
            (Cell::new(0, 5), Step { permissible: true, reward: REWARD_STEP })
        );
    }

    #[test]
    fn a_hole_ends_the_flight_without_penalty() {
        let (cell, step) = fly(Cell::new(5, 0), [5.0, 5.0]);
        assert_eq!(
            (cell, step),
            (Cell::new(5, 5), Step { permissible: true, reward: REWARD_HOLE })
        );
    }

    /// Algorithm 1, by hand: from (0, 2) due south, the building begins at row 2.
    #[test]
    fn a_blocked_waypoint_is_pulled_back_along_the_line() {
        let (cell, step) = fly(Cell::new(0, 2), [5.0, 2.0]);
        assert_eq!(
            (cell, step),
            (Cell::new(1, 2), Step { permissible: false, reward: REWARD_BLOCKED })
        );
        let (cell, _) = fly(Cell::new(1, 2), [5.0, 2.0]);
        assert_eq!(cell, Cell::new(1, 2), "it cannot come nearer");
    }

    #[test]
    fn a_waypoint_beyond_reach_or_map_is_pulled_back_too() {
        assert_eq!(fly(Cell::new(0, 0), [0.0, 1e9]).0, Cell::new(0, 5));
        assert_eq!(fly(Cell::new(0, 0), [-3.0, 0.0]).0, Cell::new(0, 0));
        assert_eq!(fly(Cell::new(0, 0), [f64::NAN, 0.0]).0, Cell::new(0, 0));
        assert!(!fly(Cell::new(0, 0), [0.0, 6.0]).1.permissible);
    }

    #[test]
    fn being_pulled_back_to_a_hole_ends_the_flight_but_costs() {
        // The way to (7, 5) leaves the map behind the hole at (5, 5).
        let (world, sight) = (world(MAP, 5), Sight::new(5));
        let mut flight = Flight::new(&world, &world, &sight, Cell::new(2, 5));
        let step = flight.step([7.0, 5.0], false, |_| true);
        assert_eq!((flight.cell(), flight.is_over()), (Cell::new(5, 5), true));
        assert_eq!(step.reward, REWARD_BLOCKED);
    }

    #[test]
    fn a_neighbourhood_narrows_the_way_but_is_no_mistake() {
        let (world, sight) = (world(MAP, 5), Sight::new(5));
        let mut flight = Flight::new(&world, &world, &sight, Cell::new(0, 0));
        let step = flight.step([0.0, 4.0], false, |cell| cell.column <= 2);
        assert_eq!((flight.cell(), step.permissible), (Cell::new(0, 2), true));
    }

    #[test]
    fn positions_between_cells_add_up() {
        let (world, sight) = (world(MAP, 5), Sight::new(5));
        let mut kept = Flight::new(&world, &world, &sight, Cell::new(0, 0));
        let mut rounded = kept.clone();
        for _ in 0..4 {
            let ahead = |flight: &Flight<'_>| [0.0, flight.position()[1] + 0.4];
            let (to, too) = (ahead(&kept), ahead(&rounded));
            kept.step(to, true, |_| true);
            rounded.step(too, false, |_| true);
        }
        assert_eq!((kept.cell(), rounded.cell()), (Cell::new(0, 2), Cell::new(0, 0)));
    }
}
