//! The shards that a worker keeps open.

use std::sync::Arc;

use crate::dataset::error::ReadError;
use crate::dataset::grids::Grids;
use crate::dataset::read::Dataset;
use crate::dataset::record::Record;
use crate::dataset::shard_reader::ShardReader;
use crate::grid::TileId;
use crate::store::FrameBuffer;

/// Open shards of a dataset, so that file and seek table are not read again for every record.
pub(super) struct OpenShards {
    dataset: Arc<Dataset>,
    /// Where records are unpacked, once there was one.
    buffer: Option<FrameBuffer>,
    /// Most shards that stay open.
    most: usize,
    /// Shards by their paths within the dataset, the one used last first.
    readers: Vec<(String, ShardReader)>,
}

impl OpenShards {
    pub(super) fn new(dataset: Arc<Dataset>, most: usize) -> Self {
        Self { dataset, buffer: None, most, readers: Vec::new() }
    }

    /// A record with its arrays, as [`Dataset::record_with_grids`] reads it. A shard that fails
    /// is closed, so that it is read anew for its next record; a download is given up once it is no
    /// longer wanted.
    pub(super) fn read(
        &mut self,
        id: TileId,
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<(Record, Grids), ReadError> {
        let entry = self.dataset.entry(id)?;
        let open = self.readers.iter().position(|(file, _)| *file == entry.shard);
        let (file, mut reader) = match open {
            Some(at) => self.readers.remove(at),
            None => (entry.shard.clone(), self.dataset.open_shard(&entry.shard, is_wanted)?),
        };
        let buffer = match &mut self.buffer {
            Some(buffer) => buffer,
            none => none.insert(self.dataset.buffer(&entry.shard)?),
        };
        let read = self.dataset.read(&mut reader, entry, buffer)?;
        self.readers.insert(0, (file, reader));
        self.readers.truncate(self.most.max(1));
        Ok(read)
    }
}
