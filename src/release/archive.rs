//! A release as one file: a ustar archive whose bytes depend on the files and a time that is given.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use tar::{Builder, EntryType, Header};

use crate::error::FileError;
use crate::store::write_atomic_with;

/// Writes the files of a directory, by their names in it, below one folder. Names are sorted,
/// everything belongs to user and group 0, and has the same time, in seconds since 1970.
///
/// # Errors
/// [`FileError`] when reading or writing fails; the archive is then absent.
pub(super) fn write_archive(
    archive: &Path,
    root: &Path,
    folder: &str,
    files: &[String],
    mtime: u64,
) -> Result<(), FileError> {
    let mut names: Vec<&String> = files.iter().collect();
    names.sort_unstable();
    write_atomic_with(archive, |file| {
        let mut builder = Builder::new(BufWriter::new(file));
        for name in names {
            append(&mut builder, &root.join(name), &format!("{folder}/{name}"), mtime)?;
        }
        builder.into_inner()?.flush()
    })
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
