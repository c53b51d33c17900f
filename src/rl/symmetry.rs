//! The eight ways to turn and flip a square map, for training on all of them.

use super::cell::Cell;

/// A symmetry of the square: an optional transposition, then optional flips.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Symmetry(u8);

impl Symmetry {
    /// Leaves everything where it is.
    pub const IDENTITY: Self = Self(0);
    /// How many there are.
    pub const COUNT: usize = 8;

    /// The n-th symmetry; 0 is the identity.
    ///
    /// # Panics
    /// If there is no such symmetry.
    #[must_use]
    pub fn new(n: usize) -> Self {
        assert!(n < Self::COUNT, "a square has eight symmetries");
        Self(n as u8)
    }

    /// Which one it is.
    #[must_use]
    pub fn number(self) -> usize {
        self.0.into()
    }

    /// Where a cell of a square of `side` cells comes to lie.
    #[must_use]
    pub fn of(self, cell: Cell, side: usize) -> Cell {
        let last = side as i32 - 1;
        let Cell { row, column } = cell;
        let (row, column) = if self.0 & 4 > 0 { (column, row) } else { (row, column) };
        let flip = |bit: u8, at: i32| if self.0 & bit > 0 { last - at } else { at };
        Cell::new(flip(1, row), flip(2, column))
    }

    /// A square of values, row by row, with every value where its cell comes to lie.
    pub fn copy<T: Copy>(self, from: &[T], to: &mut [T], side: usize) {
        if self == Self::IDENTITY {
            to.copy_from_slice(from);
            return;
        }
        for (row, values) in from.chunks_exact(side).enumerate() {
            let [start, next] = [0, 1].map(|column| {
                let cell = self.of(Cell::new(row as i32, column), side);
                cell.row as isize * side as isize + cell.column as isize
            });
            let mut at = start;
            for &value in values {
                to[at as usize] = value;
                at += next - start;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_eight_and_all_keep_distances() {
        let cells: Vec<Cell> =
            (0..3).flat_map(|row| (0..3).map(move |column| Cell::new(row, column))).collect();
        let mut images = std::collections::BTreeSet::new();
        for n in 0..Symmetry::COUNT {
            let image: Vec<Cell> = cells.iter().map(|&cell| Symmetry::new(n).of(cell, 3)).collect();
            for (a, &a_image) in cells.iter().zip(&image) {
                for (b, &b_image) in cells.iter().zip(&image) {
                    let squared = Cell::squared_length;
                    assert_eq!(squared(*a - *b), squared(a_image - b_image));
                }
            }
            images.insert(image);
        }
        assert_eq!(images.len(), 8);
        assert_eq!(Symmetry::IDENTITY.of(Cell::new(0, 2), 3), Cell::new(0, 2));
    }

    #[test]
    fn values_go_where_their_cells_go() {
        let from: Vec<i32> = (0..25).collect();
        for n in 0..Symmetry::COUNT {
            let mut to = vec![-1; 25];
            Symmetry::new(n).copy(&from, &mut to, 5);
            for (at, &value) in from.iter().enumerate() {
                let cell = Symmetry::new(n).of(Cell::new(at as i32 / 5, at as i32 % 5), 5);
                assert_eq!(to[cell.row as usize * 5 + cell.column as usize], value);
            }
        }
    }
}
