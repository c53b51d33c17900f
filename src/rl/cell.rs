//! Cells of a map, and the moves between them.

use serde::{Deserialize, Serialize};

/// A cell: row from the north, column from the west, both from 0. Moves and what lies beside a
/// map have negative ones too.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize,
)]
pub struct Cell {
    /// Rows to the south of the northernmost.
    pub row: i32,
    /// Columns to the east of the westernmost.
    pub column: i32,
}

impl Cell {
    /// A cell or a move.
    #[must_use]
    pub const fn new(row: i32, column: i32) -> Self {
        Self { row, column }
    }

    /// The centre of the cell, in cells.
    #[must_use]
    pub fn center(self) -> [f64; 2] {
        [f64::from(self.row), f64::from(self.column)]
    }

    /// The cell that a point lies in; points half-way belong to the cell away from zero.
    #[must_use]
    pub fn at([row, column]: [f64; 2]) -> Self {
        Self::new(row.round() as i32, column.round() as i32)
    }

    /// The greater of the distances along rows and along columns, in cells.
    #[must_use]
    pub fn reach(self) -> i32 {
        self.row.abs().max(self.column.abs())
    }

    /// The square of the straight distance, in cells.
    #[must_use]
    pub fn squared_length(self) -> i32 {
        self.row * self.row + self.column * self.column
    }
}

impl std::ops::Add for Cell {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self::new(self.row + other.row, self.column + other.column)
    }
}

impl std::ops::Sub for Cell {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self::new(self.row - other.row, self.column - other.column)
    }
}

/// The moves of one step, equation 11: a square of (2l + 1) × (2l + 1) cells around the UAV,
/// numbered row by row from the north-west. The action in the middle is to stay.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Actions {
    reach: i32,
}

impl Actions {
    /// Moves of at most `reach` cells (l) in each direction.
    #[must_use]
    pub fn new(reach: u32) -> Self {
        Self { reach: reach as i32 }
    }

    /// Cells that a move may lead in each direction (l).
    #[must_use]
    pub fn reach(self) -> i32 {
        self.reach
    }

    /// Cells along a side: 2l + 1.
    #[must_use]
    pub fn side(self) -> usize {
        2 * self.reach as usize + 1
    }

    /// Number of actions: (2l + 1)².
    #[must_use]
    pub fn count(self) -> usize {
        self.side() * self.side()
    }

    /// The move of an action.
    #[must_use]
    pub fn offset(self, action: usize) -> Cell {
        let side = self.side();
        Cell::new((action / side) as i32 - self.reach, (action % side) as i32 - self.reach)
    }

    /// The action of a move, if it is not too far.
    #[must_use]
    pub fn index(self, offset: Cell) -> Option<usize> {
        (offset.reach() <= self.reach).then(|| {
            let row = (offset.row + self.reach) as usize;
            row * self.side() + (offset.column + self.reach) as usize
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn actions_are_numbered_row_by_row_from_the_north_west() {
        let actions = Actions::new(15);
        assert_eq!((actions.side(), actions.count()), (31, 961));
        assert_eq!(actions.offset(0), Cell::new(-15, -15));
        assert_eq!(actions.offset(480), Cell::default());
        assert_eq!(actions.offset(960), Cell::new(15, 15));
        for action in 0..actions.count() {
            assert_eq!(actions.index(actions.offset(action)), Some(action));
        }
        assert_eq!(actions.index(Cell::new(0, 16)), None);
    }
}
