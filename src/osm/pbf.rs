//! Framing of a PBF file: which blobs it has and where (OSM wiki, "PBF Format").
//!
//! `osmpbfreader` supplies the protobuf types of frames, and of blocks that no usual writer wrote. Its own
//! framing is not used: it panics on truncated files, takes a cut length field for the end, and
//! decompresses without a limit, none of which suits files from strangers.

use std::fs::File;
use std::io::Read;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use osmpbfreader::fileformat::{Blob, BlobHeader};
use osmpbfreader::osmformat::{HeaderBlock, PrimitiveBlock};
use protobuf::Message;
use rayon::prelude::*;

use super::block::{BlockError, BlockView};
use crate::building::ObjectId;
use crate::error::{Fault, FileError, HasFault};
use crate::progress::Progress;

/// Limits that the format itself sets.
const MAX_HEADER: u32 = 64 << 10;
const MAX_BLOB: u32 = 32 << 20;
/// Features that the data may demand of a reader, and that this one has.
const REQUIRED: [&str; 3] = ["OsmSchema-V0.6", "DenseNodes", LOCATIONS];
/// The places of nodes are kept with the ways.
const LOCATIONS: &str = "LocationsOnWays";
/// Several versions of an object.
const HISTORY: &str = "HistoricalInformation";
/// Features that a reader may make use of, and that this one has or does not need.
const OPTIONAL: [&str; 4] = [LOCATIONS, "Has_Metadata", "Sort.Type_then_ID", "Sort.Geographic"];

/// Why a file is no readable extract.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PbfError {
    /// The operating system failed.
    #[error(transparent)]
    File(#[from] FileError),
    /// Empty file.
    #[error("{}: the file is empty, expected an .osm.pbf extract", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// Some other kind of file.
    #[error(
        "{}: not an OpenStreetMap PBF file ({reason}); \
         convert other formats with `osmium cat {} -o extract.osm.pbf`", path.display(), shell(path)
    )]
    NotPbf {
        /// The file.
        path: PathBuf,
        /// What gave it away.
        reason: String,
    },
    /// The file ends early.
    #[error(
        "{}: truncated: blob {blob} at byte {offset} should have {expected} bytes, \
         only {found} are there; download or copy the file again", path.display()
    )]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Index of the blob, from 0.
        blob: usize,
        /// Where the missing bytes should be.
        offset: u64,
        /// Bytes that should be there.
        expected: u64,
        /// Bytes that are there.
        found: u64,
    },
    /// A blob is damaged.
    #[error(
        "{}: blob {blob} at byte {offset} is corrupt ({reason}); \
         download or copy the file again", path.display()
    )]
    Corrupt {
        /// The file.
        path: PathBuf,
        /// Index of the blob, from 0.
        blob: usize,
        /// Where the blob begins.
        offset: u64,
        /// What is wrong with it.
        reason: String,
    },
    /// The file uses something that this reader does not know.
    #[error("{}: needs {feature}, which is not supported; {mend}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// The feature.
        feature: String,
        /// What to do about it.
        mend: String,
    },
    /// The file holds an object in several versions.
    #[error(
        "{}: {object} is there in several versions, expected one; take the latest of each with \
         `osmium sort {} -o sorted.osm.pbf && osmium time-filter sorted.osm.pbf -o extract.osm.pbf`",
        path.display(), shell(path)
    )]
    SeveralVersions {
        /// The file.
        path: PathBuf,
        /// One such object.
        object: ObjectId,
    },
}

/// A path as one word of a command line.
fn shell(path: &Path) -> String {
    let text = path.display().to_string();
    let is_plain = |c: char| c.is_alphanumeric() || "/._-+=@:,".contains(c);
    if text.chars().all(is_plain) { text } else { format!("'{}'", text.replace('\'', "'\\''")) }
}

