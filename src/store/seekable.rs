//! The Zstandard seekable format: independent frames and a table of where they are.
//!
//! `zstd -dc` reads such a file as one stream; the table, a skippable frame at the end,
//! gives random access. Specification: facebook/zstd, `contrib/seekable_format`,
//! version 0.1.0. Every frame carries its content checksum (the low 32 bits of XXH64),
//! which the table repeats.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;

/// Magic number of the skippable frame that holds the table.
const SKIPPABLE_MAGIC: u32 = 0x184D_2A5E;
/// Magic number at the very end of the file.
const SEEKABLE_MAGIC: u32 = 0x8F92_EAB1;
/// Table descriptor: bit 7 says that entries carry checksums.
const WITH_CHECKSUMS: u8 = 0x80;
const ENTRY_BYTES: u64 = 12;
const FOOTER_BYTES: u64 = 9;
const SKIPPABLE_HEADER_BYTES: u64 = 8;
/// A record is a few hundred kilobytes; larger frames are refused before allocation.
const MAX_FRAME_BYTES: u32 = 1 << 28;
/// `shard.records_per_shard` allows no more; a longer table is refused before allocation.
const MAX_FRAMES: u32 = 1 << 16;

/// Why a seekable file cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SeekError {
    /// The operating system failed.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The seek table is missing or damaged.
    #[error("seek table: {0}")]
    Table(String),
    /// A frame is damaged.
    #[error("frame {frame}: {reason}")]
    Frame {
        /// Index of the frame, from 0.
        frame: usize,
        /// What is wrong with it.
        reason: String,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Entry {
    compressed: u32,
    decompressed: u32,
    checksum: u32,
}

/// Compresses one record to one frame, with content size and checksum.
///
/// # Errors
/// When the level is out of range or the record larger than 256 MiB.
pub fn compress_frame(record: &[u8], level: i32) -> io::Result<Vec<u8>> {
    if record.len() as u64 > u64::from(MAX_FRAME_BYTES) {
        return Err(io::Error::other("a record of more than 256 MiB"));
    }
    let mut compressor = zstd::bulk::Compressor::new(level)?;
    compressor.include_checksum(true)?;
    compressor.compress(record)
}

/// Writes frames made by [`compress_frame`] and, at the end, the table.
pub struct SeekableWriter<W> {
    sink: W,
    entries: Vec<Entry>,
}

impl<W: Write> SeekableWriter<W> {
    /// Begins a file.
    pub fn new(sink: W) -> Self {
        Self { sink, entries: Vec::new() }
    }

    /// Appends a frame that unpacks to `decompressed` bytes.
    ///
    /// # Errors
    /// When writing fails.
    pub fn push(&mut self, frame: &[u8], decompressed: usize) -> io::Result<()> {
        let too_large = |_| io::Error::other("a frame of more than 4 GiB");
        let checksum = frame.last_chunk().ok_or_else(|| io::Error::other("an empty frame"))?;
        self.entries.push(Entry {
            compressed: frame.len().try_into().map_err(too_large)?,
            decompressed: decompressed.try_into().map_err(too_large)?,
            checksum: u32::from_le_bytes(*checksum),
        });
        self.sink.write_all(frame)
    }

    /// Writes the table and returns the sink.
    ///
    /// # Errors
    /// When writing fails.
    pub fn finish(mut self) -> io::Result<W> {
        let frames = self.entries.len() as u32;
        let content = self.entries.len() as u64 * ENTRY_BYTES + FOOTER_BYTES;
        self.sink.write_all(&SKIPPABLE_MAGIC.to_le_bytes())?;
        self.sink.write_all(&(content as u32).to_le_bytes())?;
        for entry in &self.entries {
            self.sink.write_all(&entry.compressed.to_le_bytes())?;
            self.sink.write_all(&entry.decompressed.to_le_bytes())?;
            self.sink.write_all(&entry.checksum.to_le_bytes())?;
        }
        self.sink.write_all(&frames.to_le_bytes())?;
        self.sink.write_all(&[WITH_CHECKSUMS])?;
        self.sink.write_all(&SEEKABLE_MAGIC.to_le_bytes())?;
        Ok(self.sink)
    }
}

/// The seek table of an open file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SeekTable {
    entries: Vec<Entry>,
    offsets: Vec<u64>,
}

