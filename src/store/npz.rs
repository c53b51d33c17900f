//! NumPy's `.npz`: a ZIP of `.npy` files. Written without clock or owner, so that the
//! same arrays give the same bytes; read with a limit on what may be decompressed.
//!
//! A ZIP can be read in more than one way: by which of several ends, by the directory or by the
//! headers between the data. Only archives that all readers take for the same are read, and
//! nothing that the end of an archive says is believed before it is compared with the file.

use std::collections::BTreeSet;
use std::fmt::Display;
use std::fs::File;
use std::io::{self, BufReader, Cursor, Read, Seek, SeekFrom, Write};
use std::path::Path;

use flate2::{FlushDecompress, Status};
use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use crate::error::{Fault, FileError, HasFault};

/// More members than any map or tile has.
const MAX_MEMBERS: usize = 256;
/// More bytes than any metadata have, as `.npy`. Parsed JSON takes up to 16 times the memory of
/// its text.
pub const MAX_METADATA: u64 = 1 << 20;
/// A directory of so many members with names of a kilobyte, in bytes.
const MAX_DIRECTORY: u32 = 1 << 18;

/// Why an archive cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NpzError {
    /// The file cannot be opened or read.
    #[error(transparent)]
    File(#[from] FileError),
    /// A source without a name cannot be read.
    #[error("cannot read the archive: {0}")]
    Source(#[from] io::Error),
    /// Not a ZIP, or a damaged one.
    #[error("not a readable .npz archive: {0}")]
    Archive(String),
    /// No member of this name.
    #[error("no array {name:?} in the archive, which holds {present:?}")]
    Missing {
        /// The array that was asked for.
        name: String,
        /// The arrays that are there.
        present: Vec<String>,
    },
    /// A member would be larger than allowed.
    #[error("array {name:?} unpacks to {bytes} bytes or more, at most {limit} are allowed")]
    TooLarge {
        /// The array.
        name: String,
        /// The size that the archive declares, or the limit if it lies.
        bytes: u64,
        /// The most that is allowed.
        limit: u64,
    },
}

impl HasFault for NpzError {
    fn fault(&self) -> Fault {
        match self {
            Self::File(error) => error.fault(),
            Self::Source(_) => Fault::Running,
            _ => Fault::Input,
        }
    }
}

/// The bytes of an archive with members `<name>.npy`, in the given order.
///
/// `level` is the deflate level, 1 to 9.
#[must_use]
pub fn npz_bytes(members: &[(&str, Vec<u8>)], level: i64) -> Vec<u8> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Deflated)
        .compression_level(Some(level))
        .last_modified_time(zip::DateTime::default())
        .unix_permissions(0o644);
    for (name, bytes) in members {
        archive
            .start_file(format!("{name}.npy"), options)
            .and_then(|()| archive.write_all(bytes).map_err(Into::into))
            .expect("writing to memory cannot fail");
    }
    archive.finish().expect("writing to memory cannot fail").into_inner()
}

/// An open archive in a file, or in anything that can be read at any place.
pub struct NpzReader<R = BufReader<File>> {
    archive: ZipArchive<R>,
    limit: u64,
}

impl NpzReader {
    /// Opens an archive; no member may unpack to more than `limit` bytes.
    ///
    /// # Errors
    /// [`NpzError::File`] and [`NpzError::Archive`].
    pub fn open(path: &Path, limit: u64) -> Result<Self, NpzError> {
        let file = File::open(path).map_err(FileError::new("open", path))?;
        Self::new(BufReader::new(file), limit).map_err(|error| match error {
            NpzError::Source(error) => FileError::new("read", path)(error).into(),
            other => other,
        })
    }
}

