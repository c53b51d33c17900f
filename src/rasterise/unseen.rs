//! Footprints so small or thin that a height grid does not show them.

use std::collections::BTreeSet;

use geo::{Area, BoundingRect, Euclidean, Length, MultiPolygon, Polygon};
use rayon::prelude::*;

use super::scanline::Scanline;
use crate::building::{City, Defect, ObjectId, Problem};
use crate::config::GridConfig;
use crate::grid::Window;

/// Grids are judged as if their cells were no larger, in metres: that a coarse one shows few
/// buildings is no news.
const FINE_CELL_M: f64 = 1.0;

/// A row for each object whose footprint covers the centre of no cell.
pub(super) fn without_cells(city: &City, grid: &GridConfig) -> Vec<Problem> {
    let cell_m = grid.cell_m.min(FINE_CELL_M);
    let has_cell: Vec<bool> = city
        .buildings()
        .par_iter()
        .map(|building| {
            is_thick(&building.footprint, cell_m)
                || covers_center(&building.footprint, cell_m, grid)
        })
        .collect();
    let of = |wanted: bool| {
        let buildings = city.buildings().iter().zip(&has_cell);
        buildings.filter(move |(_, has)| **has == wanted).map(|(building, _)| building.object)
    };
    let mut unseen: BTreeSet<ObjectId> = of(false).collect();
    if !unseen.is_empty() {
        // A relation may be several buildings.
        of(true).for_each(|object| {
            unseen.remove(&object);
        });
    }
    unseen.into_iter().map(|object| Problem::new(object, Defect::NoCell)).collect()
}

/// Whether some place in the footprint is farther from its border than any place is from the
/// centre of a cell. The strip along the border is at most as large as its length times its
/// width, and sectors at the corners.
fn is_thick(footprint: &MultiPolygon<f64>, cell_m: f64) -> bool {
    let reach = cell_m * std::f64::consts::FRAC_1_SQRT_2;
    let strip = |polygon: &Polygon<f64>| {
        let rings = std::iter::once(polygon.exterior()).chain(polygon.interiors());
        let of_ring = rings.map(|ring| {
            let sectors = ring.0.len() as f64 * std::f64::consts::FRAC_PI_2 * reach * reach;
            Euclidean.length(ring) * reach + sectors
        });
        of_ring.sum::<f64>()
    };
    footprint.iter().any(|polygon| polygon.unsigned_area() > strip(polygon))
}

/// Whether the centre of a cell lies in the footprint, on the lattice of cells of a tile.
fn covers_center(footprint: &MultiPolygon<f64>, cell_m: f64, grid: &GridConfig) -> bool {
    let Some(bounds) = footprint.bounding_rect() else { return false };
    let border = f64::from(grid.side_m) / 2.0;
    let steps = |length: f64| ((length + border) / cell_m).floor();
    let cells = (bounds.width().max(bounds.height()) / cell_m).ceil() as usize + 2;
    let window = Window {
        west: steps(bounds.min().x) * cell_m - border,
        north: (steps(bounds.max().y) + 1.0) * cell_m - border,
        cell: cell_m,
        cells,
    };
    let mut scanline = Scanline::default();
    footprint.iter().any(|polygon| scanline.fill(polygon, &window, |_, _| {}))
}

#[cfg(test)]
mod tests {
    use super::*;
    use geo::{Rect, coord};
    use proptest::prelude::*;

    fn rectangle(x: f64, y: f64, width: f64, height: f64) -> MultiPolygon<f64> {
        let corner = coord! { x: 598_000.0 + x, y: 4_128_000.0 + y };
        let rect = Rect::new(corner, corner + coord! { x: width, y: height });
        MultiPolygon(vec![rect.to_polygon()])
    }

    #[test]
    fn a_wall_between_the_centres_covers_none() {
        let grid = GridConfig::default();
        assert!(!covers_center(&rectangle(0.6, 0.0, 0.2, 30.0), 1.0, &grid));
        assert!(covers_center(&rectangle(0.4, 0.0, 0.2, 30.0), 1.0, &grid));
        assert!(!covers_center(&rectangle(0.6, 0.6, 0.8, 0.8), 1.0, &grid));
        assert!(covers_center(&rectangle(0.6, 0.6, 0.8, 0.8), 0.5, &grid));
    }

    proptest! {
        #[test]
        fn what_is_thick_covers_a_centre(
            (x, y) in (0.0_f64..1.0, 0.0_f64..1.0),
            (width, height) in (0.1_f64..4.0, 0.1_f64..40.0),
            cell_m in 0.25_f64..1.0,
        ) {
            let footprint = rectangle(x, y, width, height);
            if is_thick(&footprint, cell_m) {
                prop_assert!(covers_center(&footprint, cell_m, &GridConfig::default()));
            }
        }
    }
}