impl SeekTable {
    /// Reads the table of a file and checks that its frames fill the file exactly.
    ///
    /// # Errors
    /// [`SeekError::Table`] if it is missing, damaged or contradicts the file's size.
    pub fn read(file: &mut (impl Read + Seek)) -> Result<Self, SeekError> {
        let damaged = |what: String| SeekError::Table(what);
        let size = file.seek(SeekFrom::End(0))?;
        if size < FOOTER_BYTES + SKIPPABLE_HEADER_BYTES {
            return Err(damaged(format!("the file has only {size} bytes")));
        }
        let mut footer = [0; FOOTER_BYTES as usize];
        file.seek(SeekFrom::Start(size - FOOTER_BYTES))?;
        file.read_exact(&mut footer)?;
        let [n0, n1, n2, n3, descriptor, m0, m1, m2, m3] = footer;
        if u32::from_le_bytes([m0, m1, m2, m3]) != SEEKABLE_MAGIC {
            return Err(damaged("magic number missing: truncated, or another format".into()));
        }
        if descriptor != WITH_CHECKSUMS {
            return Err(damaged(format!("descriptor {descriptor:#x}, expected checksums")));
        }
        let frames = u32::from_le_bytes([n0, n1, n2, n3]);
        if frames > MAX_FRAMES {
            return Err(damaged(format!("{frames} frames, at most {MAX_FRAMES}")));
        }
        let frames = u64::from(frames);
        let content = frames * ENTRY_BYTES + FOOTER_BYTES;
        let frames_end = size
            .checked_sub(content + SKIPPABLE_HEADER_BYTES)
            .ok_or_else(|| damaged(format!("{frames} frames do not fit into the file")))?;
        let mut table = vec![0; (content + SKIPPABLE_HEADER_BYTES - FOOTER_BYTES) as usize];
        file.seek(SeekFrom::Start(frames_end))?;
        file.read_exact(&mut table)?;
        let word = |at: usize| {
            u32::from_le_bytes(table[at..at + 4].try_into().expect("four bytes were sliced"))
        };
        if word(0) != SKIPPABLE_MAGIC || u64::from(word(4)) != content {
            return Err(damaged("its skippable frame is damaged".into()));
        }
        let entries: Vec<_> = (0..frames as usize)
            .map(|frame| SKIPPABLE_HEADER_BYTES as usize + frame * ENTRY_BYTES as usize)
            .map(|at| Entry {
                compressed: word(at),
                decompressed: word(at + 4),
                checksum: word(at + 8),
            })
            .collect();
        let mut offsets = vec![0];
        for entry in &entries {
            offsets.push(offsets[offsets.len() - 1] + u64::from(entry.compressed));
        }
        if offsets.last() != Some(&frames_end) {
            return Err(damaged("the sizes of its frames do not add up to the file".into()));
        }
        Ok(Self { entries, offsets })
    }

    /// Opens a file and reads its table.
    ///
    /// # Errors
    /// As [`SeekTable::read`].
    pub fn open(path: &Path) -> Result<(File, Self), SeekError> {
        let mut file = File::open(path)?;
        let table = Self::read(&mut file)?;
        Ok((file, table))
    }

    /// Number of frames.
    #[must_use]
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether there is no frame.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Bytes that the largest readable frame unpacks to, as the table says; 0 without frames.
    #[must_use]
    pub fn largest_frame(&self) -> usize {
        let sizes = self.entries.iter().map(|entry| entry.decompressed);
        sizes.filter(|size| *size <= MAX_FRAME_BYTES).max().unwrap_or(0) as usize
    }

    /// Reads and unpacks one frame; its checksum is verified.
    ///
    /// # Errors
    /// [`SeekError::Frame`] names the frame if it is damaged or does not exist.
    pub fn frame(&self, file: &mut (impl Read + Seek), frame: usize) -> Result<Vec<u8>, SeekError> {
        let mut buffer = FrameBuffer::new()?;
        self.frame_into(file, frame, &mut buffer)?;
        Ok(buffer.record)
    }

    /// As [`SeekTable::frame`], into memory that is used again for each.
    ///
    /// # Errors
    /// As [`SeekTable::frame`].
    pub fn frame_into<'buffer>(
        &self,
        file: &mut (impl Read + Seek),
        frame: usize,
        buffer: &'buffer mut FrameBuffer,
    ) -> Result<&'buffer [u8], SeekError> {
        let damaged = |reason: String| SeekError::Frame { frame, reason };
        let entry = self
            .entries
            .get(frame)
            .ok_or_else(|| damaged(format!("there are only {}", self.len())))?;
        if entry.decompressed > MAX_FRAME_BYTES || entry.compressed > MAX_FRAME_BYTES {
            return Err(damaged(format!("declares {} bytes, too many", entry.decompressed)));
        }
        let FrameBuffer { decompressor, compressed, record } = buffer;
        compressed.resize(entry.compressed as usize, 0);
        file.seek(SeekFrom::Start(self.offsets[frame]))?;
        file.read_exact(compressed)?;
        let checksum = compressed.last_chunk().map(|bytes| u32::from_le_bytes(*bytes));
        if checksum != Some(entry.checksum) {
            return Err(damaged("its checksum differs from the table's".into()));
        }
        let expected = entry.decompressed as usize;
        record.clear();
        record.reserve(expected);
        let unpacked = decompressor.decompress_to_buffer(&compressed[..], record);
        let found = unpacked.map_err(|error| damaged(error.to_string()))?;
        if found != expected {
            return Err(damaged(format!("unpacks to {found} bytes, not {expected}")));
        }
        Ok(record)
    }
}

