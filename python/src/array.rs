//! Arrays of NumPy that take over vectors.

use numpy::{Element, IntoPyArray, PyArray1, PyArrayMethods, PyReadonlyArray1, ndarray};
use pyo3::prelude::*;
use pyo3::types::PyAny;

/// A vector as an array of a shape, without a copy.
pub(crate) fn array<'py, T: Element, const N: usize>(
    py: Python<'py>,
    values: Vec<T>,
    shape: [usize; N],
) -> PyResult<Bound<'py, PyAny>> {
    let flat: Bound<'py, PyArray1<T>> = values.into_pyarray(py);
    Ok(flat.reshape(ndarray::IxDyn(&shape))?.into_any())
}

/// A grid as an array, without a copy.
pub(crate) fn grid<T: Element>(
    py: Python<'_>,
    values: holescout::ndarray::Array2<T>,
) -> PyResult<Bound<'_, PyAny>> {
    let (rows, columns) = values.dim();
    // Grids of a record are stored row by row, from their first value on.
    let values = values.into_raw_vec_and_offset().0;
    array(py, values, [rows, columns])
}

/// The values of an array of one dimension; an array that is not contiguous is copied.
pub(crate) fn values<T: Element + Copy>(array: &PyReadonlyArray1<'_, T>) -> Vec<T> {
    array.as_array().iter().copied().collect()
}
