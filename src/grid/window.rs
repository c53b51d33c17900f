//! A square of cells at a place.

use super::TileId;

/// A square window of cells on the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// Easting of the western border, in metres.
    pub west: f64,
    /// Northing of the northern border, in metres.
    pub north: f64,
    /// Side of a cell, in metres.
    pub cell: f64,
    /// Cells along a side.
    pub cells: usize,
}

impl Window {
    /// The window of `cells` × `cells` cells of side `cell` around a tile's centre.
    #[must_use]
    pub fn around(tile: TileId, cell: f64, cells: usize) -> Self {
        let half = cell * cells as f64 / 2.0;
        let [easting, northing] = tile.center();
        Self { west: easting - half, north: northing + half, cell, cells }
    }

    /// Easting of the eastern border, in metres.
    #[must_use]
    pub fn east(&self) -> f64 {
        self.west + self.cell * self.cells as f64
    }

    /// Northing of the southern border, in metres.
    #[must_use]
    pub fn south(&self) -> f64 {
        self.north - self.cell * self.cells as f64
    }

    /// Northing of the centres of a row.
    #[must_use]
    pub fn row_northing(&self, row: usize) -> f64 {
        self.north - (row as f64 + 0.5) * self.cell
    }

    /// The rows whose centres lie at northings in `[low, high)`.
    #[must_use]
    pub fn rows_between(&self, low: f64, high: f64) -> std::ops::Range<usize> {
        let first_not_above = |northing: f64| {
            // The quotient may be off by one rounding; the exact comparison decides.
            let guess = ((self.north - northing) / self.cell - 0.5).clamp(0.0, self.cells as f64);
            let mut row = guess as usize;
            while row > 0 && self.row_northing(row - 1) < northing {
                row -= 1;
            }
            while row < self.cells && self.row_northing(row) >= northing {
                row += 1;
            }
            row
        };
        let (start, end) = (first_not_above(high), first_not_above(low));
        start..end.max(start)
    }

    /// The first column whose centre lies at or east of an easting, at most `cells`.
    #[must_use]
    pub fn first_column_from(&self, easting: f64) -> usize {
        let column = ((easting - self.west) / self.cell - 0.5).ceil();
        column.clamp(0.0, self.cells as f64) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_and_columns_are_half_open() {
        let window = Window { west: 100.0, north: 200.0, cell: 1.0, cells: 10 };
        assert_eq!(window.rows_between(197.5, 199.5), 1..3, "199.5 is out, 197.5 is in");
        assert_eq!(window.rows_between(0.0, 1000.0), 0..10);
        assert_eq!(window.rows_between(198.6, 198.9), 1..1);
        assert_eq!(window.first_column_from(100.5), 0);
        assert_eq!(window.first_column_from(100.6), 1);
        assert_eq!(window.first_column_from(0.0), 0);
        assert_eq!(window.first_column_from(1e9), 10);
        assert_eq!((window.east(), window.south()), (110.0, 190.0));
    }
}
