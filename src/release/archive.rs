//! A release as one file: a ustar archive whose bytes depend on the files and a time that is given.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, ErrorKind, Read, Write};
use std::path::Path;

use tar::{Builder, EntryType, Header};

use crate::error::FileError;
use crate::store::write_atomic_with;

/// What an archive holds: files of a directory, by their names in it, below one folder. Names are
/// sorted, everything belongs to user and group 0, and has the same time.
pub(super) struct Contents<'a> {
    pub(super) root: &'a Path,
    pub(super) folder: &'a str,
    pub(super) files: &'a [String],
    /// In seconds since 1970.
    pub(super) mtime: u64,
}

impl Contents<'_> {
    /// Writes the archive.
    ///
    /// # Errors
    /// [`FileError`] when reading or writing fails; the archive is then what it was.
    pub(super) fn write(&self, archive: &Path) -> Result<(), FileError> {
        write_atomic_with(archive, |file| self.pack(BufWriter::new(file)))
    }

    /// Whether the archive is there already, byte by byte.
    ///
    /// # Errors
    /// [`FileError`] when reading fails.
    pub(super) fn are_in(&self, archive: &Path) -> Result<bool, FileError> {
        let file = File::open(archive).map_err(FileError::new("open", archive))?;
        let mut compared = Compared { file: BufReader::new(file), same: true };
        let packed = self.pack(&mut compared);
        let more = packed.and_then(|()| compared.file.read(&mut [0]));
        Ok(more.map_err(FileError::new("read", archive))? == 0 && compared.same)
    }

    fn pack(&self, writer: impl Write) -> io::Result<()> {
        let mut names: Vec<&String> = self.files.iter().collect();
        names.sort_unstable();
        let mut builder = Builder::new(writer);
        for name in names {
            let archived = format!("{}/{name}", self.folder);
            append(&mut builder, &self.root.join(name), &archived, self.mtime)?;
        }
        builder.into_inner()?.flush()
    }
}

/// Holds what is written against a file.
struct Compared<R> {
    file: R,
    same: bool,
}

impl<R: Read> Write for Compared<R> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.same {
            let mut there = vec![0; bytes.len()];
            self.same = match self.file.read_exact(&mut there) {
                Ok(()) => there == bytes,
                Err(error) if error.kind() == ErrorKind::UnexpectedEof => false,
                Err(error) => return Err(error),
            };
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn append(
    builder: &mut Builder<impl Write>,
    path: &Path,
    name: &str,
    mtime: u64,
) -> io::Result<()> {
    let named = |error: io::Error| io::Error::new(error.kind(), format!("{name}: {error}"));
    let file = File::open(path).map_err(named)?;
    let mut header = Header::new_ustar();
    header.set_path(name).map_err(named)?;
    header.set_entry_type(EntryType::Regular);
    header.set_size(file.metadata().map_err(named)?.len());
    header.set_mode(0o644);
    header.set_uid(0);
    header.set_gid(0);
    header.set_mtime(mtime);
    header.set_cksum();
    builder.append(&header, file).map_err(named)
}
