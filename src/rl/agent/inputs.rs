//! What a network is given, and maps that it cannot take.

use tch::Tensor;

/// Map and window of a batch of states, in the numbers and the order that a network computes with.
#[derive(Debug)]
pub struct Inputs {
    pub(super) map: Tensor,
    pub(super) window: Tensor,
}

/// Maps that the network cannot take.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error(
    "the network halves maps of {cells} × {cells} cells to {found} × {found}, but moves of \
     {reach} cells make a window of {window} × {window}: choose rl.reach_cells or the dataset so that \
     both are equal (121 cells and 15), or train.encoding = \"centered\", which takes maps of any size"
)]
pub struct ShapeError {
    /// Cells along a side of a map.
    pub cells: usize,
    /// `rl.reach_cells`.
    pub reach: u32,
    pub(super) found: i64,
    pub(super) window: i64,
}

impl crate::error::HasFault for ShapeError {
    fn fault(&self) -> crate::error::Fault {
        crate::error::Fault::Input
    }
}
