//! One array of a file, as far as a map may have it.

use std::io::{Read, Seek};

use ndarray::Array2;

use super::array::Layout;
use super::map::PlacedArray;
use super::rejection::{Rejection, RejectionCode};
use crate::manifest::ValueKind;
use crate::store::{DType, Npy, NpyError, NpzError, NpzReader, read_npy};

/// The part of an array beside the values `name` that belongs to their map.
pub(super) fn member_matrix<R: Read + Seek>(
    archive: &mut NpzReader<R>,
    array: &str,
    name: &str,
    placed: &PlacedArray,
) -> Result<Array2<f64>, Rejection> {
    let bytes = archive.member(array).map_err(|error| of_npz(&error))?;
    let npy = float_array(&bytes)?;
    check_type(npy.dtype, placed.map.kind, array)?;
    if npy.shape != placed.shape {
        return Err(Rejection::new(
            RejectionCode::ErrorShape,
            format!("{array} of shape {:?}, as {name} has", placed.shape),
            format!("{:?}", npy.shape),
            "save it with the shape of the values",
        ));
    }
    Ok(Layout::of(&npy.shape)?.matrix(&npy, placed.index))
}

/// An array; no map of a solver has integers.
pub(super) fn float_array(bytes: &[u8]) -> Result<Npy<'_>, Rejection> {
    let npy = read_npy(bytes).map_err(|error| of_npy(&error))?;
    let kind = match npy.dtype {
        DType::Int16 => "i2",
        DType::UInt16 => "u2",
        _ => return Ok(npy),
    };
    let order = if npy.big_endian { '>' } else { '<' };
    Err(of_npy(&NpyError::DType(format!("'{order}{kind}'"))))
}

/// Whether elements of a type can be `what`: values of a kind, or their errors.
pub(super) fn check_type(dtype: DType, kind: ValueKind, what: &str) -> Result<(), Rejection> {
    let reject = |expected: &str, mend: &str| {
        let found = format!("{what} of {}", dtype.name());
        Err(Rejection::new(RejectionCode::UnsupportedType, expected, found, mend))
    };
    match dtype {
        DType::UInt8 | DType::Bytes(_) | DType::Unicode(_) => {
            reject("floating-point values", "save the solver's array, not an image or text")
        }
        DType::Float16 if kind.is_linear() => reject(
            "float32 or float64: float16 rounds nearly all linear gains to zero",
            "save it as float32, or in dB",
        ),
        _ => Ok(()),
    }
}

pub(super) fn of_npz(error: &NpzError) -> Rejection {
    match error {
        NpzError::File(error) => unreadable(error),
        NpzError::TooLarge { .. } => too_large(error.to_string()),
        other => damaged(other.to_string()),
    }
}

pub(super) fn of_npy(error: &NpyError) -> Rejection {
    match error {
        NpyError::Pickled => Rejection::new(
            RejectionCode::Pickled,
            "a plain array of numbers",
            "pickled Python objects, which are never loaded",
            "save the array itself: np.savez(path, path_gain=array)",
        ),
        NpyError::DType(found) => Rejection::new(
            RejectionCode::UnsupportedType,
            "float32 or float64, float16 for dB",
            found,
            "convert with .astype(np.float32)",
        ),
        other => damaged(other.to_string()),
    }
}

pub(super) fn unreadable(error: &impl ToString) -> Rejection {
    let (expected, mend) = ("a readable file", "check the file's permissions");
    Rejection::new(RejectionCode::Unreadable, expected, error.to_string(), mend)
}

pub(super) fn too_large(found: String) -> Rejection {
    let expected = "an array within rsrp.max_array_mib";
    Rejection::new(RejectionCode::TooLarge, expected, found, "crop the map, or raise the limit")
}

pub(super) fn damaged(found: String) -> Rejection {
    let mend = "write or copy the file again";
    Rejection::new(RejectionCode::Damaged, "an undamaged NumPy file", found, mend)
}
