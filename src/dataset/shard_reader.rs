//! One open shard.

use std::fs::File;
use std::path::{Path, PathBuf};

use super::error::{ReadError, unreadable};
use super::grids::Grids;
use super::record::Record;
use crate::store::{FrameBuffer, SeekError, SeekTable};

/// A shard that is open.
pub(crate) struct ShardReader {
    path: PathBuf,
    file: File,
    table: SeekTable,
}

impl ShardReader {
    /// Opens a shard on a disk.
    pub(crate) fn open(path: &Path) -> Result<Self, ReadError> {
        let file = File::open(path).map_err(|error| unreadable(path, error))?;
        Self::new(path.to_owned(), file)
    }

    /// Reads the seek table of an open shard, which errors call `path`.
    pub(crate) fn new(path: PathBuf, mut file: File) -> Result<Self, ReadError> {
        let table = SeekTable::read(&mut file).map_err(|error| match error {
            SeekError::Io(error) => unreadable(&path, error),
            source => ReadError::Shard { shard: path.clone(), source },
        })?;
        Ok(Self { path, file, table })
    }

    pub(crate) fn len(&self) -> usize {
        self.table.len()
    }

    /// A record with its arrays, `[cells, cells]`, whose values are checked.
    pub(crate) fn record_with_grids(
        &mut self,
        frame: usize,
        cells: usize,
        buffer: &mut FrameBuffer,
    ) -> Result<(Record, Grids), ReadError> {
        let record = self.record(frame, buffer)?;
        let grids = record.sound_grids(cells).map_err(|source| ReadError::Record {
            shard: self.path.clone(),
            frame,
            source,
        })?;
        Ok((record, grids))
    }

    pub(crate) fn record(
        &mut self,
        frame: usize,
        buffer: &mut FrameBuffer,
    ) -> Result<Record, ReadError> {
        let bytes = self
            .table
            .frame_into(&mut self.file, frame, buffer)
            .map_err(|source| ReadError::Shard { shard: self.path.clone(), source })?;
        Record::decode(bytes).map_err(|source| ReadError::Record {
            shard: self.path.clone(),
            frame,
            source,
        })
    }
}
