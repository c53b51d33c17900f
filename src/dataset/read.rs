//! Reading a dataset's records, by name or one after the other.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::record::{Grids, Record, RecordError};
use crate::config::Split;
use crate::error::{Fault, FileError, HasFault};
use crate::grid::TileId;
use crate::manifest::{DatasetManifest, IndexEntry, ManifestError, load};
use crate::store::{Digest, SeekError, SeekTable};

/// Why a record cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The manifest cannot be used.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// A shard is damaged.
    #[error("{}: {source}", shard.display())]
    Shard {
        /// The file.
        shard: PathBuf,
        /// What is wrong.
        source: SeekError,
    },
    /// A record is damaged.
    #[error("{}: frame {frame}: {source}", shard.display())]
    Record {
        /// The file.
        shard: PathBuf,
        /// Index of the frame, from 0.
        frame: usize,
        /// What is wrong.
        source: RecordError,
    },
    /// No record of this name.
    #[error("no record {id} in the dataset, which has {records}, for instance {example}")]
    Unknown {
        /// What was asked for.
        id: TileId,
        /// Number of records.
        records: usize,
        /// A record that exists.
        example: String,
    },
}

impl HasFault for ReadError {
    fn fault(&self) -> Fault {
        match self {
            Self::Manifest(error) => error.fault(),
            Self::Shard { source: SeekError::Io(error), .. }
                if error.kind() == std::io::ErrorKind::PermissionDenied =>
            {
                Fault::Running
            }
            _ => Fault::Input,
        }
    }
}

/// A dataset on disk.
#[derive(Debug)]
pub struct Dataset {
    root: PathBuf,
    manifest: DatasetManifest,
    digest: Digest,
    index: BTreeMap<TileId, IndexEntry>,
}

impl Dataset {
    /// Opens a dataset by its manifest.
    ///
    /// # Errors
    /// [`ReadError::Manifest`], also for a build that was interrupted.
    pub fn open(root: &Path) -> Result<Self, ReadError> {
        let (manifest, digest) = load::<DatasetManifest>(root, "shard", DatasetManifest::SCHEMA)?;
        let index = manifest.records.iter().map(|entry| (entry.id, entry.clone())).collect();
        Ok(Self { root: root.to_owned(), manifest, digest, index })
    }

    /// The manifest.
    #[must_use]
    pub fn manifest(&self) -> &DatasetManifest {
        &self.manifest
    }

    /// Size and SHA-256 of the manifest, which names every shard by its SHA-256.
    #[must_use]
    pub fn digest(&self) -> &Digest {
        &self.digest
    }

    /// The records with their splits, in the order of their names.
    #[must_use]
    pub fn ids(&self) -> Vec<(TileId, Split)> {
        let shards = self.manifest.shards.iter().map(|shard| (&*shard.file, shard.split));
        let splits: BTreeMap<&str, Split> = shards.collect();
        let records = self.manifest.records.iter();
        records.filter_map(|record| Some((record.id, *splits.get(&*record.shard)?))).collect()
    }

    /// Where the dataset lies.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The records of a split, in the order of their names.
    #[must_use]
    pub fn ids_of(&self, split: Split) -> Vec<TileId> {
        self.ids().into_iter().filter(|&(_, of)| of == split).map(|(id, _)| id).collect()
    }

    /// Reads the record of a tile; the frame's checksum is verified.
    ///
    /// # Errors
    /// [`ReadError`] names file and frame.
    pub fn record(&self, id: TileId) -> Result<Record, ReadError> {
        let entry = self.entry(id)?;
        self.open_shard(&entry.shard)?.record(entry.frame as usize)
    }

    /// Reads the record of a tile with its arrays, whose values are checked.
    ///
    /// # Errors
    /// [`ReadError`] names file and frame.
    pub fn record_with_grids(&self, id: TileId) -> Result<(Record, Grids), ReadError> {
        let entry = self.entry(id)?;
        let mut shard = self.open_shard(&entry.shard)?;
        shard.record_with_grids(entry.frame as usize, self.manifest.cells as usize)
    }

    /// All records of a shard, one after the other.
    ///
    /// # Errors
    /// When the shard cannot be opened; each record may fail on its own.
    pub fn shard(
        &self,
        file: &str,
    ) -> Result<impl Iterator<Item = Result<Record, ReadError>> + use<>, ReadError> {
        let mut reader = self.open_shard(file)?;
        Ok((0..reader.table.len()).map(move |frame| reader.record(frame)))
    }

    /// Where the record of a tile is.
    pub(super) fn entry(&self, id: TileId) -> Result<&IndexEntry, ReadError> {
        self.index.get(&id).ok_or_else(|| ReadError::Unknown {
            id,
            records: self.index.len(),
            example: self.index.keys().next().map_or_else(String::new, ToString::to_string),
        })
    }

    /// Opens a shard by its path within the dataset.
    pub(super) fn open_shard(&self, file: &str) -> Result<ShardReader, ReadError> {
        ShardReader::open(&self.root.join(file))
    }
}

/// One open shard.
pub(super) struct ShardReader {
    path: PathBuf,
    file: std::fs::File,
    table: SeekTable,
}

impl ShardReader {
    pub(super) fn open(path: &Path) -> Result<Self, ReadError> {
        let failed = |source| ReadError::Shard { shard: path.to_owned(), source };
        let (file, table) = SeekTable::open(path).map_err(|error| match error {
            SeekError::Io(source) => {
                let named = FileError::new("read", path)(source);
                failed(SeekError::Io(std::io::Error::other(named)))
            }
            other => failed(other),
        })?;
        Ok(Self { path: path.to_owned(), file, table })
    }

    pub(super) fn len(&self) -> usize {
        self.table.len()
    }

    /// Bytes that the largest frame unpacks to.
    pub(super) fn largest_frame(&self) -> usize {
        self.table.largest_frame()
    }

    /// A record with its arrays, `[cells, cells]`, whose values are checked.
    pub(super) fn record_with_grids(
        &mut self,
        frame: usize,
        cells: usize,
    ) -> Result<(Record, Grids), ReadError> {
        let record = self.record(frame)?;
        let grids = record.sound_grids(cells).map_err(|source| ReadError::Record {
            shard: self.path.clone(),
            frame,
            source,
        })?;
        Ok((record, grids))
    }

    pub(super) fn record(&mut self, frame: usize) -> Result<Record, ReadError> {
        let bytes = self
            .table
            .frame(&mut self.file, frame)
            .map_err(|source| ReadError::Shard { shard: self.path.clone(), source })?;
        Record::decode(&bytes).map_err(|source| ReadError::Record {
            shard: self.path.clone(),
            frame,
            source,
        })
    }
}