impl<R: Read + Seek> NpzReader<R> {
    /// Reads the directory of an archive; no member may unpack to more than `limit` bytes.
    ///
    /// # Errors
    /// [`NpzError::Source`] and [`NpzError::Archive`].
    pub fn new(mut source: R, limit: u64) -> Result<Self, NpzError> {
        check_end(&mut source)?;
        let damaged = |error: ZipError| NpzError::Archive(error.to_string());
        let mut archive = ZipArchive::new(source).map_err(damaged)?;
        let names = archive.file_names().collect::<Result<Vec<_>, _>>().map_err(damaged)?;
        let arrays: BTreeSet<_> = names.iter().map(|name| array_name(name)).collect();
        if archive.has_duplicate_names() || arrays.len() < names.len() {
            return Err(NpzError::Archive("two members have the same name".to_owned()));
        }
        archive.validate_header_consistency().map_err(damaged)?;
        Ok(Self { archive, limit })
    }

    /// Names of the arrays, sorted.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let names = self.archive.file_names().flatten();
        let mut names: Vec<_> = names.map(|name| array_name(&name).to_owned()).collect();
        names.sort();
        names
    }

    /// The `.npy` file of an array, unpacked; [`super::read_npy`] parses it.
    ///
    /// # Errors
    /// All variants of [`NpzError`] but those of opening.
    pub fn member(&mut self, name: &str) -> Result<Vec<u8>, NpzError> {
        self.member_within(name, self.limit)
    }

    /// As [`NpzReader::member`], for metadata: at most [`MAX_METADATA`] bytes, whatever an array may
    /// have.
    ///
    /// # Errors
    /// As [`NpzReader::member`].
    pub fn metadata(&mut self, name: &str) -> Result<Vec<u8>, NpzError> {
        self.member_within(name, self.limit.min(MAX_METADATA))
    }

    fn member_within(&mut self, name: &str, limit: u64) -> Result<Vec<u8>, NpzError> {
        let present = self.names();
        let file = format!("{name}.npy");
        let member = match self.archive.by_name(&file) {
            Ok(member) => member,
            Err(ZipError::FileNotFound) => {
                return Err(NpzError::Missing { name: name.to_owned(), present });
            }
            Err(error) => return Err(NpzError::Archive(error.to_string())),
        };
        let too_large = |bytes| NpzError::TooLarge { name: name.to_owned(), bytes, limit };
        let declared = member.size();
        if declared > limit {
            return Err(too_large(declared));
        }
        let damaged = |reason: &dyn Display| NpzError::Archive(format!("{name:?}: {reason}"));
        // The declared size may lie in both directions: reserve little, read at most the limit.
        let mut bytes = Vec::with_capacity(declared.min(1 << 24) as usize);
        if member.compression() == CompressionMethod::Deflated && !member.encrypted() {
            let (crc32, packed_size) = (member.crc32(), member.compressed_size());
            drop(member);
            let at = self.archive.index_for_name(&file).expect("it was there");
            let packed = self.archive.by_index_raw(at).map_err(|error| damaged(&error))?;
            let mut raw = Vec::with_capacity(packed_size.min(1 << 24) as usize);
            packed.take(packed_size).read_to_end(&mut raw).map_err(|error| damaged(&error))?;
            inflate(&raw, &mut bytes, limit).map_err(|reason| damaged(&reason))?;
            if bytes.len() as u64 <= limit && crc32fast::hash(&bytes) != crc32 {
                return Err(damaged(&"Invalid checksum"));
            }
        } else {
            let mut bounded = member.take(limit.saturating_add(1));
            bounded.read_to_end(&mut bytes).map_err(|error| damaged(&error))?;
        }
        if bytes.len() as u64 > limit {
            return Err(too_large(limit));
        }
        Ok(bytes)
    }
}

/// Appends what raw deflate data hold, up to a little more than the limit. The ZIP library would clear the memory
/// first, which was 5 to 7 % of the time of `import-rsrp` and `shard`.
fn inflate(raw: &[u8], bytes: &mut Vec<u8>, limit: u64) -> Result<(), String> {
    let mut inflater = flate2::Decompress::new(false);
    loop {
        let rest = &raw[inflater.total_in() as usize..];
        let status = inflater.decompress_vec(rest, bytes, FlushDecompress::Finish);
        match status.map_err(|error| error.to_string())? {
            Status::StreamEnd => return Ok(()),
            _ if bytes.len() as u64 > limit => return Ok(()),
            _ if bytes.len() == bytes.capacity() => bytes.reserve(bytes.len().max(1 << 12)),
            _ => return Err("its compressed data end early".to_owned()),
        }
    }
}

