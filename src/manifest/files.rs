//! The arrays that manifest entries point to, read back and checked against them.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use ndarray::Array2;
use serde::de::DeserializeOwned;

use super::{ErrorGrids, MapEntry, RsrpMeta, SceneEntry, SceneMeta, TileEntry, TileMeta, Verdict};
use crate::error::{Fault, FileError, HasFault};
use crate::grid::TileId;
use crate::store::{
    Digest, Element, NpyError, NpzError, NpzReader, read_npy, sha256_bytes, sha256_file,
};

/// No array of ours is larger, unpacked.
const MAX_ARRAY: u64 = 1 << 31;

/// Why a file of an earlier stage cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StageFileError {
    /// The operating system failed.
    #[error(transparent)]
    File(#[from] FileError),
    /// The content is not what the manifest says.
    #[error(
        "{}: differs from its manifest: expected {expected}, found {found}; \
         run the stage that wrote it again", path.display()
    )]
    Changed {
        /// The file.
        path: PathBuf,
        /// From the manifest.
        expected: Digest,
        /// From the file.
        found: Digest,
    },
    /// The content is no tile or map.
    #[error("{}: {reason}; run the stage that wrote it again", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

impl HasFault for StageFileError {
    fn fault(&self) -> Fault {
        match self {
            Self::File(error) => error.fault(),
            Self::Changed { .. } | Self::Invalid { .. } => Fault::Input,
        }
    }
}

/// The arrays of a tile, `[L, L]`, row 0 north, column 0 west.
#[derive(Debug, Clone, PartialEq)]
pub struct TileFile {
    /// Heights in metres.
    pub height_m: Array2<f32>,
    /// Source of each height; see [`crate::building::HeightSource`].
    pub height_source: Array2<u8>,
    /// What the file says of itself.
    pub meta: TileMeta,
}

impl TileFile {
    /// Reads a tile and checks it against its entry.
    ///
    /// # Errors
    /// [`StageFileError`] names the file and what differs.
    pub fn read(directory: &Path, entry: &TileEntry) -> Result<Self, StageFileError> {
        let mut arrays = Arrays::open(directory.join(&entry.file), &entry.digest)?;
        Ok(Self {
            height_m: arrays.matrix("height_m")?,
            height_source: arrays.matrix("height_source")?,
            meta: arrays.meta()?,
        })
    }

    /// The heights alone.
    ///
    /// # Errors
    /// As [`TileFile::read`].
    pub fn read_heights(
        directory: &Path,
        entry: &TileEntry,
    ) -> Result<Array2<f32>, StageFileError> {
        Arrays::open(directory.join(&entry.file), &entry.digest)?.matrix("height_m")
    }
}

/// The arrays of an imported map, `[n, n]`, row 0 north, column 0 west.
#[derive(Debug, Clone, PartialEq)]
pub struct RsrpFile {
    /// RSRP in dBm per resource element.
    pub rsrp_dbm: Array2<f32>,
    /// 0 outdoor reached, 1 building, 2 outdoor unreached.
    pub mask: Array2<u8>,
    /// What repeats tell, where there are several.
    pub errors: Option<ErrorGrids>,
    /// What the file says of itself.
    pub meta: RsrpMeta,
}

impl RsrpFile {
    /// Reads a map and checks it against its entry.
    ///
    /// # Errors
    /// [`StageFileError`] names the file and what differs.
    pub fn read(directory: &Path, entry: &MapEntry) -> Result<Self, StageFileError> {
        let mut arrays = Arrays::open(directory.join(&entry.file), &entry.digest)?;
        let meta: RsrpMeta = arrays.meta()?;
        let errors = meta.repeats.map(|_| arrays.errors()).transpose()?;
        Ok(Self {
            rsrp_dbm: arrays.matrix("rsrp_dbm")?,
            mask: arrays.matrix("mask")?,
            errors,
            meta,
        })
    }
}

/// The content of one of a scene's files, checked against the scene's entry.
///
/// # Errors
/// [`StageFileError`] names the file and what differs.
pub fn read_scene_file(
    directory: &Path,
    entry: &SceneEntry,
    name: &str,
) -> Result<Vec<u8>, StageFileError> {
    let file = format!("{}/{name}", entry.id);
    let path = directory.join(&file);
    let Some(listed) = entry.files.iter().find(|listed| listed.file == file) else {
        return Err(invalid(&path, &"not in the manifest"));
    };
    let bytes = std::fs::read(&path).map_err(FileError::new("read", &path))?;
    let found = sha256_bytes(&bytes);
    if found != listed.digest {
        return Err(StageFileError::Changed { path, expected: listed.digest.clone(), found });
    }
    Ok(bytes)
}

