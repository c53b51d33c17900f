//! The arrays of a record.

use ndarray::Array2;

use crate::manifest::ErrorGrids;
use crate::store::{Element, NpyError, read_npy};

/// The arrays of a record, `[n, n]`, row 0 north, column 0 west.
#[derive(Debug, Clone, PartialEq)]
pub struct Grids {
    /// Heights in metres.
    pub height_m: Array2<f32>,
    /// RSRP in dBm per resource element.
    pub rsrp_dbm: Array2<f32>,
    /// 0 outdoor reached, 1 building, 2 outdoor unreached.
    pub mask: Array2<u8>,
    /// Errors of the levels, where the map has several repeats.
    pub errors: Option<ErrorGrids>,
}

/// Why bytes are no record, or no sound one.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordError {
    /// No MessagePack of this schema.
    #[error("no record of schema record.v1 or record.v2: {0}")]
    Encoding(String),
    /// An array is damaged.
    #[error("array {field}: {source}")]
    Array {
        /// The field.
        field: &'static str,
        /// What is wrong with it.
        source: NpyError,
    },
    /// Values that contradict the schema's meaning.
    #[error("{field}: found {found}, expected {expected}")]
    Value {
        /// The field.
        field: &'static str,
        /// What is there.
        found: String,
        /// What should be.
        expected: String,
    },
}

/// One of the arrays.
pub(super) fn matrix<T: Element>(
    field: &'static str,
    bytes: &[u8],
    cells: usize,
) -> Result<Array2<T>, RecordError> {
    let array: Array2<T> = read_npy(bytes)
        .and_then(|npy| npy.to_array2())
        .map_err(|source| RecordError::Array { field, source })?;
    if array.dim() == (cells, cells) {
        return Ok(array);
    }
    Err(RecordError::Value {
        field,
        found: format!("shape {:?}", array.dim()),
        expected: format!("{:?}", (cells, cells)),
    })
}