fn array_name(member: &str) -> &str {
    member.strip_suffix(".npy").unwrap_or(member)
}

/// Compares what the end of an archive says of its directory with the file, before the ZIP
/// library believes it: that reserves memory for as many members as a 64-bit record declares, and
/// looks for another end if it cannot use the last. An archive beyond 4 GiB is none of ours.
fn check_end(source: &mut (impl Read + Seek)) -> Result<(), NpzError> {
    /// Fields before the comment: APPNOTE.TXT, 4.3.16.
    const END_BYTES: usize = 22;
    const END: &[u8; 4] = b"PK\x05\x06";
    let damaged = |what: &str| Err(NpzError::Archive(what.to_owned()));

    let size = source.seek(SeekFrom::End(0))?;
    let tail_at = size.saturating_sub((END_BYTES + usize::from(u16::MAX)) as u64);
    source.seek(SeekFrom::Start(tail_at))?;
    let mut tail = Vec::new();
    source.by_ref().take(size - tail_at).read_to_end(&mut tail)?;
    let Some(at) = tail.windows(END.len()).rposition(|window| window == END) else {
        return damaged("no end of a ZIP: truncated, or another format");
    };
    let Some((end, comment)) = tail[at..].split_first_chunk::<END_BYTES>() else {
        return damaged("truncated at its end");
    };
    let half = |at: usize| u16::from_le_bytes([end[at], end[at + 1]]);
    let word = |at: usize| u32::from_le_bytes([end[at], end[at + 1], end[at + 2], end[at + 3]]);
    let (disks, members) = ([half(4), half(6)], [half(8), half(10)]);
    let (directory_bytes, directory_at) = (word(12), word(16));
    if comment.len() != usize::from(half(20)) {
        return damaged("bytes that do not belong to it after its end");
    }
    if members[1] == u16::MAX || directory_bytes == u32::MAX || directory_at == u32::MAX {
        return damaged("an archive of 65,535 members or more than 4 GiB");
    }
    if disks != [0, 0] || members[0] != members[1] {
        return damaged("one of several parts");
    }
    if usize::from(members[1]) > MAX_MEMBERS || directory_bytes > MAX_DIRECTORY {
        return Err(NpzError::Archive(format!(
            "{} members in a directory of {directory_bytes} bytes, at most {MAX_MEMBERS} in \
             {MAX_DIRECTORY}",
            members[1]
        )));
    }
    if u64::from(directory_at) + u64::from(directory_bytes) != tail_at + at as u64 {
        return damaged("its directory is not where its end says");
    }
    source.seek(SeekFrom::Start(directory_at.into()))?;
    let mut directory = Vec::new();
    source.by_ref().take(directory_bytes.into()).read_to_end(&mut directory)?;
    let listed = listed_members(&directory);
    if listed != Some(usize::from(members[1])) {
        let listed = listed.map_or("is damaged".to_owned(), |count| format!("lists {count}"));
        let members = members[1];
        return Err(NpzError::Archive(format!("of {members} members, but its directory {listed}")));
    }
    source.rewind()?;
    Ok(())
}

/// Number of headers that fill a directory; `None` if they do not.
fn listed_members(mut directory: &[u8]) -> Option<usize> {
    /// Fields before the name: APPNOTE.TXT, 4.3.12.
    const HEADER_BYTES: usize = 46;
    const HEADER: &[u8; 4] = b"PK\x01\x02";
    let mut members = 0;
    while !directory.is_empty() {
        let (header, rest) = directory.split_first_chunk::<HEADER_BYTES>()?;
        let half = |at: usize| usize::from(u16::from_le_bytes([header[at], header[at + 1]]));
        let (name, extra, comment) = (half(28), half(30), half(32));
        directory = rest.get(name + extra + comment..)?;
        header.starts_with(HEADER).then_some(())?;
        members += 1;
    }
    Some(members)
}