/// The description of a scene, checked against the scene's entry.
///
/// # Errors
/// [`StageFileError`] names the file and what differs.
pub fn read_scene_meta(directory: &Path, entry: &SceneEntry) -> Result<SceneMeta, StageFileError> {
    const NAME: &str = "scene.json";
    let json = read_scene_file(directory, entry, NAME)?;
    let path = || directory.join(entry.id.to_string()).join(NAME);
    serde_json::from_slice(&json).map_err(|error| invalid(&path(), &error))
}

struct Arrays {
    path: PathBuf,
    archive: NpzReader<Cursor<Vec<u8>>>,
}

impl Arrays {
    fn open(path: PathBuf, expected: &Digest) -> Result<Self, StageFileError> {
        let size = path.metadata().map_err(FileError::new("read", &path))?.len();
        // A file of another size may be larger than the memory.
        let (bytes, found) = if size == expected.bytes {
            let bytes = std::fs::read(&path).map_err(FileError::new("read", &path))?;
            let found = sha256_bytes(&bytes);
            (bytes, found)
        } else {
            (Vec::new(), sha256_file(&path)?)
        };
        if found != *expected {
            return Err(StageFileError::Changed { path, expected: expected.clone(), found });
        }
        let archive = NpzReader::new(Cursor::new(bytes), MAX_ARRAY);
        let archive = archive.map_err(|error| invalid(&path, &error))?;
        Ok(Self { path, archive })
    }

    fn member(&mut self, name: &str) -> Result<Vec<u8>, StageFileError> {
        let bytes: Result<_, NpzError> = self.archive.member(name);
        bytes.map_err(|error| invalid(&self.path, &error))
    }

    fn matrix<T: Element>(&mut self, name: &str) -> Result<Array2<T>, StageFileError> {
        let bytes = self.member(name)?;
        let matrix: Result<_, NpyError> = read_npy(&bytes).and_then(|npy| npy.to_array2());
        matrix.map_err(|error| invalid(&self.path, &error))
    }

    fn errors(&mut self) -> Result<ErrorGrids, StageFileError> {
        const HALF: &str = "first_half_share";
        let has_half = self.archive.names().iter().any(|name| name == HALF);
        Ok(ErrorGrids {
            std_error_db: self.matrix("std_error_db")?,
            first_half_share: has_half.then(|| self.matrix(HALF)).transpose()?,
        })
    }

    fn meta<T: DeserializeOwned>(&mut self) -> Result<T, StageFileError> {
        let bytes = self.archive.metadata("meta_json");
        let bytes = bytes.map_err(|error| invalid(&self.path, &error))?;
        let npy = read_npy(&bytes).map_err(|error| invalid(&self.path, &error))?;
        let json = npy.text().ok_or_else(|| invalid(&self.path, &"meta_json is no text"))?;
        serde_json::from_slice(&json).map_err(|error| invalid(&self.path, &error))
    }
}

fn invalid(path: &Path, reason: &impl ToString) -> StageFileError {
    StageFileError::Invalid { path: path.to_owned(), reason: reason.to_string() }
}

/// The candidate tiles that the urban filter dropped, from `tiles.csv`.
///
/// # Errors
/// When the file is missing or malformed.
pub fn dropped_tiles(directory: &Path) -> Result<BTreeMap<TileId, Verdict>, StageFileError> {
    let path = directory.join("tiles.csv");
    let file = std::fs::File::open(&path).map_err(FileError::new("open", &path))?;
    let mut csv = csv::Reader::from_reader(file);
    let mut dropped = BTreeMap::new();
    for row in csv.deserialize() {
        #[derive(serde::Deserialize)]
        struct Row {
            id: TileId,
            verdict: Verdict,
        }
        let Row { id, verdict } = row.map_err(|error| invalid(&path, &error))?;
        if verdict != Verdict::Kept {
            dropped.insert(id, verdict);
        }
    }
    Ok(dropped)
}
