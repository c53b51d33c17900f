//! Reading a dataset's records, by name or one after the other.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use super::error::{ReadError, unreadable};
use super::grids::{Grids, RecordError};
use super::location::Location;
use super::record::Record;
use super::shard_reader::ShardReader;
use crate::config::{RemoteConfig, Split};
use crate::grid::TileId;
use crate::manifest::{DatasetManifest, IndexEntry, ManifestError, ShardEntry, parse};
use crate::store::{
    Digest, FrameBuffer, MANIFEST, SUMS, SeekError, parse_sums, sha256_bytes, stays_inside,
};

/// A dataset that is open for reading.
#[derive(Debug)]
pub struct Dataset {
    root: PathBuf,
    place: Location,
    manifest: DatasetManifest,
    digest: Digest,
    index: BTreeMap<TileId, IndexEntry>,
    shards: BTreeMap<String, Digest>,
}

impl Dataset {
    /// Opens a dataset in a directory by its manifest, whose SHA-256 must be that in `SHA256SUMS`.
    ///
    /// # Errors
    /// [`ReadError::Manifest`], also for a build that was interrupted.
    pub fn open(root: &Path) -> Result<Self, ReadError> {
        Self::of(Location::Directory(root.to_owned()), root)
    }

    /// As [`Dataset::open`], or with the feature `remote` at `http(s)://` or `s3://`: the manifest is
    /// read now, a shard when one of its records is wanted.
    ///
    /// # Errors
    /// As [`Dataset::open`], and if the server or the cache fails.
    pub fn open_with(location: &Path, config: &RemoteConfig) -> Result<Self, ReadError> {
        Self::of(Location::of(location, config)?, location)
    }