#[cfg(test)]
mod tests {
    use super::super::npy::{npy_bytes, read_npy};
    use super::*;
    use ndarray::Array2;

    fn opened(bytes: &[u8], limit: u64) -> Result<NpzReader<Cursor<&[u8]>>, NpzError> {
        NpzReader::new(Cursor::new(bytes), limit)
    }

    /// Why an archive is not opened.
    fn refused(bytes: &[u8]) -> String {
        match opened(bytes, 1 << 20) {
            Err(NpzError::Archive(reason)) => reason,
            Err(other) => panic!("{other}"),
            Ok(archive) => panic!("opened with {:?}", archive.names()),
        }
    }

    /// Two members whose names differ in their last letter.
    fn pair() -> Vec<u8> {
        let member = |value| npy_bytes(&Array2::<f32>::from_elem((3, 2), value));
        npz_bytes(&[("pair_a", member(1.0)), ("pair_b", member(2.0))], 1)
    }

    /// Where a signature is for the n-th time, from 0.
    fn find(bytes: &[u8], signature: &[u8], n: usize) -> usize {
        let mut places = bytes.windows(4).enumerate().filter(|(_, window)| *window == signature);
        places.nth(n).expect("a header").0
    }

    const LOCAL: &[u8] = b"PK\x03\x04";
    const CENTRAL: &[u8] = b"PK\x01\x02";
    const END: &[u8] = b"PK\x05\x06";

    /// With a comment of its own at the end, which is no reason to refuse it.
    fn commented(mut bytes: Vec<u8>, comment: &[u8]) -> Vec<u8> {
        let at = bytes.len() - 2;
        bytes[at..].copy_from_slice(&(comment.len() as u16).to_le_bytes());
        bytes.extend(comment);
        bytes
    }

    #[test]
    fn arrays_round_trip_and_bytes_repeat() {
        let ones = Array2::<f32>::ones((3, 2));
        let bytes = npz_bytes(&[("ones", npy_bytes(&ones))], 1);
        assert_eq!(bytes, npz_bytes(&[("ones", npy_bytes(&ones))], 1));
        let mut reader = opened(&bytes, 1000).expect("valid");
        assert_eq!(reader.names(), ["ones"]);
        let member = reader.member("ones").expect("there");
        assert_eq!(read_npy(&member).and_then(|npy| npy.to_array2()), Ok(ones));
        assert!(matches!(reader.member("twos"), Err(NpzError::Missing { .. })));
    }

    #[test]
    fn bombs_and_other_files_are_refused() {
        let zeros = npy_bytes(&Array2::<f32>::zeros((1000, 1000)));
        let bytes = npz_bytes(&[("zeros", zeros)], 9);
        assert!(bytes.len() < 10_000);
        let mut reader = opened(&bytes, 100_000).expect("opens");
        assert!(matches!(reader.member("zeros"), Err(NpzError::TooLarge { .. })));
        assert!(matches!(opened(b"no archive", 10), Err(NpzError::Archive(_))));
        let mut metadata = opened(&bytes, 1 << 30).expect("opens");
        let limit = metadata.metadata("zeros").expect_err("too long");
        assert!(matches!(limit, NpzError::TooLarge { limit: MAX_METADATA, .. }), "{limit}");
        assert_eq!(metadata.member("zeros").expect("an array").len(), 4_000_128);
        let missing = NpzReader::open(Path::new("/nowhere/a.npz"), 1);
        assert!(matches!(missing, Err(NpzError::File(_))));
    }

    /// The declared size is believed for a refusal only, whichever way it lies.
    #[test]
    fn sizes_that_lie_are_refused() {
        let (bytes, local, central) = (pair(), find(&pair(), LOCAL, 0), find(&pair(), CENTRAL, 0));
        let member_of_size = |lie: u32| {
            let mut bytes = bytes.clone();
            bytes[local + 22..local + 26].copy_from_slice(&lie.to_le_bytes());
            bytes[central + 24..central + 28].copy_from_slice(&lie.to_le_bytes());
            opened(&bytes, 1 << 20).expect("opens").member("pair_a")
        };
        for lie in [1, 1 << 19] {
            // What is there is the member, or a reason why it is not.
            match member_of_size(lie) {
                Ok(member) => assert_eq!(read_npy(&member).expect("whole").shape, [3, 2]),
                other => assert!(matches!(other, Err(NpzError::Archive(_))), "{lie}: {other:?}"),
            }
        }
        let large = member_of_size(1 << 21);
        assert!(matches!(large, Err(NpzError::TooLarge { bytes: 0x20_0000, .. })), "{large:?}");
    }

