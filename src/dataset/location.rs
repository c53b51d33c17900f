//! Where the files of a dataset come from: a directory, or with the feature `remote` a server.

use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::error::{ReadError, unreadable};
use crate::config::RemoteConfig;
use crate::error::FileError;
use crate::manifest::ManifestError;
#[cfg(feature = "remote")]
use crate::store::Remote;
use crate::store::{Digest, MANIFEST};

/// Where a dataset lies.
#[derive(Debug)]
pub(super) enum Location {
    Directory(PathBuf),
    #[cfg(feature = "remote")]
    Server(Box<Remote>),
}

impl Location {
    pub(super) fn of(location: &Path, config: &RemoteConfig) -> Result<Self, ReadError> {
        match location.to_str().filter(|text| is_url(text)) {
            Some(url) => Self::server(url, config),
            None => Ok(Self::Directory(location.to_owned())),
        }
    }

    #[cfg(feature = "remote")]
    fn server(url: &str, config: &RemoteConfig) -> Result<Self, ReadError> {
        Ok(Self::Server(Box::new(Remote::open(url, config)?)))
    }

    #[cfg(not(feature = "remote"))]
    fn server(url: &str, _: &RemoteConfig) -> Result<Self, ReadError> {
        Err(ReadError::NoRemote { url: url.to_owned() })
    }

    /// Bytes of files that may be at hand at a time, where they have to be downloaded.
    pub(super) fn cache_bytes(&self) -> Option<u64> {
        match self {
            Self::Directory(_) => None,
            #[cfg(feature = "remote")]
            Self::Server(server) => Some(server.cache_bytes()),
        }
    }

    /// A file that says what the others must be.
    pub(super) fn read(&self, name: &str) -> Result<Vec<u8>, ReadError> {
        let directory = match self {
            Self::Directory(directory) => directory,
            #[cfg(feature = "remote")]
            Self::Server(server) => return Ok(server.read(name)?),
        };
        let path = directory.join(name);
        let read = std::fs::read(&path).map_err(|error| match error.kind() {
            ErrorKind::NotFound if name == MANIFEST => {
                ManifestError::Absent { directory: directory.clone(), stage: "shard" }
            }
            _ => FileError::new("read", &path)(error).into(),
        });
        Ok(read?)
    }

    /// A file of which the manifest tells the content. One in a directory is checked as it is
    /// read, one from a server before, for which it is waited as long as it is wanted.
    #[cfg_attr(not(feature = "remote"), expect(unused_variables, reason = "for servers"))]
    pub(super) fn open(
        &self,
        name: &str,
        digest: &Digest,
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<File, ReadError> {
        match self {
            Self::Directory(directory) => {
                let path = directory.join(name);
                let file = File::open(&path).map_err(|error| unreadable(&path, error))?;
                read_ahead(&file);
                Ok(file)
            }
            #[cfg(feature = "remote")]
            Self::Server(server) => Ok(server.fetch(name, digest, is_wanted)?),
        }
    }
}

/// Records of a shard will be wanted in any order: let the disk read them in its own. It is a wish,
/// and nothing is lost if it is not granted, or where there is no such call.
#[cfg_attr(not(target_os = "linux"), expect(unused_variables, reason = "there is no such call"))]
fn read_ahead(file: &File) {
    #[cfg(target_os = "linux")]
    let _ = rustix::fs::fadvise(file, 0, None, rustix::fs::Advice::WillNeed);
}

fn is_url(text: &str) -> bool {
    ["http://", "https://", "s3://"].iter().any(|scheme| text.starts_with(scheme))
}