impl HasFault for PbfError {
    fn fault(&self) -> Fault {
        match self {
            Self::File(error) => error.fault(),
            _ => Fault::Input,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct BlobEntry {
    offset: u64,
    bytes: u32,
}

/// An open file and its directory of data blobs.
#[derive(Debug)]
pub(super) struct PbfFile {
    path: PathBuf,
    file: File,
    blobs: Vec<BlobEntry>,
    unknown_features: Vec<String>,
}

impl PbfFile {
    /// Reads the framing of the whole file, without decompressing data.
    pub(super) fn open(path: &Path) -> Result<Self, PbfError> {
        let file = File::open(path).map_err(FileError::new("open", path))?;
        let size = file.metadata().map_err(FileError::new("read", path))?.len();
        let mut this =
            Self { path: path.to_owned(), file, blobs: Vec::new(), unknown_features: Vec::new() };
        if size == 0 {
            return Err(PbfError::Empty { path: this.path });
        }
        let (mut position, mut blob) = (0, 0);
        while position < size {
            let (kind, entry) = this.frame(position, size, blob)?;
            match (kind.as_str(), blob) {
                ("OSMHeader", 0) => this.check_header(entry)?,
                (other, 0) => {
                    return Err(this.not_pbf(format!("begins with a blob of type {other:?}")));
                }
                ("OSMData", _) => this.blobs.push(entry),
                // The format tells readers to skip blobs of unknown types.
                _ => {}
            }
            position = entry.offset + u64::from(entry.bytes);
            blob += 1;
        }
        Ok(this)
    }

    /// Optional features that this reader does not know.
    pub(super) fn unknown_features(&self) -> &[String] {
        &self.unknown_features
    }

    /// The file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The error for an object that is there in several versions.
    pub(super) fn several_versions(&self, object: ObjectId) -> PbfError {
        PbfError::SeveralVersions { path: self.path.clone(), object }
    }

    /// Number of data blobs.
    pub(super) fn len(&self) -> usize {
        self.blobs.len()
    }

    /// Decodes the chosen data blobs in parallel and hands each to `work`; results come in
    /// the order of the file, whatever the number of threads.
    pub(super) fn map<T: Send>(
        &self,
        chosen: &[usize],
        progress: &dyn Progress,
        work: impl Fn(&BlockView<'_>) -> T + Sync,
    ) -> Result<Vec<T>, PbfError> {
        chosen
            .par_iter()
            .map(|&index| {
                let result = self.decode(index, &work)?;
                progress.advance(1);
                Ok(result)
            })
            .collect()
    }

    fn decode<T>(&self, index: usize, work: impl Fn(&BlockView<'_>) -> T) -> Result<T, PbfError> {
        let corrupt = |reason: String| self.corrupt(index + 1, self.blobs[index].offset, reason);
        let bytes = self.unpack(index + 1, self.blobs[index])?;
        match BlockView::read(&bytes) {
            Ok(block) => Ok(work(&block)),
            Err(BlockError::Inconsistent(reason)) => Err(corrupt(reason)),
            Err(BlockError::Malformed) => {
                let rewritten = PrimitiveBlock::parse_from_bytes(&bytes)
                    .and_then(|block| block.write_to_bytes())
                    .map_err(|error| corrupt(error.to_string()))?;
                let block =
                    BlockView::read(&rewritten).map_err(|error| corrupt(error.to_string()))?;
                Ok(work(&block))
            }
        }
    }

    /// The type of the blob at a position and where its content lies.
    fn frame(
        &self,
        position: u64,
        size: u64,
        blob: usize,
    ) -> Result<(String, BlobEntry), PbfError> {
        let inside = |offset: u64, expected: u64| {
            let found = size - offset;
            let path = self.path.clone();
            (found >= expected).then_some(()).ok_or(PbfError::Truncated {
                path,
                blob,
                offset,
                expected,
                found,
            })
        };
        inside(position, 4)?;
        let mut length = [0; 4];
        self.read_at(&mut length, position)?;
        let length = u32::from_be_bytes(length);
        if length == 0 || length > MAX_HEADER {
            let reason = format!("header of blob {blob} would have {length} bytes");
            return Err(self.damaged(blob, position, reason));
        }
        inside(position + 4, length.into())?;
        let mut header = vec![0; length as usize];
        self.read_at(&mut header, position + 4)?;
        let header = BlobHeader::parse_from_bytes(&header)
            .map_err(|error| self.damaged(blob, position, error.to_string()))?;
        let bytes = u32::try_from(header.datasize()).ok().filter(|&bytes| bytes <= MAX_BLOB);
        let bytes = bytes.ok_or_else(|| {
            self.damaged(blob, position, format!("declares {} bytes", header.datasize()))
        })?;
        let offset = position + 4 + u64::from(length);
        inside(offset, bytes.into())?;
        Ok((header.type_().to_owned(), BlobEntry { offset, bytes }))
    }

    fn check_header(&mut self, entry: BlobEntry) -> Result<(), PbfError> {
        let bytes = self.unpack(0, entry)?;
        let header = HeaderBlock::parse_from_bytes(&bytes)
            .map_err(|error| self.not_pbf(format!("header: {error}")))?;
        let is_optional =
            |name: &&String| !OPTIONAL.contains(&name.as_str()) && !name.starts_with("timestamp=");
        self.unknown_features =
            header.optional_features.iter().filter(is_optional).cloned().collect();
        let mut required = header.required_features.iter();
        let Some(feature) = required.find(|name| !REQUIRED.contains(&name.as_str())) else {
            return Ok(());
        };
        let file = shell(&self.path);
        let mend = if feature == HISTORY {
            format!("take the latest state with `osmium time-filter {file} -o extract.osm.pbf`")
        } else {
            format!("make a plain extract with `osmium cat {file} -o extract.osm.pbf`")
        };
        let feature = format!("the feature {feature:?}");
        Err(PbfError::Unsupported { path: self.path.clone(), feature, mend })
    }

    /// The content of a blob, decompressed within the format's limit.
    fn unpack(&self, blob: usize, entry: BlobEntry) -> Result<Vec<u8>, PbfError> {
        let corrupt = |reason: String| self.corrupt(blob, entry.offset, reason);
        let mut bytes = vec![0; entry.bytes as usize];
        self.read_at(&mut bytes, entry.offset)?;
        let mut content =
            Blob::parse_from_bytes(&bytes).map_err(|error| corrupt(error.to_string()))?;
        if content.has_raw() {
            return Ok(content.take_raw());
        }
        if !content.has_zlib_data() {
            return Err(PbfError::Unsupported {
                path: self.path.clone(),
                feature: "a compression other than zlib".to_owned(),
                mend: format!(
                    "rewrite it with `osmium cat {} -f pbf,pbf_compression=zlib -o extract.osm.pbf`",
                    shell(&self.path)
                ),
            });
        }
        let declared = u32::try_from(content.raw_size()).ok().filter(|&size| size <= MAX_BLOB);
        let declared = declared
            .ok_or_else(|| corrupt(format!("declares {} unpacked bytes", content.raw_size())))?;
        let mut unpacked = Vec::with_capacity(declared as usize);
        flate2::bufread::ZlibDecoder::new(content.zlib_data())
            .take(u64::from(declared) + 1)
            .read_to_end(&mut unpacked)
            .map_err(|error| corrupt(error.to_string()))?;
        if unpacked.len() != declared as usize {
            return Err(corrupt(format!("does not unpack to the {declared} bytes it declares")));
        }
        Ok(unpacked)
    }

    fn read_at(&self, bytes: &mut [u8], offset: u64) -> Result<(), PbfError> {
        Ok(self.file.read_exact_at(bytes, offset).map_err(FileError::new("read", &self.path))?)
    }

    /// Nonsense in the first frame means another format, later on damage.
    fn damaged(&self, blob: usize, offset: u64, reason: String) -> PbfError {
        if blob == 0 { self.not_pbf(reason) } else { self.corrupt(blob, offset, reason) }
    }

    fn not_pbf(&self, reason: String) -> PbfError {
        PbfError::NotPbf { path: self.path.clone(), reason }
    }

    fn corrupt(&self, blob: usize, offset: u64, reason: String) -> PbfError {
        PbfError::Corrupt { path: self.path.clone(), blob, offset, reason }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_that_are_advised_name_the_file_as_one_word() {
        assert_eq!(shell(Path::new("maps/a-b_c.osm.pbf")), "maps/a-b_c.osm.pbf");
        assert_eq!(shell(Path::new("my city's.osm.pbf")), r"'my city'\''s.osm.pbf'");
        let path = PathBuf::from("two words.osm.pbf");
        let said = PbfError::SeveralVersions { path, object: ObjectId::Way(7) }.to_string();
        assert!(
            said.contains("w7") && said.contains("osmium sort 'two words.osm.pbf' -o"),
            "{said}"
        );
    }
}