    fn of(place: Location, location: &Path) -> Result<Self, ReadError> {
        let bytes = place.read(MANIFEST)?;
        let path = location.join(MANIFEST);
        let manifest: DatasetManifest = parse(&bytes, &path)?;
        let digest = sha256_bytes(&bytes);
        let sums = place.read(SUMS)?;
        check(&manifest, &digest, &String::from_utf8_lossy(&sums))
            .map_err(|reason| ManifestError::Invalid { path, reason, stage: "shard" })?;
        let index = manifest.records.iter().map(|entry| (entry.id, entry.clone())).collect();
        let shards = manifest.shards.iter();
        let shards = shards.map(|shard| (shard.file.clone(), shard.digest.clone())).collect();
        Ok(Self { root: location.to_owned(), place, manifest, digest, index, shards })
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

    /// Where the dataset lies.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The records with their splits, in the order of their names.
    #[must_use]
    pub fn ids(&self) -> Vec<(TileId, Split)> {
        let shards = self.manifest.shards.iter().map(|shard| (&*shard.file, shard.split));
        let splits: BTreeMap<&str, Split> = shards.collect();
        let records = self.manifest.records.iter();
        records.map(|record| (record.id, splits[&*record.shard])).collect()
    }

    /// The records of a split, in the order of their names.
    #[must_use]
    pub fn ids_of(&self, split: Split) -> Vec<TileId> {
        self.ids().into_iter().filter(|&(_, of)| of == split).map(|(id, _)| id).collect()
    }

    /// The shards of a split in the order of the manifest, each with its records in their order.
    #[must_use]
    pub fn shards_of(&self, split: Split) -> Vec<(&ShardEntry, Vec<TileId>)> {
        let mut frames: BTreeMap<&str, BTreeMap<u32, TileId>> = BTreeMap::new();
        for IndexEntry { id, shard, frame } in &self.manifest.records {
            frames.entry(shard).or_default().insert(*frame, *id);
        }
        let shards = self.manifest.shards.iter().filter(|shard| shard.split == split);
        let mut ids = |shard: &ShardEntry| frames.remove(&*shard.file).unwrap_or_default();
        shards.map(|shard| (shard, ids(shard).into_values().collect())).collect()
    }

    /// Reads the record of a tile; the frame's checksum is verified.
    ///
    /// # Errors
    /// [`ReadError`] names file and frame.
    pub fn record(&self, id: TileId) -> Result<Record, ReadError> {
        Ok(self.record_with_grids(id)?.0)
    }

    /// Reads the record of a tile with its arrays, whose values are checked.
    ///
    /// # Errors
    /// [`ReadError`] names file and frame.
    pub fn record_with_grids(&self, id: TileId) -> Result<(Record, Grids), ReadError> {
        let entry = self.entry(id)?;
        let mut buffer = self.buffer(&entry.shard)?;
        self.read(&mut self.open_shard(&entry.shard, &|| true)?, entry, &mut buffer)
    }

    /// All records of a shard, one after the other.
    ///
    /// # Errors
    /// When the shard cannot be opened; each record may fail on its own.
    pub fn shard(
        &self,
        file: &str,
    ) -> Result<impl Iterator<Item = Result<Record, ReadError>> + use<>, ReadError> {
        let mut reader = self.open_shard(file, &|| true)?;
        let mut buffer = self.buffer(file)?;
        Ok((0..reader.len()).map(move |frame| reader.record(frame, &mut buffer)))
    }

    /// Where the record of a tile is.
    pub(super) fn entry(&self, id: TileId) -> Result<&IndexEntry, ReadError> {
        self.index.get(&id).ok_or_else(|| ReadError::Unknown {
            id,
            records: self.index.len(),
            example: self.index.keys().next().map_or_else(String::new, ToString::to_string),
        })
    }

    /// Memory to unpack the records of a shard in.
    pub(super) fn buffer(&self, shard: &str) -> Result<FrameBuffer, ReadError> {
        FrameBuffer::new().map_err(|error| unreadable(&self.root.join(shard), error))
    }

    /// Opens a shard by its path within the dataset; the download of one is given up once it is no
    /// longer wanted.
    pub(super) fn open_shard(
        &self,
        file: &str,
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<ShardReader, ReadError> {
        let path = self.root.join(file);
        let Some(digest) = self.shards.get(file) else {
            let source = SeekError::Table("the manifest has no such shard".to_owned());
            return Err(ReadError::Shard { shard: path, source });
        };
        ShardReader::new(path, self.place.open(file, digest, is_wanted)?)
    }

    /// Bytes of shards that may be at hand at a time, if they have to be downloaded.
    pub(super) fn cache_bytes(&self) -> Option<u64> {
        self.place.cache_bytes()
    }

    /// Reads a record that an open shard has, and makes sure that it is the one that the index
    /// names.
    pub(super) fn read(
        &self,
        shard: &mut ShardReader,
        entry: &IndexEntry,
        buffer: &mut FrameBuffer,
    ) -> Result<(Record, Grids), ReadError> {
        let frame = entry.frame as usize;
        let read = shard.record_with_grids(frame, self.manifest.cells as usize, buffer)?;
        if read.0.id == entry.id {
            return Ok(read);
        }
        let (found, expected) = (read.0.id.to_string(), format!("{}, as in the index", entry.id));
        let source = RecordError::Value { field: "id", found, expected };
        Err(ReadError::Record { shard: self.root.join(&entry.shard), frame, source })
    }
}

/// The manifest is the one that the list of checksums names, and its index names every frame of
/// every shard once.
fn check<'a>(manifest: &'a DatasetManifest, digest: &Digest, sums: &str) -> Result<(), String> {
    let sums = parse_sums(sums).map_err(|line| format!("{SUMS} has a damaged line: {line:?}"))?;
    let listed = sums.iter().find(|(_, file)| *file == MANIFEST).map(|(sha256, _)| *sha256);
    if listed != Some(&*digest.sha256) {
        let (found, listed) = (&digest.sha256, listed.unwrap_or("nothing"));
        return Err(format!("SHA-256 is {found}, {SUMS} says {listed}: one of them was changed"));
    }
    if let Some(shard) = manifest.shards.iter().find(|shard| !stays_inside(&shard.file)) {
        return Err(format!("shard {:?} does not lie in the dataset", shard.file));
    }
    if let Some(pair) = manifest.records.windows(2).find(|pair| pair[0].id >= pair[1].id) {
        return Err(format!(
            "record {} does not come after {} in the index",
            pair[1].id, pair[0].id
        ));
    }
    let promised: u64 = manifest.shards.iter().map(|shard| u64::from(shard.records)).sum();
    let indexed = manifest.records.len() as u64;
    if promised != indexed {
        return Err(format!("its shards have {promised} records, its index {indexed}"));
    }
    let frames = |shard: &'a ShardEntry| (0..shard.records).map(|frame| (&*shard.file, frame));
    let mut frames: BTreeSet<(&str, u32)> = manifest.shards.iter().flat_map(frames).collect();
    for IndexEntry { id, shard, frame } in &manifest.records {
        if !frames.remove(&(&**shard, *frame)) {
            return Err(format!("frame {frame} of {shard} for {id} is not there, or taken"));
        }
    }
    Ok(())
}
