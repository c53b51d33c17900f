//! Any bytes as `.npy`: what is read has as many values as its shape says, and written again by
//! `ndarray-npy` it is the same array.
#![no_main]

use half::f16;
use holescout::store::{DType, Element, Npy, npy_bytes, read_npy};
use holescout_fuzz as _;
use libfuzzer_sys::fuzz_target;
use ndarray::Array2;

fn matrix<T: Element + Into<f64>>(npy: &Npy<'_>) -> Option<Array2<T>> {
    let matrix: Array2<T> = npy.to_array2().ok()?;
    assert_eq!(matrix.shape(), npy.shape);
    let in_file_order = if npy.fortran_order { matrix.t() } else { matrix.view() };
    let values = in_file_order.iter().map(|&value| value.into().to_bits());
    assert!(values.eq(npy.values_f64().into_iter().map(f64::to_bits)));
    Some(matrix)
}

fn written_again<T>(npy: &Npy<'_>)
where
    T: Element + Into<f64> + ndarray_npy::WritableElement,
{
    let Some(matrix) = matrix::<T>(npy) else { return };
    let bytes = npy_bytes(&matrix);
    let again: Array2<T> = read_npy(&bytes).and_then(|npy| npy.to_array2()).expect("just written");
    assert_eq!(again.dim(), matrix.dim());
    let bits = |&value: &T| value.into().to_bits();
    assert!(again.iter().map(bits).eq(matrix.iter().map(bits)));
}

fuzz_target!(|bytes: &[u8]| {
    let Ok(npy) = read_npy(bytes) else { return };
    let elements: usize = npy.shape.iter().product();
    let is_text = matches!(npy.dtype, DType::Bytes(_) | DType::Unicode(_));
    assert_eq!(npy.values_f64().len(), if is_text { 0 } else { elements });
    assert!(npy.text().is_none_or(|text| text.len() <= bytes.len()));
    assert!(npy.dtype != DType::UInt8 || npy.text().is_some_and(|text| text.len() == elements));
    matrix::<f16>(&npy);
    written_again::<f32>(&npy);
    written_again::<f64>(&npy);
    written_again::<u8>(&npy);
    written_again::<i16>(&npy);
    written_again::<u16>(&npy);
});
