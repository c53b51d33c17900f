//! Published directories: files at `http(s)://` or `s3://`, downloaded to a cache and checked
//! before use.
//!
//! Downloads are named by the SHA-256 that a manifest tells, so that several datasets, versions
//! and processes share a cache. A download that breaks off goes on where it ended, also in
//! another process; one whose bytes are not those promised is made once more from its beginning.

mod cache;
mod download;
mod error;

use std::collections::HashMap;
use std::fs::File;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard};
use std::time::Duration;

use futures_util::future::{Either, select};
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::http::HttpBuilder;
use object_store::path::Path as ObjectPath;
use object_store::{ClientConfigKey, ObjectStore, ObjectStoreScheme, RetryConfig};
use tokio::runtime::{Builder, Runtime};

use self::cache::{Cache, is_sha256};
use self::download::{RemoteFile, download, download_small};
pub use self::error::RemoteError;
use super::Digest;
use crate::config::RemoteConfig;

/// How often a transfer looks whether it is still wanted.
const GLANCE: Duration = Duration::from_millis(50);

/// A published directory.
#[derive(Debug)]
pub struct Remote {
    url: String,
    store: Box<dyn ObjectStore>,
    base: ObjectPath,
    attempts: u32,
    cache: Cache,
    /// What was downloaded twice instead of something, by the SHA-256 of that.
    damaged: Mutex<HashMap<String, Digest>>,
    runtime: Runtime,
}

impl Remote {
    /// Prepares to read a directory; nothing is transferred yet. For `s3://` the environment is
    /// asked for keys, region and endpoint (`AWS_ACCESS_KEY_ID`, `AWS_REGION`, `AWS_ENDPOINT_URL` ...;
    /// `AWS_SKIP_SIGNATURE=true` for public buckets).
    ///
    /// # Errors
    /// [`RemoteError::Url`], or if the cache cannot be made.
    pub fn open(url: &str, config: &RemoteConfig) -> Result<Self, RemoteError> {
        let wrong = |reason: String| RemoteError::Url { url: url.to_owned(), reason };
        let parsed = url.parse().map_err(|error| wrong(format!("{error}")))?;
        let (scheme, path) =
            ObjectStoreScheme::parse(&parsed).map_err(|error| wrong(error.to_string()))?;
        // Each attempt that brings a byte begins the count anew, which the crate's does not.
        let retry = RetryConfig { max_retries: 0, ..RetryConfig::default() };
        let limits = [
            (ClientConfigKey::ConnectTimeout, "10s".to_owned()),
            (ClientConfigKey::ReadTimeout, format!("{}s", config.timeout_s)),
            // A large shard on a slow line may take its time.
            (ClientConfigKey::Timeout, "1day".to_owned()),
        ];
        let (store, base): (Box<dyn ObjectStore>, _) = match scheme {
            ObjectStoreScheme::Http => {
                let mut builder = HttpBuilder::new().with_url(url).with_retry(retry);
                builder = builder.with_config(ClientConfigKey::AllowHttp, "true");
                for (key, value) in limits {
                    builder = builder.with_config(key, value);
                }
                let store = builder.build().map_err(|error| wrong(error.to_string()))?;
                (Box::new(store), ObjectPath::default())
            }
            ObjectStoreScheme::AmazonS3 => {
                let mut builder = AmazonS3Builder::from_env().with_url(url).with_retry(retry);
                for (key, value) in limits {
                    builder = builder.with_config(AmazonS3ConfigKey::Client(key), value);
                }
                let store = builder.build().map_err(|error| wrong(error.to_string()))?;
                (Box::new(store), path)
            }
            _ => return Err(wrong("another kind of address".to_owned())),
        };
        let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build();
        let runtime = runtime.map_err(RemoteError::Runtime)?;
        let directory = config.cache_dir.clone().unwrap_or_else(default_cache);
        let cache = Cache::open(directory, u64::from(config.cache_mb) * 1_000_000)?;
        let url = url.trim_end_matches('/').to_owned();
        Ok(Self {
            url,
            store,
            base,
            attempts: config.attempts,
            cache,
            damaged: Mutex::default(),
            runtime,
        })
    }

    /// The size of the cache.
    #[must_use]
    pub fn cache_bytes(&self) -> u64 {
        self.cache.limit()
    }

    /// A file that no manifest names, whole.
    ///
    /// # Errors
    /// [`RemoteError`] names the address.
    pub fn read(&self, name: &str) -> Result<Vec<u8>, RemoteError> {
        self.runtime.block_on(download_small(&self.source(name)))
    }

