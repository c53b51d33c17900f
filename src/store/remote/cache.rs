//! Downloads on a disk, named by their SHA-256.

use std::collections::HashSet;
use std::fs::{File, OpenOptions};
use std::io::{Seek, Write};
use std::path::PathBuf;
use std::sync::Mutex;
use std::time::SystemTime;

use crate::error::FileError;
use crate::store::atomic::{is_at, remove_if_there};
use crate::store::{Digest, sha256_file, sha256_reader};

/// How a download is called that is not whole yet: `<SHA-256>.<bytes>.part`, so that others know how
/// much room it will take.
const PART: &str = ".part";

/// A directory of downloads, together at most so large but for those under way. The ones used
/// longest ago make room for others; who has one open keeps it.
#[derive(Debug)]
pub(super) struct Cache {
    directory: PathBuf,
    limit: u64,
    /// What this process has found sound.
    checked: Mutex<HashSet<String>>,
}

/// A download that this process alone writes to.
pub(super) struct PartialFile {
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
                remove_if_there(&path)?;
                return Ok(None);
            }
            self.checked().insert(digest.sha256.clone());
        }
        // When it was used last; a cache that cannot tell evicts in another order.
        let _ = file.set_modified(SystemTime::now());
        Ok(Some(file))
    }

    /// Waits for the right to download something.
    pub(super) fn lock_part(&self, digest: &Digest) -> Result<PartialFile, FileError> {
        let path = self.directory.join(format!("{}.{}{PART}", digest.sha256, digest.bytes));
        loop {
            let open = OpenOptions::new().create(true).read(true).append(true).open(&path);
            let file = open.map_err(FileError::new("create", &path))?;
            file.lock().map_err(FileError::new("lock", &path))?;
            // Who had the lock before may have renamed or removed it.
            if is_at(&file, &path) {
                return Ok(PartialFile { path, file });
            }
        }
    }

    /// Removes what was used longest ago until a download fits.
    pub(super) fn make_room(&self, digest: &Digest) -> Result<(), FileError> {
        let directory = &self.directory;
        let entries = std::fs::read_dir(directory).map_err(FileError::new("list", directory))?;
        let mut others: Vec<(SystemTime, Download)> = entries
            .flatten()
            .filter_map(|entry| {
                let about = entry.metadata().ok()?;
                let download = Download::of(entry.path(), about.len())?;
                Some((about.modified().ok()?, download))
            })
            .filter(|(_, download)| download.sha256 != digest.sha256)
            .collect();
        others.sort_unstable();
        let mut total =
            others.iter().fold(0, |sum: u64, (_, other)| sum.saturating_add(other.bytes));
        for (_, other) in others {
            if total.saturating_add(digest.bytes) <= self.limit {
                break;
            }
            if other.remove()? {
                total -= other.bytes;
            }
        }
        Ok(())
    }

    /// Takes over a download whose digest was checked.
    pub(super) fn put(&self, part: PartialFile, digest: &Digest) -> Result<File, FileError> {
        let path = self.path(digest);
        part.file.sync_all().map_err(FileError::new("sync", &part.path))?;
        std::fs::rename(&part.path, &path).map_err(FileError::new("write", &path))?;
        part.file.unlock().map_err(FileError::new("unlock", &path))?;
        self.checked().insert(digest.sha256.clone());
        Ok(part.file)
    }

    fn path(&self, digest: &Digest) -> PathBuf {
        self.directory.join(&digest.sha256)
    }

    fn checked(&self) -> std::sync::MutexGuard<'_, HashSet<String>> {
        self.checked.lock().expect("nothing panics while it holds the lock")
    }
}

impl PartialFile {
    /// Bytes that are here.
    pub(super) fn len(&self) -> Result<u64, FileError> {
        let about = self.file.metadata().map_err(FileError::new("read", &self.path))?;
        Ok(about.len())
    }

    pub(super) fn append(&mut self, bytes: &[u8]) -> Result<(), FileError> {
        self.file.write_all(bytes).map_err(FileError::new("write", &self.path))
    }

    pub(super) fn digest(&mut self) -> Result<Digest, FileError> {
        let read = self.file.rewind().and_then(|()| sha256_reader(&mut self.file));
        read.map_err(FileError::new("read", &self.path))
    }

    /// Begins anew.
    pub(super) fn empty(&mut self) -> Result<(), FileError> {
        self.file.set_len(0).map_err(FileError::new("write", &self.path))
    }

    /// Gives up what was downloaded.
    pub(super) fn discard(self) -> Result<(), FileError> {
        remove_if_there(&self.path)
    }
}

