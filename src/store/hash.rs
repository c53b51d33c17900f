//! SHA-256, the only checksum that leaves the program.

use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::error::FileError;

/// Size and SHA-256 of a file's content.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Digest {
    /// Size, in bytes.
    pub bytes: u64,
    /// SHA-256, 64 lower-case hexadecimal digits.
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    pub sha256: String,
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} bytes, SHA-256 {}", self.bytes, self.sha256)
    }
}

/// The digest of bytes in memory.
#[must_use]
pub fn sha256_bytes(bytes: &[u8]) -> Digest {
    Digest { bytes: bytes.len() as u64, sha256: hexadecimal(&Sha256::digest(bytes)) }
}

/// The digest of a file, read in pieces.
///
/// # Errors
/// [`FileError`] when the file cannot be read.
pub fn sha256_file(path: &Path) -> Result<Digest, FileError> {
    let mut file = File::open(path).map_err(FileError::new("open", path))?;
    sha256_reader(&mut file).map_err(FileError::new("read", path))
}

/// The digest of what is left of a stream.
pub(super) fn sha256_reader(reader: &mut impl Read) -> std::io::Result<Digest> {
    let (mut hasher, mut bytes) = (Sha256::new(), 0);
    let mut buffer = vec![0; 1 << 18];
    loop {
        let read = reader.read(&mut buffer)?;
        if read == 0 {
            return Ok(Digest { bytes, sha256: hexadecimal(&hasher.finalize()) });
        }
        hasher.update(&buffer[..read]);
        bytes += read as u64;
    }
}

fn hexadecimal(bytes: &[u8]) -> String {
    use fmt::Write;
    bytes.iter().fold(String::with_capacity(64), |mut text, byte| {
        write!(text, "{byte:02x}").expect("writing to a string cannot fail");
        text
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_answer_of_fips_180() {
        let abc = sha256_bytes(b"abc");
        assert_eq!(abc.sha256, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join("abc");
        std::fs::write(&path, b"abc").expect("written");
        assert_eq!(sha256_file(&path).expect("hashed"), abc);
    }
}
