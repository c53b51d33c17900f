//! The central window of a map, north up, and what stands on it.

use ndarray::{Array2, ArrayView2, Axis, Zip, s};

use super::check::{Geometry, no_path};
use super::map::{LoadedMap, Relative};
use super::metadata::{RadioMapMetadata, RowOrder};

/// The window as the map has it: `[n, n]`, row 0 north, column 0 west.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MapWindow {
    /// Values in the unit of the file.
    pub(super) values: Array2<f64>,
    /// Whether a path arrives.
    pub(super) reached: Array2<bool>,
}

impl MapWindow {
    /// Turns north up and cuts the window out.
    pub(super) fn cut(map: &LoadedMap, metadata: &RadioMapMetadata, geometry: &Geometry) -> Self {
        let values = cut(map.values.view(), metadata.row_order, geometry);
        let is_no_path = no_path(metadata, map.dtype);
        let reached = values.mapv(|value| !is_no_path(value));
        Self { values, reached }
    }
}

/// What repeats tell of the same window, where there are several.
pub(super) fn cut_repeats(
    map: &LoadedMap,
    metadata: &RadioMapMetadata,
    geometry: &Geometry,
) -> Option<Array2<Relative>> {
    let relative = map.repeats.as_ref()?.relative(map, metadata);
    Some(cut(relative.view(), metadata.row_order, geometry))
}

fn cut<T: Clone>(
    mut map: ArrayView2<'_, T>,
    row_order: RowOrder,
    geometry: &Geometry,
) -> Array2<T> {
    let range = geometry.offset..geometry.offset + geometry.cells;
    if row_order == RowOrder::SouthFirst {
        map.invert_axis(Axis(0));
    }
    map.slice(s![range.clone(), range]).to_owned()
}

/// What the height grid has on a map's cells, `[n, n]`, row 0 north, column 0 west. Cells that
/// are partly built are neither.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Occupancy {
    /// All of the cell is built.
    pub(super) building: Array2<bool>,
    /// None of the cell is built.
    pub(super) outdoor: Array2<bool>,
}

impl Occupancy {
    /// `occupied` is the tile's central window, true where a building is as high as the flight
    /// height; `ratio` is the side of a map's cell in cells of the grid, a whole number or one
    /// over a whole number.
    pub(super) fn new(occupied: &Array2<bool>, cells: usize, ratio: f64) -> Self {
        let of_cell = |cell: ArrayView2<'_, bool>| {
            let count = cell.iter().filter(|&&occupied| occupied).count();
            (count > 0, count == cell.len())
        };
        let built = if ratio < 1.0 {
            // Cells finer than the grid's lie in one cell of it.
            let at = |index: usize| ((index as f64 + 0.5) * ratio).floor() as usize;
            let cell = |(row, column)| {
                of_cell(occupied.slice(s![at(row)..=at(row), at(column)..=at(column)]))
            };
            Array2::from_shape_fn((cells, cells), cell)
        } else {
            let side = ratio.round() as usize;
            let covered = occupied.slice(s![..cells * side, ..cells * side]);
            Zip::from(covered.exact_chunks((side, side))).map_collect(of_cell)
        };
        Self { building: built.mapv(|(_, all)| all), outdoor: built.mapv(|(any, _)| !any) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Coarser, equal and finer cells; what is partly built is neither.
    #[test]
    fn surroundings_are_those_of_the_maps_own_cells() {
        let occupied = Array2::from_shape_fn((4, 4), |(row, column)| row < 2 && column < 3);
        let count = |grid: &Array2<bool>| grid.iter().filter(|&&is| is).count();
        for (cells, ratio, building, outdoor) in
            [(2, 2.0, 1, 2), (4, 1.0, 6, 10), (8, 0.5, 24, 40), (16, 0.25, 96, 160), (1, 4.0, 0, 0)]
        {
            let Occupancy { building: b, outdoor: o } = Occupancy::new(&occupied, cells, ratio);
            assert_eq!((count(&b), count(&o)), (building, outdoor), "{cells} cells");
            assert!(b.is_empty() || cells < 2 || b[[0, 0]]);
        }
    }
}
