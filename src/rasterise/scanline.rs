//! Polygon filling by scanlines through the centres of the rows.

use geo::{Coord, Polygon};

use crate::grid::Window;

/// Fills polygons; reuses its memory from one polygon to the next.
#[derive(Debug, Default)]
pub struct Scanline {
    crossings: Vec<(usize, f64)>,
}

impl Scanline {
    /// Calls `paint(row, columns)` for every run of cells of a window whose centres lie in
    /// a polygon (even-odd over its exterior and interiors).
    ///
    /// A centre exactly on an edge belongs to the polygon north or east of it, so of two
    /// polygons that share the edge exactly one gets the cell. Returns whether there is any.
    pub fn fill(
        &mut self,
        polygon: &Polygon<f64>,
        window: &Window,
        mut paint: impl FnMut(usize, std::ops::Range<usize>),
    ) -> bool {
        self.crossings.clear();
        for ring in std::iter::once(polygon.exterior()).chain(polygon.interiors()) {
            for pair in ring.0.windows(2) {
                self.cross(pair[0], pair[1], window);
            }
        }
        self.crossings
            .sort_unstable_by(|(r1, x1), (r2, x2)| r1.cmp(r2).then_with(|| x1.total_cmp(x2)));
        let mut has_cells = false;
        // Closed rings cross every scanline an even number of times.
        for pair in self.crossings.chunks_exact(2) {
            let ((row, west), (_, east)) = (pair[0], pair[1]);
            let columns = window.first_column_from(west)..window.first_column_from(east);
            if !columns.is_empty() {
                has_cells = true;
                paint(row, columns);
            }
        }
        has_cells
    }

    /// Notes where an edge crosses the scanlines of the rows it spans, lower end included.
    fn cross(&mut self, a: Coord<f64>, b: Coord<f64>, window: &Window) {
        // From south to north whatever the ring's direction: shared edges round alike.
        let (low, high) = if a.y < b.y { (a, b) } else { (b, a) };
        let rows = window.rows_between(low.y, high.y);
        if rows.is_empty() {
            return;
        }
        let slope = (high.x - low.x) / (high.y - low.y);
        for row in rows {
            let x = low.x + (window.row_northing(row) - low.y) * slope;
            self.crossings.push((row, x));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geo::{Contains, LineString, Point};
    use proptest::prelude::*;

    const WINDOW: Window = Window { west: 1000.0, north: 2000.0, cell: 1.0, cells: 24 };

    fn cells(polygon: &Polygon<f64>) -> Vec<(usize, usize)> {
        let mut painted = Vec::new();
        Scanline::default().fill(polygon, &WINDOW, |row, columns| {
            painted.extend(columns.map(|column| (row, column)));
        });
        painted.sort_unstable();
        painted
    }

    fn ring(points: &[(f64, f64)]) -> LineString<f64> {
        let mut line: LineString<f64> =
            points.iter().map(|&(x, y)| (1000.0 + x, 1976.0 + y)).collect();
        line.close();
        line
    }

    #[test]
    fn a_rectangle_with_a_courtyard() {
        let outer = ring(&[(2.0, 2.0), (8.0, 2.0), (8.0, 8.0), (2.0, 8.0)]);
        let hole = ring(&[(4.0, 4.0), (6.0, 4.0), (6.0, 6.0), (4.0, 6.0)]);
        let painted = cells(&Polygon::new(outer, vec![hole]));
        assert_eq!(painted.len(), 36 - 4);
        // The south-west cell of the rectangle: row 23 is the southernmost.
        assert!(painted.contains(&(21, 2)) && !painted.contains(&(19, 4)));
    }

    #[test]
    fn centres_on_a_shared_edge_belong_to_one_side() {
        let west = Polygon::new(ring(&[(2.0, 2.5), (4.5, 2.5), (4.5, 8.5), (2.0, 8.5)]), vec![]);
        let east = Polygon::new(ring(&[(4.5, 2.5), (9.0, 2.5), (9.0, 8.5), (4.5, 8.5)]), vec![]);
        let (west, east) = (cells(&west), cells(&east));
        assert!(west.iter().all(|cell| !east.contains(cell)));
        assert_eq!(west.len() + east.len(), 6 * 7);
    }

    #[test]
    fn what_lies_outside_of_the_window_is_cut_off() {
        let big = ring(&[(-50.0, -50.0), (500.0, -50.0), (500.0, 500.0), (-50.0, 500.0)]);
        assert_eq!(cells(&Polygon::new(big, vec![])).len(), 24 * 24);
        let far = ring(&[(100.0, 0.0), (110.0, 0.0), (110.0, 10.0)]);
        assert!(cells(&Polygon::new(far, vec![])).is_empty());
    }

    proptest! {
        /// Against a point-in-polygon test of another library, for simple star-shaped rings.
        #[test]
        fn equals_point_in_polygon(
            radii in prop::collection::vec(0.5_f64..11.0, 3..20),
            (x, y) in (6.0_f64..18.0, 6.0_f64..18.0),
        ) {
            let step = std::f64::consts::TAU / radii.len() as f64;
            let points: Vec<_> = radii
                .iter()
                .enumerate()
                .map(|(i, r)| {
                    let angle = i as f64 * step + 0.1;
                    (x + r * angle.cos(), y + r * angle.sin())
                })
                .collect();
            let polygon = Polygon::new(ring(&points), vec![]);
            let painted = cells(&polygon);
            for row in 0..WINDOW.cells {
                for column in 0..WINDOW.cells {
                    let center = Point::new(
                        WINDOW.west + column as f64 + 0.5,
                        WINDOW.row_northing(row),
                    );
                    let inside = polygon.contains(&center);
                    prop_assert_eq!(inside, painted.contains(&(row, column)), "{:?}", (row, column));
                }
            }
        }
    }
}
