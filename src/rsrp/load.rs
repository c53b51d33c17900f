//! From a file to a matrix of numbers and its metadata; nothing is judged yet.

use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

use super::array::{Layout, positions};
use super::complete::{ArrayFacts, Supplement};
use super::map::{LoadedMap, PlacedArray};
use super::member::{check_type, float_array, of_npy, of_npz, too_large, unreadable};
use super::metadata::{RadioMapMetadata, parse_object};
use super::rejection::{Rejection, RejectionCode, some};
use super::repeats;
use crate::error::FileError;
use crate::manifest::ValueKind;
use crate::store::{MAX_METADATA, NpyError, NpzReader, read_npy};

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

/// Positions of transmitters in files of sionna-large-radio-maps, `[3, n]` or `[n, 3]`.
const POSITIONS: &str = "tx_positions";

/// Metadata of a map, and which of them its producer did not write.
#[derive(Debug, Clone, PartialEq)]
pub struct Described {
    /// The metadata, complete.
    pub metadata: RadioMapMetadata,
    /// Keys that a [`Supplement`] added, sorted.
    pub assumed: Vec<String>,
}

/// Reads the metadata of a `.npz`, or those in the `.json` beside a file.
///
/// # Errors
/// A [`Rejection`] if there are none or they cannot be understood.
pub fn load_metadata(
    path: &Path,
    limit: u64,
    supplement: &Supplement<'_>,
) -> Result<Described, Rejection> {
    match extension(path) {
        "npz" => {
            let mut archive = NpzReader::open(path, limit).map_err(|error| of_npz(&error))?;
            describe_archive(&mut archive, path, supplement)
        }
        "npy" => {
            let facts = facts_of_npy(path, limit)?;
            let found = "a bare array: no .json of the same name beside it";
            describe(read_sidecar(path)?.ok_or(found), path, supplement, &facts)
        }
        _ => Err(unsupported(path)),
    }
}

/// Reads the array of a map; of several transmitters, that of `tx` (counted from 0).
///
/// # Errors
/// A [`Rejection`] if it cannot be read, is ambiguous, or is no single matrix.
pub fn load_values(
    path: &Path,
    metadata: &RadioMapMetadata,
    limit: u64,
    tx: Option<usize>,
) -> Result<LoadedMap, Rejection> {
    match extension(path) {
        "npz" => {
            let mut archive = NpzReader::open(path, limit).map_err(|error| of_npz(&error))?;
            archive_values(&mut archive, metadata, tx)
        }
        "npy" => {
            repeats::none_in_npy(metadata)?;
            Ok(map_of(&read_limited(path, limit)?, None, metadata, tx)?.map)
        }
        _ => Err(unsupported(path)),
    }
}

/// Reads metadata and array of a `.npz` that need not be a file; `name` stands for its path.
///
/// # Errors
/// As [`load_metadata`] and [`load_values`].
pub fn load_archive<R: Read + Seek>(
    source: R,
    name: &Path,
    limit: u64,
    supplement: &Supplement<'_>,
    tx: Option<usize>,
) -> Result<(Described, LoadedMap), Rejection> {
    let mut archive = NpzReader::new(source, limit).map_err(|error| of_npz(&error))?;
    let described = describe_archive(&mut archive, name, supplement)?;
    let map = archive_values(&mut archive, &described.metadata, tx)?;
    Ok((described, map))
}

fn describe_archive<R: Read + Seek>(
    archive: &mut NpzReader<R>,
    path: &Path,
    supplement: &Supplement<'_>,
) -> Result<Described, Rejection> {
    let found = "no meta_json in the archive, and no .json of the same name beside it";
    let has_metadata = archive.names().iter().any(|name| name == METADATA);
    let written = if has_metadata { Some(archive_metadata(archive)?) } else { read_sidecar(path)? };
    let facts = if supplement.is_active() { facts_of_npz(archive)? } else { ArrayFacts::default() };
    describe(written.ok_or(found), path, supplement, &facts)
}

/// Metadata as they are written, or what was found instead, with what is to be added.
fn describe(
    written: Result<Vec<u8>, &str>,
    path: &Path,
    supplement: &Supplement<'_>,
    facts: &ArrayFacts,
) -> Result<Described, Rejection> {
    let mut object = match written {
        Ok(json) => parse_object(&json)?,
        Err(_) if supplement.is_active() => serde_json::Map::new(),
        Err(found) => return Err(no_metadata(found)),
    };
    let assumed = if supplement.is_active() {
        supplement.complete(&mut object, path, facts)
    } else {
        Vec::new()
    };
    Ok(Described { metadata: RadioMapMetadata::from_object(object)?, assumed })
}

fn archive_values<R: Read + Seek>(
    archive: &mut NpzReader<R>,
    metadata: &RadioMapMetadata,
    tx: Option<usize>,
) -> Result<LoadedMap, Rejection> {
    let name = value_array(&archive.names())?;
    let bytes = archive.member(&name).map_err(|error| of_npz(&error))?;
    let placed = map_of(&bytes, Some(&name), metadata, tx)?;
    let repeats = repeats::beside(archive, &name, &placed, metadata)?;
    Ok(LoadedMap { repeats, ..placed.map })
}