    #[test]
    fn a_name_twice_is_refused_with_a_comment_too() {
        let renamed = |bytes: Vec<u8>| {
            let mut bytes = bytes;
            for at in 0..bytes.len() - 6 {
                if &bytes[at..at + 6] == b"pair_b" {
                    bytes[at + 5] = b'a';
                }
            }
            bytes
        };
        let comment = b"kept at 20 dB";
        assert!(opened(&commented(pair(), comment), 1 << 20).is_ok());
        for bytes in [renamed(pair()), commented(renamed(pair()), comment)] {
            assert!(refused(&bytes).contains("same name"), "{}", refused(&bytes));
        }
        // Not the same member, but the same array.
        let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
        for name in ["a", "a.npy"] {
            archive.start_file(name, SimpleFileOptions::default()).expect("begun");
        }
        let both = archive.finish().expect("written").into_inner();
        assert!(refused(&both).contains("same name"));
    }

    /// What one reader takes from the directory, another takes from the headers beside the data.
    #[test]
    fn archives_that_readers_would_understand_differently_are_refused() {
        let change = |signature: &[u8], n: usize, at: usize, to: &[u8]| {
            let mut bytes = pair();
            let at = find(&bytes, signature, n) + at;
            bytes[at..at + to.len()].copy_from_slice(to);
            bytes
        };
        // Another name beside the data; two members of the same bytes.
        assert!(refused(&change(LOCAL, 0, 30, b"pair_c")).contains("inconsistency"));
        assert!(refused(&change(CENTRAL, 1, 42, &[0; 4])).contains("inconsistency"));
        // One member less, or more, than the directory lists; another part of several.
        let members = |count: u8| [count, 0, count, 0];
        assert!(refused(&change(END, 0, 8, &members(1))).contains("lists 2"));
        assert!(refused(&change(END, 0, 8, &members(3))).contains("lists 2"));
        assert!(refused(&change(END, 0, 4, &[1])).contains("parts"));
        // A directory elsewhere, or none.
        assert!(refused(&change(END, 0, 16, &[0; 4])).contains("not where"));
        assert!(refused(&change(CENTRAL, 0, 0, b"PKPK")).contains("damaged"));
        // A second end, in the comment or after it, and bytes that belong to nothing.
        let end = pair().split_off(pair().len() - 22);
        assert!(refused(&commented(pair(), &[&end[..], b"!"].concat())).contains("after its end"));
        assert!(refused(&[pair(), b"!".to_vec()].concat()).contains("after its end"));
        assert!(refused(&[b"!".to_vec(), pair()].concat()).contains("not where"));
        assert!(refused(&pair()[..pair().len() - 1]).contains("truncated"));
    }

    /// Each would cost memory before the first member is looked at.
    #[test]
    fn directories_too_large_are_refused() {
        let small = npy_bytes(&Array2::<u8>::ones((1, 1)));
        let archive = |count: usize, length: usize| {
            let names: Vec<_> = (0..count).map(|n| format!("{n:0length$}")).collect();
            let members: Vec<_> = names.iter().map(|name| (&**name, small.clone())).collect();
            npz_bytes(&members, 1)
        };
        assert_eq!(opened(&archive(256, 900), 1 << 20).expect("opens").names().len(), 256);
        assert!(refused(&archive(257, 3)).contains("257 members"));
        assert!(refused(&archive(9, 60_000)).contains("directory of"));
        let mut wide = pair();
        let end = wide.len() - 22;
        wide[end + 8..end + 20].copy_from_slice(&[0xff; 12]);
        assert!(refused(&wide).contains("4 GiB"));
    }
}
