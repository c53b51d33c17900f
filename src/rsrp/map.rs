//! A map on its way: as its file has it, with what its repeats tell, and aligned.

use ndarray::Array2;

use crate::manifest::{ErrorGrids, MaskCounts, ValueKind};
use crate::store::DType;

/// A map as its file has it.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadedMap {
    /// Values in the file's unit and row order, C layout.
    pub values: Array2<f64>,
    /// What the values are.
    pub kind: ValueKind,
    /// Type of the elements in the file.
    pub dtype: DType,
    /// East, north and up of the map's transmitter from the centre on the ground, in metres.
    pub tx_position_m: [f64; 3],
    /// What lies beside the values, where they are means of several repeats.
    pub repeats: Option<Repeats>,
}

/// A map, and where it lies in its array.
pub(super) struct PlacedArray {
    pub(super) map: LoadedMap,
    pub(super) shape: Vec<usize>,
    pub(super) index: usize,
}

/// The arrays beside the values of a map, in the file's row order, C layout.
#[derive(Debug, Clone, PartialEq)]
pub struct Repeats {
    /// Independent repeats, at least two.
    pub count: u32,
    /// Standard errors in linear units where the values are linear, else in dB.
    pub std_error: Array2<f64>,
    /// Mean of the first half of the repeats, in the unit of the values.
    pub first_half: Option<Array2<f64>>,
}

/// What repeats tell of a cell, relative to the mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Relative {
    /// Standard error over the mean.
    pub(super) std_error: f64,
    /// Of the summed power, what the first half received.
    pub(super) first_half: Option<f64>,
}

/// A map in the form that everything after the import uses; `[n, n]`, row 0 north,
/// column 0 west, over the central window.
#[derive(Debug, Clone, PartialEq)]
pub struct AlignedMap {
    /// RSRP in dBm per resource element; the floor where the mask is not 0.
    pub rsrp_dbm: Array2<f32>,
    /// [`MASK_REACHED`](crate::manifest::MASK_REACHED), [`MASK_BUILDING`](crate::manifest::MASK_BUILDING) or [`MASK_UNREACHED`](crate::manifest::MASK_UNREACHED).
    pub mask: Array2<u8>,
    /// What repeats tell, where there are several; 0 where the mask is not 0.
    pub errors: Option<ErrorGrids>,
    /// Cells by the mask's value.
    pub counts: MaskCounts,
}