/// The map in an `.npy` file; `name` is that of the array in an archive.
fn map_of(
    bytes: &[u8],
    name: Option<&str>,
    metadata: &RadioMapMetadata,
    tx: Option<usize>,
) -> Result<PlacedArray, Rejection> {
    let npy = float_array(bytes)?;
    let kind = value_kind(name, metadata.value_kind)?;
    check_type(npy.dtype, kind, kind.name())?;
    let layout = Layout::of(&npy.shape)?;
    let positions = metadata.tx_position_m.all();
    let index = layout.choose(positions.len(), tx)?;
    let values = layout.matrix(&npy, index);
    let (dtype, tx_position_m) = (npy.dtype, positions[index]);
    let map = LoadedMap { values, kind, dtype, tx_position_m, repeats: None };
    Ok(PlacedArray { map, shape: npy.shape, index })
}

fn archive_metadata<R: Read + Seek>(archive: &mut NpzReader<R>) -> Result<Vec<u8>, Rejection> {
    let member = archive.metadata(METADATA).map_err(|error| of_npz(&error))?;
    let npy = read_npy(&member).map_err(|error| of_npy(&error))?;
    npy.text().ok_or_else(|| {
        Rejection::new(
            RejectionCode::InvalidMetadata,
            "meta_json as an array of uint8, or a string",
            npy.dtype.name(),
            "save it with np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8)",
        )
    })
}

/// The `.json` of the same name, if there is one.
fn read_sidecar(path: &Path) -> Result<Option<Vec<u8>>, Rejection> {
    let path = path.with_extension("json");
    match path.metadata().map(|metadata| metadata.len()) {
        Ok(size) if size > MAX_METADATA => Err(Rejection::new(
            RejectionCode::TooLarge,
            format!("metadata of at most {MAX_METADATA} bytes"),
            format!("{size} bytes beside the map"),
            "leave out what schema radio_map.v1 does not name",
        )),
        Ok(_) => std::fs::read(path).map(Some).map_err(|error| unreadable(&error)),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(unreadable(&error)),
    }
}

fn facts_of_npz<R: Read + Seek>(archive: &mut NpzReader<R>) -> Result<ArrayFacts, Rejection> {
    let names = archive.names();
    let name = value_array(&names)?;
    let bytes = archive.member(&name).map_err(|error| of_npz(&error))?;
    let npy = read_npy(&bytes).map_err(|error| of_npy(&error))?;
    let cells = Layout::of(&npy.shape).ok().map(|layout| layout.cells);
    let mut tx_from_corner = None;
    if names.iter().any(|name| name == POSITIONS) {
        let bytes = archive.member(POSITIONS).map_err(|error| of_npz(&error))?;
        tx_from_corner = positions(&read_npy(&bytes).map_err(|error| of_npy(&error))?);
    }
    Ok(ArrayFacts { name: Some(name), cells, tx_from_corner })
}

/// A pickle is named as such even where metadata are missing too: it is the graver mistake.
fn facts_of_npy(path: &Path, limit: u64) -> Result<ArrayFacts, Rejection> {
    match read_npy(&read_limited(path, limit)?) {
        Err(NpyError::Pickled) => Err(of_npy(&NpyError::Pickled)),
        Err(_) => Ok(ArrayFacts::default()),
        Ok(npy) => {
            let cells = Layout::of(&npy.shape).ok().map(|layout| layout.cells);
            Ok(ArrayFacts { cells, ..ArrayFacts::default() })
        }
    }
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

fn read_limited(path: &Path, limit: u64) -> Result<Vec<u8>, Rejection> {
    let size = path.metadata().map_err(|error| unreadable(&error))?.len();
    if size > limit {
        return Err(too_large(format!("{size} bytes")));
    }
    std::fs::read(path).map_err(|error| unreadable(&error))
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
            some(names),
            "name the array after what it holds: np.savez(path, path_gain=array)",
        )),
        _ => Err(Rejection::new(
            RejectionCode::SeveralValueArrays,
            "one array of values",
            some(&candidates),
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

/// The files of a directory that may be maps, and the names of the others; both sorted.
///
/// # Errors
/// [`FileError`] when the directory cannot be listed, or what has the name of a map cannot be looked at:
/// a link that leads nowhere is a map that would be missed.
pub(super) fn list(directory: &Path) -> Result<(Vec<PathBuf>, Vec<String>), FileError> {
    let mut paths = std::fs::read_dir(directory)
        .and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>, _>>())
        .map_err(FileError::new("list", directory))?;
    paths.sort();
    let (mut maps, mut others) = (Vec::new(), Vec::new());
    for path in paths {
        if !may_be_map(&path) {
            others.extend(path.is_file().then_some(path));
        } else if std::fs::metadata(&path).map_err(FileError::new("open", &path))?.is_file() {
            maps.push(path);
        }
    }
    // A .json beside a map is its metadata.
    let is_sidecar = |path: &PathBuf| {
        let beside = |extension| maps.binary_search(&path.with_extension(extension)).is_ok();
        extension(path) == "json" && (beside("npy") || beside("npz"))
    };
    let name = |path: PathBuf| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let ignored = others.into_iter().filter(|path| !is_sidecar(path)).filter_map(name).collect();
    Ok((maps, ignored))
}
