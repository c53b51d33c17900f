//! Methods that need no network, behind the trait that a network implements too.
//!
//! A policy is made for one map and predicts waypoints for many flights over it at a time. It
//! never moves a UAV: Algorithm 1 ([`Flight::step`]) does, with the same rules for all.

mod gradient;
mod shadow;
mod walk;

use std::borrow::Cow;

pub use gradient::{Descent, DescentStyle};
pub use shadow::ShadowSeeker;
pub use walk::{OptimalWay, RandomWalk, WallWalk};

use super::cell::Cell;
use super::flight::Flight;
use super::sight::ActionSet;
use super::world::World;
use crate::random::Random;

/// What a policy sees of a flight.
#[derive(Debug)]
pub struct View<'a, 'w> {
    /// The flight: position, measurements.
    pub flight: &'a Flight<'w>,
    /// The map as the UAV has it stored: buildings may be missing, levels noisy. A policy that is
    /// not told the coverage map must not look at its levels.
    pub known: &'w World,
    /// This flight's random numbers.
    pub random: &'a mut Random,
}

impl View<'_, '_> {
    /// Where one step may lead as far as the stored map tells.
    #[must_use]
    pub fn permissible(&self) -> Cow<'_, ActionSet> {
        let flight = self.flight;
        if std::ptr::eq(flight.world(), self.known) {
            Cow::Borrowed(flight.permissible())
        } else {
            Cow::Owned(flight.sight().permissible(self.known, flight.cell()))
        }
    }

    /// The same without visited cells, while there are others.
    #[must_use]
    pub fn unvisited(&self) -> ActionSet {
        let visited = self.flight.measurements().iter().map(|measured| measured.cell);
        let actions = self.flight.sight().actions();
        self.permissible().unvisited(actions, &visited.collect::<Vec<Cell>>())
    }
}

/// Predicts waypoints on one map.
pub trait Policy: Sync {
    /// The next waypoint of each flight, row and column in cells; it need not be permissible.
    fn predict(&self, views: &mut [View<'_, '_>]) -> Vec<[f64; 2]>;

    /// Whether what rounding to cells leaves over is carried to the next step.
    fn keeps_fraction(&self) -> bool {
        false
    }

    /// Whether the UAV may be led to a cell, beyond its being permissible.
    fn allows(&self, _cell: Cell) -> bool {
        true
    }
}

/// Makes policies for maps, for instance of a trained network.
pub trait MakePolicy: Sync + std::fmt::Debug {
    /// A policy for a map as the UAV has it stored.
    fn policy<'a>(&'a self, known: &World) -> Box<dyn Policy + 'a>;

    /// The same knowledge without planning, the method `predictor`: always to where a hole is most
    /// likely. `None` if it does not tell how likely holes are.
    fn predictor(&self) -> Option<&dyn MakePolicy> {
        None
    }
}

/// Each flight by itself, for policies that gain nothing from predicting together.
fn each<'w>(
    views: &mut [View<'_, 'w>],
    predict: impl Fn(&mut View<'_, 'w>) -> [f64; 2],
) -> Vec<[f64; 2]> {
    views.iter_mut().map(predict).collect()
}
