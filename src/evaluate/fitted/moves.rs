//! Where the methods of this module may lead a flight.

use crate::rl::Cell;
use crate::rl::policy::View;

/// Cells that a flight may be led to, visited ones left out while there are others.
pub(super) fn moves(view: &View<'_, '_>) -> Vec<Cell> {
    let actions = view.flight.sight().actions();
    view.unvisited().iter().map(|action| view.flight.cell() + actions.offset(action)).collect()
}
