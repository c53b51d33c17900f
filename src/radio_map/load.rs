//! From a file to a matrix of numbers and its metadata; nothing is judged yet.

use std::path::{Path, PathBuf};

use ndarray::Array2;

use super::metadata::RadioMapMetadata;
use super::rejection::{Rejection, RejectionCode};
use crate::manifest::ValueKind;
use crate::store::{DType, Npy, NpyError, NpzError, NpzReader, read_npy};

/// Array names that tell the kind of values.
const TELLING_NAMES: [(&str, ValueKind); 9] = [
    ("path_gain", ValueKind::PathGainLinear),
    ("path_gain_linear", ValueKind::PathGainLinear),
    ("path_gain_db", ValueKind::PathGainDb),
    ("path_loss_db", ValueKind::PathLossDb),
    ("rss_w", ValueKind::RssW),
    ("rss_data", ValueKind::RssW),
    ("rss_dbm", ValueKind::RssDbm),
    ("rx_power_dbm", ValueKind::RssDbm),
    ("rsrp_dbm", ValueKind::RsrpDbm),
];
/// Array names that leave it open.
const OPEN_NAMES: [&str; 3] = ["rss", "rm", "arr_0"];
const METADATA: &str = "meta_json";

/// A map as its file has it.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadedMap {
    /// Values in the file's unit and row order, C layout.
    pub values: Array2<f64>,
    /// What the values are.
    pub kind: ValueKind,
    /// Type of the elements in the file.
    pub dtype: DType,
}

/// Reads the metadata of a `.npz`, or those beside a `.npy`.
///
/// # Errors
/// A [`Rejection`] if there are none or they cannot be understood.
pub fn load_metadata(path: &Path, limit: u64) -> Result<RadioMapMetadata, Rejection> {
    match extension(path) {
        "npz" => {
            let mut archive = NpzReader::open(path, limit).map_err(|error| of_npz(&error))?;
            if !archive.names().iter().any(|name| name == METADATA) {
                return Err(no_metadata("no meta_json in the archive"));
            }
            let member = archive.member(METADATA).map_err(|error| of_npz(&error))?;
            let npy = read_npy(&member).map_err(|error| of_npy(&error))?;
            let bytes = npy.text().ok_or_else(|| {
                Rejection::new(
                    RejectionCode::InvalidMetadata,
                    "meta_json as an array of uint8, or a string",
                    npy.dtype.name(),
                    "save it with np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8)",
                )
            })?;
            RadioMapMetadata::parse(&bytes)
        }
        "npy" => {
            refuse_pickles(path, limit)?;
            let sidecar = path.with_extension("json");
            let bytes = std::fs::read(&sidecar)
                .map_err(|_| no_metadata("a bare array: no .json of the same name beside it"))?;
            RadioMapMetadata::parse(&bytes)
        }
        _ => Err(unsupported(path)),
    }
}

/// Reads the array of a map.
///
/// # Errors
/// A [`Rejection`] if it cannot be read, is ambiguous, or is no single matrix.
pub fn load_values(
    path: &Path,
    metadata: &RadioMapMetadata,
    limit: u64,
) -> Result<LoadedMap, Rejection> {
    let (name, bytes) = match extension(path) {
        "npz" => {
            let mut archive = NpzReader::open(path, limit).map_err(|error| of_npz(&error))?;
            let name = value_array(&archive.names())?;
            let bytes = archive.member(&name).map_err(|error| of_npz(&error))?;
            (Some(name), bytes)
        }
        "npy" => (None, read_limited(path, limit)?),
        _ => return Err(unsupported(path)),
    };
    let npy = read_npy(&bytes).map_err(|error| of_npy(&error))?;
    let kind = value_kind(name.as_deref(), metadata.value_kind)?;
    check_type(npy.dtype, kind)?;
    let values = matrix(&npy)?;
    Ok(LoadedMap { values, kind, dtype: npy.dtype })
}

/// Whether a file may be meant as a map, going by its name.
pub(super) fn may_be_map(path: &Path) -> bool {
    const MAPS: [&str; 12] =
        ["npz", "npy", "h5", "hdf5", "mat", "png", "tif", "tiff", "csv", "pkl", "pickle", "pt"];
    MAPS.contains(&extension(path).to_ascii_lowercase().as_str())
}

fn extension(path: &Path) -> &str {
    path.extension().and_then(|extension| extension.to_str()).unwrap_or("")
}

fn unsupported(path: &Path) -> Rejection {
    let mend = match extension(path).to_ascii_lowercase().as_str() {
        "h5" | "hdf5" => "load it with h5py and save it with np.savez",
        "mat" => "load it with scipy.io.loadmat and save it with np.savez",
        "png" | "tif" | "tiff" => "images lose the values: save the solver's array with np.savez",
        "csv" => "load it with np.loadtxt (mind the sign of y) and save it with np.savez",
        _ => "load it with the program that wrote it and save it with np.savez",
    };
    let found = format!("a .{} file", extension(path));
    Rejection::new(RejectionCode::UnsupportedFormat, ".npz, or .npy with .json", found, mend)
}

fn no_metadata(found: &str) -> Rejection {
    Rejection::new(
        RejectionCode::MissingMetadata,
        "metadata (schema radio_map.v1) as meta_json in the .npz, or as .json beside the .npy",
        found,
        "write them when the map is traced; see schemas/radio_map.v1.json",
    )
}

fn of_npz(error: &NpzError) -> Rejection {
    match error {
        NpzError::File(error) => unreadable(error),
        NpzError::TooLarge { .. } => too_large(error.to_string()),
        other => damaged(other.to_string()),
    }
}

