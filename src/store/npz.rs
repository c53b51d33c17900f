//! NumPy's `.npz`: a ZIP of `.npy` files. Written without clock or owner, so that the
//! same arrays give the same bytes; read with a limit on what may be decompressed.

use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom, Write};
use std::path::Path;

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use crate::error::{Fault, FileError, HasFault};

/// More members than any map or tile has.
const MAX_MEMBERS: usize = 256;

/// Why an archive cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NpzError {
    /// The file cannot be opened.
    #[error(transparent)]
    File(#[from] FileError),
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

/// An open archive.
pub struct NpzReader {
    archive: ZipArchive<BufReader<File>>,
    limit: u64,
}

impl NpzReader {
    /// Opens an archive; no member may unpack to more than `limit` bytes.
    ///
    /// # Errors
    /// [`NpzError::File`] and [`NpzError::Archive`].
    pub fn open(path: &Path, limit: u64) -> Result<Self, NpzError> {
        let file = File::open(path).map_err(FileError::new("open", path))?;
        let listed = listed_members(&file).map_err(FileError::new("read", path))?;
        let archive = ZipArchive::new(BufReader::new(file))
            .map_err(|error| NpzError::Archive(error.to_string()))?;
        if listed.is_some_and(|listed| usize::from(listed) != archive.len()) {
            return Err(NpzError::Archive("two members have the same name".to_owned()));
        }
        if archive.len() > MAX_MEMBERS {
            let count = archive.len();
            return Err(NpzError::Archive(format!("{count} members, at most {MAX_MEMBERS}")));
        }
        Ok(Self { archive, limit })
    }

    /// Names of the arrays, sorted.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let member = |name: &str| name.strip_suffix(".npy").unwrap_or(name).to_owned();
        let mut names: Vec<_> =
            self.archive.file_names().flatten().map(|name| member(&name)).collect();
        names.sort();
        names
    }

    /// The `.npy` file of an array, unpacked; [`super::read_npy`] parses it.
    ///
    /// # Errors
    /// All variants of [`NpzError`] but those of opening.
    pub fn member(&mut self, name: &str) -> Result<Vec<u8>, NpzError> {
        let present = self.names();
        let limit = self.limit;
        let too_large = |bytes| NpzError::TooLarge { name: name.to_owned(), bytes, limit };
        let member = match self.archive.by_name(&format!("{name}.npy")) {
            Ok(member) => member,
            Err(zip::result::ZipError::FileNotFound) => {
                return Err(NpzError::Missing { name: name.to_owned(), present });
            }
            Err(error) => return Err(NpzError::Archive(error.to_string())),
        };
        let declared = member.size();
        if declared > limit {
            return Err(too_large(declared));
        }
        // The declared size may lie in both directions: reserve little, read at most the limit.
        let mut bytes = Vec::with_capacity(declared.min(1 << 24) as usize);
        member
            .take(limit + 1)
            .read_to_end(&mut bytes)
            .map_err(|error| NpzError::Archive(format!("{name:?}: {error}")))?;
        if bytes.len() as u64 > limit {
            return Err(too_large(limit));
        }
        Ok(bytes)
    }
}

/// Number of members that the end of an archive without a comment declares. The ZIP
/// library keeps one member of each name and does not tell that there were more.
fn listed_members(mut file: &File) -> std::io::Result<Option<u16>> {
    const END_OF_DIRECTORY: u8 = 22;
    const SIGNATURE: &[u8] = b"PK\x05\x06";
    let size = file.seek(SeekFrom::End(0))?;
    let mut end = [0; END_OF_DIRECTORY as usize];
    if size >= u64::from(END_OF_DIRECTORY) {
        file.seek(SeekFrom::End(-i64::from(END_OF_DIRECTORY)))?;
        file.read_exact(&mut end)?;
    }
    file.rewind()?;
    let [.., low, high, _, _, _, _, _, _, _, _, _, _] = end;
    let count = u16::from_le_bytes([low, high]);
    // The largest number stands for "see the 64-bit record".
    Ok((end.starts_with(SIGNATURE) && count != u16::MAX).then_some(count))
}

#[cfg(test)]
mod tests {
    use super::super::npy::{npy_bytes, read_npy};
    use super::*;
    use ndarray::Array2;

    fn opened(bytes: &[u8], limit: u64) -> Result<NpzReader, NpzError> {
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join("a.npz");
        std::fs::write(&path, bytes).expect("written");
        NpzReader::open(&path, limit)
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
        let missing = NpzReader::open(Path::new("/nowhere/a.npz"), 1);
        assert!(matches!(missing, Err(NpzError::File(_))));
    }
}