/// A file of a cache.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Download {
    path: PathBuf,
    sha256: String,
    /// What it takes once it is whole.
    bytes: u64,
    is_part: bool,
}

impl Download {
    /// `None` for files of somebody else.
    fn of(path: PathBuf, found: u64) -> Option<Self> {
        let name = path.file_name()?.to_str()?;
        let part = name.strip_suffix(PART).map(|stem| stem.split_once('.'));
        let (sha256, bytes) = match part {
            Some(named) => named.and_then(|(sha256, bytes)| Some((sha256, bytes.parse().ok()?)))?,
            None => (name, found),
        };
        let (sha256, is_part) = (sha256.to_owned(), part.is_some());
        is_sha256(&sha256).then_some(Self { path, sha256, bytes, is_part })
    }

    /// Removes it, unless another process or thread is writing it.
    fn remove(&self) -> Result<bool, FileError> {
        // The lock is held until the file is gone, so that nobody begins to write to it.
        let writer = if self.is_part { File::open(&self.path).ok() } else { None };
        if writer.as_ref().is_some_and(|file| file.try_lock().is_err()) {
            return Ok(false);
        }
        remove_if_there(&self.path)?;
        Ok(true)
    }
}

pub(super) fn is_sha256(text: &str) -> bool {
    text.len() == 64 && text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::sha256_bytes;

    fn add(cache: &Cache, content: &[u8]) -> Digest {
        let digest = sha256_bytes(content);
        let mut part = cache.lock_part(&digest).expect("locked");
        cache.make_room(&digest).expect("room");
        part.append(content).expect("written");
        cache.put(part, &digest).expect("taken over");
        digest
    }

    fn is_there(cache: &Cache, digest: &Digest) -> bool {
        cache.get(digest).expect("readable").is_some()
    }

    #[test]
    fn what_was_used_longest_ago_makes_room_and_files_of_others_stay() {
        let dir = tempfile::tempdir().expect("a directory");
        let cache = Cache::open(dir.path().to_owned(), 25).expect("opened");
        let foreign =
            ["notes.txt", &"a".repeat(64).replace('a', "x"), &format!("{}.bak", "a".repeat(64))];
        for name in foreign {
            std::fs::write(dir.path().join(name), [0; 100]).expect("written");
        }
        let [one, two] = [add(&cache, b"0123456789"), add(&cache, b"abcdefghij")];
        let used = |digest: &Digest, seconds: u64| {
            let file = File::open(cache.path(digest)).expect("there");
            let time = SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(seconds);
            file.set_modified(time).expect("set");
        };
        used(&one, 200);
        used(&two, 100);
        let three = add(&cache, b"ABCDEFGHIJ");
        assert!(is_there(&cache, &one) && is_there(&cache, &three) && !is_there(&cache, &two));
        assert!(foreign.iter().all(|name| dir.path().join(name).exists()));
    }

    #[test]
    fn a_part_goes_on_and_one_that_is_being_written_is_left_alone() {
        let dir = tempfile::tempdir().expect("a directory");
        let cache = Cache::open(dir.path().to_owned(), 12).expect("opened");
        let digest = sha256_bytes(b"0123456789");
        let mut part = cache.lock_part(&digest).expect("locked");
        part.append(b"01234").expect("written");
        add(&cache, b"abcdefghij");
        assert!(part.path.exists(), "it is being written");
        drop(part);
        let mut part = cache.lock_part(&digest).expect("locked again");
        assert_eq!(part.len().expect("known"), 5);
        part.append(b"56789").expect("written");
        assert_eq!(part.digest().expect("read"), digest);
        let mut whole = cache.put(part, &digest).expect("taken over");
        whole.rewind().expect("a file");
        assert_eq!(sha256_reader(&mut whole).expect("read"), digest);
        let names = std::fs::read_dir(dir.path()).expect("listed").flatten();
        let parts = names.filter(|entry| entry.file_name().to_string_lossy().ends_with(PART));
        assert!(is_there(&cache, &digest) && parts.count() == 0);
    }

    #[test]
    fn a_damaged_file_is_removed_unless_it_was_checked_by_this_process() {
        let dir = tempfile::tempdir().expect("a directory");
        let open = || Cache::open(dir.path().to_owned(), 100).expect("opened");
        let digest = add(&open(), b"0123456789");
        std::fs::write(open().path(&digest), b"012345678X").expect("damaged");
        assert!(!is_there(&open(), &digest));
        assert!(!open().path(&digest).exists());
    }
}