fn of_npy(error: &NpyError) -> Rejection {
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

fn too_large(found: String) -> Rejection {
    let expected = "an array within rsrp.max_array_mib";
    Rejection::new(RejectionCode::TooLarge, expected, found, "crop the map, or raise the limit")
}

fn damaged(found: String) -> Rejection {
    let mend = "write or copy the file again";
    Rejection::new(RejectionCode::Damaged, "an undamaged NumPy file", found, mend)
}

fn read_limited(path: &Path, limit: u64) -> Result<Vec<u8>, Rejection> {
    let size = path.metadata().map_err(|error| unreadable(&error))?.len();
    if size > limit {
        return Err(too_large(format!("{size} bytes")));
    }
    std::fs::read(path).map_err(|error| unreadable(&error))
}

/// A pickle is named as such even where metadata are missing too: it is the graver mistake.
fn refuse_pickles(path: &Path, limit: u64) -> Result<(), Rejection> {
    match read_npy(&read_limited(path, limit)?) {
        Err(NpyError::Pickled) => Err(of_npy(&NpyError::Pickled)),
        _ => Ok(()),
    }
}

/// The one array that is the map.
fn value_array(names: &[String]) -> Result<String, Rejection> {
    let known = |name: &&String| {
        TELLING_NAMES.iter().any(|(known, _)| known == name) || OPEN_NAMES.contains(&name.as_str())
    };
    let candidates: Vec<&String> = names.iter().filter(known).collect();
    let all = || TELLING_NAMES.map(|(name, _)| name).join(", ");
    match candidates[..] {
        [name] => Ok(name.clone()),
        [] => Err(Rejection::new(
            RejectionCode::NoValueArray,
            format!("an array named one of {}", all()),
            format!("{names:?}"),
            "name the array after what it holds: np.savez(path, path_gain=array)",
        )),
        _ => Err(Rejection::new(
            RejectionCode::SeveralValueArrays,
            "one array of values",
            format!("{candidates:?}"),
            "save only one of them",
        )),
    }
}

fn value_kind(name: Option<&str>, declared: Option<ValueKind>) -> Result<ValueKind, Rejection> {
    let told = TELLING_NAMES.iter().find(|(known, _)| Some(*known) == name).map(|(_, kind)| *kind);
    match (told, declared) {
        (Some(told), Some(declared)) if told != declared => Err(Rejection::new(
            RejectionCode::ContradictingValueKind,
            format!("value_kind = {}, after the array's name", told.name()),
            format!("value_kind = {}", declared.name()),
            "rename the array or correct value_kind",
        )),
        (Some(kind), _) | (None, Some(kind)) => Ok(kind),
        (None, None) => Err(Rejection::new(
            RejectionCode::UnknownValueKind,
            "value_kind in the metadata",
            format!("an array named {:?}, which may be anything", name.unwrap_or("(bare .npy)")),
            "set value_kind to path_gain_linear, path_gain_db, rss_w, rss_dbm, rsrp_dbm or path_loss_db",
        )),
    }
}

fn check_type(dtype: DType, kind: ValueKind) -> Result<(), Rejection> {
    let reject = |expected: &str, mend: &str| {
        let found = format!("{} of {}", kind.name(), dtype.name());
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

/// The values as a matrix; a leading axis of one transmitter is dropped.
fn matrix(npy: &Npy<'_>) -> Result<Array2<f64>, Rejection> {
    let (rows, columns) = match npy.shape[..] {
        [rows, columns] | [1, rows, columns] => (rows, columns),
        [n, rows, columns] if rows == columns => return Err(several(n, &npy.shape)),
        [rows, columns, n] if rows == columns && n > 1 => return Err(several(n, &npy.shape)),
        _ => return Err(wrong_shape(&npy.shape)),
    };
    if rows != columns || rows == 0 {
        return Err(wrong_shape(&npy.shape));
    }
    let values = npy.values_f64();
    Ok(Array2::from_shape_fn((rows, columns), |(row, column)| {
        // In Fortran order the first index runs fastest; a leading axis of one changes nothing.
        let at = if npy.fortran_order { column * rows + row } else { row * columns + column };
        values[at]
    }))
}

fn several(count: usize, shape: &[usize]) -> Rejection {
    Rejection::new(
        RejectionCode::SeveralTransmitters,
        "the map of one transmitter",
        format!("shape {shape:?}: {count} of them"),
        "save one file a transmitter, for instance path_gain=rm.path_gain[0]",
    )
}

fn wrong_shape(shape: &[usize]) -> Rejection {
    Rejection::new(
        RejectionCode::WrongShape,
        "[n, n] or [1, n, n]",
        format!("{shape:?}"),
        "trace a square map with square cells",
    )
}

/// The files of a directory that may be maps, and the names of the others; both sorted.
pub(super) fn list(directory: &Path) -> std::io::Result<(Vec<PathBuf>, Vec<String>)> {
    let mut paths = std::fs::read_dir(directory)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<std::io::Result<Vec<_>>>()?;
    paths.sort();
    let (maps, others): (Vec<_>, Vec<_>) =
        paths.into_iter().filter(|path| path.is_file()).partition(|path| may_be_map(path));
    // A .json beside an .npy is its metadata.
    let is_sidecar =
        |path: &PathBuf| extension(path) == "json" && maps.contains(&path.with_extension("npy"));
    let name = |path: PathBuf| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let ignored = others.into_iter().filter(|path| !is_sidecar(path)).filter_map(name).collect();
    Ok((maps, ignored))
}