/// Memory for one frame after the other: setting it up anew costs as much as unpacking a record.
pub struct FrameBuffer {
    decompressor: zstd::bulk::Decompressor<'static>,
    compressed: Vec<u8>,
    record: Vec<u8>,
}

impl FrameBuffer {
    /// Without memory yet, but for Zstandard's tables.
    ///
    /// # Errors
    /// When Zstandard gets no memory.
    pub fn new() -> io::Result<Self> {
        let decompressor = zstd::bulk::Decompressor::new()?;
        Ok(Self { decompressor, compressed: Vec::new(), record: Vec::new() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(records: &[&[u8]]) -> Vec<u8> {
        let mut writer = SeekableWriter::new(Vec::new());
        for record in records {
            let frame = compress_frame(record, 3).expect("compressed");
            writer.push(&frame, record.len()).expect("written");
        }
        writer.finish().expect("written")
    }

    fn opened(bytes: &[u8]) -> Result<(File, SeekTable), SeekError> {
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join("shard");
        std::fs::write(&path, bytes).expect("written");
        SeekTable::open(&path)
    }

    #[test]
    fn frames_are_found_in_any_order_and_a_plain_decoder_reads_the_stream() {
        let bytes = written(&[b"first", b"", b"third"]);
        let (mut file, table) = opened(&bytes).expect("valid");
        assert_eq!(table.len(), 3);
        assert_eq!(table.largest_frame(), 5);
        assert_eq!(table.frame(&mut file, 2).expect("whole"), b"third");
        assert_eq!(table.frame(&mut file, 0).expect("whole"), b"first");
        assert_eq!(table.frame(&mut file, 1).expect("whole"), b"");
        assert!(matches!(table.frame(&mut file, 3), Err(SeekError::Frame { frame: 3, .. })));
        let stream = zstd::stream::decode_all(&bytes[..]).expect("a plain stream");
        assert_eq!(stream, b"firstthird");
    }

    /// Frames of no bytes cost a file nothing and the table a lot.
    #[test]
    fn a_table_of_too_many_frames_is_refused() {
        let of_frames = |frames: u32| {
            let empty = Entry { compressed: 0, decompressed: 0, checksum: 0 };
            let entries = vec![empty; frames as usize];
            let bytes = SeekableWriter { sink: Vec::new(), entries }.finish().expect("written");
            SeekTable::read(&mut io::Cursor::new(bytes)).map(|table| table.len())
        };
        assert_eq!(of_frames(MAX_FRAMES).expect("as many as allowed"), MAX_FRAMES as usize);
        assert!(matches!(of_frames(MAX_FRAMES + 1), Err(SeekError::Table(_))));
    }

    #[test]
    fn no_flipped_or_missing_byte_gives_another_record() {
        let records: [&[u8]; 2] = [b"one record", b"another record"];
        let bytes = written(&records);
        let read = |bytes: &[u8]| -> Result<Vec<Vec<u8>>, SeekError> {
            let (mut file, table) = opened(bytes)?;
            (0..table.len()).map(|frame| table.frame(&mut file, frame)).collect()
        };
        assert_eq!(read(&bytes).expect("undamaged"), records);
        let mut harmless = 0;
        for position in 0..bytes.len() {
            for bit in 0..8 {
                let mut damaged = bytes.clone();
                damaged[position] ^= 1 << bit;
                match read(&damaged) {
                    Err(_) => {}
                    Ok(unchanged) => {
                        assert_eq!(unchanged, records, "byte {position}, bit {bit}");
                        harmless += 1;
                    }
                }
            }
        }
        // Frame headers have bits without a meaning (RFC 8878, 3.1.1.1.1.3), nothing else has.
        assert!(harmless <= 2 * records.len(), "{harmless} bits flipped unnoticed");
        for length in 0..bytes.len() {
            assert!(read(&bytes[..length]).is_err(), "cut to {length} unnoticed");
        }
    }
}
