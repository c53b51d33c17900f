//! One orientation, one unit, one mask.

use ndarray::{Array2, s};

use super::check::{Geometry, no_path};
use super::convert::to_rsrp;
use super::load::LoadedMap;
use super::metadata::{RadioMapMetadata, RowOrder};
use crate::config::GridConfig;
use crate::manifest::MaskCounts;
use crate::units::Dbm;

/// An outdoor cell that some path reaches.
pub const MASK_REACHED: u8 = 0;
/// A cell that lies wholly in buildings.
pub const MASK_BUILDING: u8 = 1;
/// An outdoor cell without a path.
pub const MASK_UNREACHED: u8 = 2;

/// A map in the form that everything after the import uses; `[n, n]`, row 0 north,
/// column 0 west, over the central window.
#[derive(Debug, Clone, PartialEq)]
pub struct AlignedMap {
    /// RSRP in dBm per resource element; the floor where the mask is not 0.
    pub rsrp_dbm: Array2<f32>,
    /// [`MASK_REACHED`], [`MASK_BUILDING`] or [`MASK_UNREACHED`].
    pub mask: Array2<u8>,
    /// Cells by the mask's value.
    pub counts: MaskCounts,
}

/// Turns, crops and converts a checked map, and lays the tile's buildings over it: what a
/// solver put inside of buildings (refraction fills them) is not outdoor coverage.
///
/// `occupied` is the tile's central window, true where a building is as high as the
/// flight height; a map's cell is a building only if all of it is.
pub(super) fn align(
    map: &LoadedMap,
    metadata: &RadioMapMetadata,
    geometry: &Geometry,
    occupied: &Array2<bool>,
    grid: &GridConfig,
    floor: Dbm,
) -> AlignedMap {
    let Geometry { cell_m, offset, cells } = *geometry;
    let is_no_path = no_path(metadata, map.dtype);
    let last = map.values.nrows() - 1;
    let mut rsrp_dbm = Array2::from_elem((cells, cells), floor.0 as f32);
    let mut mask = Array2::from_elem((cells, cells), MASK_UNREACHED);
    let mut counts = MaskCounts::default();
    for row in 0..cells {
        let source_row = match metadata.row_order {
            RowOrder::NorthFirst => offset + row,
            RowOrder::SouthFirst => last - (offset + row),
        };
        for column in 0..cells {
            let at = [row, column];
            let value = map.values[[source_row, offset + column]];
            if is_building(occupied, row, column, cell_m / grid.cell_m) {
                mask[at] = MASK_BUILDING;
                counts.building += 1;
            } else if is_no_path(value) {
                counts.unreached += 1;
            } else {
                mask[at] = MASK_REACHED;
                rsrp_dbm[at] = to_rsrp(value, map.kind, metadata).0 as f32;
                counts.reached += 1;
            }
        }
    }
    AlignedMap { rsrp_dbm, mask, counts }
}

/// Whether all of a map's cell is occupied; `ratio` is its side in cells of the grid,
/// which is a whole number or one over a whole number.
fn is_building(occupied: &Array2<bool>, row: usize, column: usize, ratio: f64) -> bool {
    let range = |index: usize| {
        let start = (index as f64 * ratio).round().max(0.0);
        // Cells finer than the grid's lie in one cell of it.
        let start = if ratio < 1.0 { ((index as f64 + 0.5) * ratio).floor() } else { start };
        start as usize..start as usize + (ratio.round() as usize).max(1)
    };
    occupied.slice(s![range(row), range(column)]).iter().all(|&occupied| occupied)
}
