//! One orientation, one unit, one mask.

use ndarray::Array2;

use super::convert::to_rsrp;
use super::map::{AlignedMap, Relative};
use super::metadata::RadioMapMetadata;
use super::window::{MapWindow, Occupancy};
use crate::manifest::{
    ErrorGrids, MASK_BUILDING, MASK_REACHED, MASK_UNREACHED, MaskCounts, ValueKind,
};
use crate::reliability::std_error_db;
use crate::units::Dbm;

/// Converts a checked map and lays the tile's buildings over it: what a solver put inside of
/// buildings (refraction fills them) is not outdoor coverage. A cell of a map is a building
/// only if all of it is.
pub(super) fn align(
    window: &MapWindow,
    repeats: Option<&Array2<Relative>>,
    kind: ValueKind,
    metadata: &RadioMapMetadata,
    occupancy: &Occupancy,
    floor: Dbm,
) -> AlignedMap {
    let shape = window.values.raw_dim();
    let mut rsrp_dbm = Array2::from_elem(shape, floor.0 as f32);
    let mut mask = Array2::from_elem(shape, MASK_UNREACHED);
    let mut counts = MaskCounts::default();
    for (at, &value) in window.values.indexed_iter() {
        if occupancy.building[at] {
            mask[at] = MASK_BUILDING;
            counts.building += 1;
        } else if window.reached[at] {
            mask[at] = MASK_REACHED;
            rsrp_dbm[at] = to_rsrp(value, kind, metadata).0 as f32;
            counts.reached += 1;
        } else {
            counts.unreached += 1;
        }
    }
    let errors = repeats.map(|repeats| errors(repeats, &mask));
    AlignedMap { rsrp_dbm, mask, errors, counts }
}

fn errors(repeats: &Array2<Relative>, mask: &Array2<u8>) -> ErrorGrids {
    let of_reached = |value: &dyn Fn(&Relative) -> f64| {
        Array2::from_shape_fn(mask.raw_dim(), |at| match mask[at] {
            MASK_REACHED => value(&repeats[at]) as f32,
            _ => 0.0,
        })
    };
    let has_half = repeats.iter().any(|cell| cell.first_half.is_some());
    ErrorGrids {
        std_error_db: of_reached(&|cell| std_error_db(cell.std_error)),
        first_half_share: has_half.then(|| of_reached(&|cell| cell.first_half.unwrap_or(0.0))),
    }
}