    /// A file of which the content is known: from the cache, or downloaded to it. Several threads
    /// and processes may ask at once; one of them downloads. It is given up, and what came is kept,
    /// once `is_wanted` says no.
    ///
    /// # Errors
    /// [`RemoteError`] names the address.
    pub fn fetch(
        &self,
        name: &str,
        digest: &Digest,
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<File, RemoteError> {
        let source = self.source(name);
        let url = || source.url.clone();
        if !is_sha256(&digest.sha256) {
            return Err(RemoteError::NoDigest { url: url(), sha256: digest.sha256.clone() });
        }
        if let Some(file) = self.cache.get(digest)? {
            return Ok(file);
        }
        let (bytes, limit) = (digest.bytes, self.cache.limit());
        if bytes > limit {
            return Err(RemoteError::CacheTooSmall { url: url(), bytes, limit });
        }
        let mut part = self.cache.lock_part(digest)?;
        // Somebody else may have been quicker.
        if let Some(file) = self.cache.get(digest)? {
            part.discard()?;
            return Ok(file);
        }
        self.cache.make_room(digest)?;
        // What was damaged twice stays so while this program runs: others ask for its records too.
        let known = self.damaged().get(&digest.sha256).cloned();
        let mut damaged = known.clone();
        for _ in 0..if known.is_some() { 0 } else { 2 } {
            self.run(&url, is_wanted, download(&source, &mut part, digest))?;
            let found = part.digest()?;
            if found == *digest {
                return Ok(self.cache.put(part, digest)?);
            }
            part.empty()?;
            damaged = Some(found);
        }
        let found = damaged.expect("two attempts were made, or more before");
        self.damaged().insert(digest.sha256.clone(), found.clone());
        part.discard()?;
        Err(RemoteError::Damaged { url: url(), expected: digest.clone(), found })
    }

    /// Waits for a transfer as long as it is wanted.
    fn run(
        &self,
        url: &dyn Fn() -> String,
        is_wanted: &dyn Fn() -> bool,
        transfer: impl Future<Output = Result<(), RemoteError>>,
    ) -> Result<(), RemoteError> {
        let unwanted = async {
            while is_wanted() {
                tokio::time::sleep(GLANCE).await;
            }
        };
        let (transfer, unwanted) = (std::pin::pin!(transfer), std::pin::pin!(unwanted));
        match self.runtime.block_on(select(transfer, unwanted)) {
            Either::Left((done, _)) => done,
            Either::Right(_) => Err(RemoteError::Stopped { url: url() }),
        }
    }

    fn damaged(&self) -> MutexGuard<'_, HashMap<String, Digest>> {
        self.damaged.lock().expect("nothing panics while it holds the lock")
    }

    fn source(&self, name: &str) -> RemoteFile<'_> {
        let path = name.split('/').fold(self.base.clone(), ObjectPath::join);
        let url = format!("{}/{name}", self.url);
        RemoteFile { store: &*self.store, path, url, attempts: self.attempts }
    }
}

/// Where downloads are kept if the configuration does not say.
fn default_cache() -> PathBuf {
    let set = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty());
    let base = set("XDG_CACHE_HOME").map(PathBuf::from);
    let base = base.or_else(|| Some(PathBuf::from(set("HOME")?).join(".cache")));
    base.unwrap_or_else(std::env::temp_dir).join("holescout")
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;
    use std::time::Instant;

    use super::*;
    use crate::error::{Fault, HasFault};
    use crate::store::sha256_bytes;

    fn open(url: &str, cache: &std::path::Path) -> Result<Remote, RemoteError> {
        let config = RemoteConfig {
            cache_dir: Some(cache.to_owned()),
            attempts: 2,
            ..RemoteConfig::default()
        };
        Remote::open(url, &config)
    }

    #[test]
    fn addresses_that_cannot_be_read_are_named() {
        let dir = tempfile::tempdir().expect("a directory");
        for url in ["http://", "gs://bucket/x", "s3:///x"] {
            let error = open(url, dir.path()).expect_err("no address");
            assert!(matches!(error, RemoteError::Url { .. }), "{url}: {error}");
            assert_eq!(error.fault(), Fault::Input);
        }
    }

    /// Nobody has to wait for a server that takes a connection and says nothing.
    #[test]
    fn a_download_that_is_not_wanted_any_more_ends() {
        let dir = tempfile::tempdir().expect("a directory");
        let silent = TcpListener::bind("127.0.0.1:0").expect("a port");
        let url = format!("http://{}/dataset", silent.local_addr().expect("an address"));
        let remote = open(&url, dir.path()).expect("opened");
        let begin = Instant::now();
        let is_wanted = || begin.elapsed() < Duration::from_millis(200);
        let stopped = remote.fetch("shard", &sha256_bytes(b"something"), &is_wanted);
        assert!(matches!(stopped, Err(RemoteError::Stopped { .. })), "{stopped:?}");
    }

    #[test]
    fn what_does_not_fit_or_has_no_digest_is_not_asked_for() {
        let dir = tempfile::tempdir().expect("a directory");
        let remote = open("http://127.0.0.1:9/dataset", dir.path()).expect("opened");
        let large = Digest { bytes: u64::MAX, ..sha256_bytes(b"x") };
        let refused = remote.fetch("shard", &large, &|| true);
        assert!(matches!(refused, Err(RemoteError::CacheTooSmall { .. })), "{refused:?}");
        let nameless = Digest { bytes: 1, sha256: "../../x".to_owned() };
        let refused = remote.fetch("shard", &nameless, &|| true);
        assert!(matches!(refused, Err(RemoteError::NoDigest { .. })), "{refused:?}");
    }
}
