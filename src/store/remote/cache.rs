//! Downloads on a disk, named by their SHA-256.

use std::collections::HashSet;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::SystemTime;

use crate::error::FileError;
use crate::store::atomic::is_at;
use crate::store::{Digest, sha256_file};

/// How a download is called that is not whole yet.
const PART: &str = "part";

/// A directory of downloads, together at most so large. The ones used longest ago make room for
/// others; who has one open keeps it.
#[derive(Debug)]
pub(super) struct Cache {
    directory: PathBuf,
    limit: u64,
    /// What this process has found sound.
    checked: Mutex<HashSet<String>>,
}

/// A download that this process alone writes to.
pub(super) struct Part {
    path: PathBuf,
    file: File,
}

impl Cache {
    pub(super) fn open(directory: PathBuf, limit: u64) -> Result<Self, FileError> {
        std::fs::create_dir_all(&directory).map_err(FileError::new("create", &directory))?;
        Ok(Self { directory, limit, checked: Mutex::default() })
    }

    pub(super) fn limit(&self) -> u64 {
        self.limit
    }

    /// A download that is here and whole; one that is damaged is removed.
    pub(super) fn get(&self, digest: &Digest) -> Result<Option<File>, FileError> {
        let path = self.path(digest);
        let file = match File::open(&path) {
            Ok(file) => file,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(FileError::new("open", &path)(error)),
        };
        if !self.checked().contains(&digest.sha256) {
            if sha256_file(&path).ok().as_ref() != Some(digest) {
                remove(&path)?;
                return Ok(None);
            }
            self.checked().insert(digest.sha256.clone());
        }
        // When it was used last; a cache that cannot tell evicts in another order.
        let _ = file.set_modified(SystemTime::now());
        Ok(Some(file))
    }

    /// Waits for the right to download something.
    pub(super) fn lock_part(&self, digest: &Digest) -> Result<Part, FileError> {
        let path = self.path(digest).with_extension(PART);
        loop {
            let open = OpenOptions::new().create(true).read(true).append(true).open(&path);
            let file = open.map_err(FileError::new("create", &path))?;
            file.lock().map_err(FileError::new("lock", &path))?;
            // Who had the lock before may have renamed or removed it.
            if is_at(&file, &path) {
                return Ok(Part { path, file });
            }
        }
    }

    /// Removes what was used longest ago until a download fits.
    pub(super) fn make_room(&self, digest: &Digest) -> Result<(), FileError> {
        let own = self.path(digest).with_extension(PART);
        let directory = &self.directory;
        let entries = std::fs::read_dir(directory).map_err(FileError::new("list", directory))?;
        let mut others: Vec<(SystemTime, u64, PathBuf)> = entries
            .flatten()
            .filter_map(|entry| {
                let (path, about) = (entry.path(), entry.metadata().ok()?);
                let name = path.file_stem()?.to_str()?;
                let is_ours = name.len() == digest.sha256.len() && path != own;
                is_ours.then_some((about.modified().ok()?, about.len(), path))
            })
            .collect();
        others.sort_unstable();
        let mut total: u64 = others.iter().map(|(_, bytes, _)| bytes).sum();
        for (_, bytes, path) in others {
            if total.saturating_add(digest.bytes) <= self.limit {
                break;
            }
            if is_being_written(&path) {
                continue;
            }
            remove(&path)?;
            total -= bytes;
        }
        Ok(())
    }

    /// Takes over a download whose digest was checked.
    pub(super) fn put(&self, part: &Part, digest: &Digest) -> Result<File, FileError> {
        let path = self.path(digest);
        part.file.sync_all().map_err(FileError::new("sync", &part.path))?;
        std::fs::rename(&part.path, &path).map_err(FileError::new("write", &path))?;
        self.checked().insert(digest.sha256.clone());
        File::open(&path).map_err(FileError::new("open", &path))
    }

    fn path(&self, digest: &Digest) -> PathBuf {
        self.directory.join(&digest.sha256)
    }

    fn checked(&self) -> std::sync::MutexGuard<'_, HashSet<String>> {
        self.checked.lock().expect("nothing panics while it holds the lock")
    }
}

impl Part {
    /// Bytes that are here.
    pub(super) fn len(&self) -> Result<u64, FileError> {
        let about = self.file.metadata().map_err(FileError::new("read", &self.path))?;
        Ok(about.len())
    }

    pub(super) fn append(&mut self, bytes: &[u8]) -> Result<(), FileError> {
        self.file.write_all(bytes).map_err(FileError::new("write", &self.path))
    }

    pub(super) fn digest(&self) -> Result<Digest, FileError> {
        sha256_file(&self.path)
    }

    /// Begins anew.
    pub(super) fn empty(&mut self) -> Result<(), FileError> {
        self.file.set_len(0).map_err(FileError::new("write", &self.path))
    }

    /// Gives up what was downloaded.
    pub(super) fn discard(self) -> Result<(), FileError> {
        remove(&self.path)
    }
}

/// Whether another process or thread downloads to this file now.
fn is_being_written(path: &Path) -> bool {
    let is_part = path.extension().is_some_and(|extension| extension == PART);
    is_part && File::open(path).is_ok_and(|file| file.try_lock().is_err())
}

fn remove(path: &Path) -> Result<(), FileError> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(FileError::new("remove", path)(error))
        }
        _ => Ok(()),
    }
}
