//! One download, begun again where it broke off.

use std::time::Duration;

use futures_util::StreamExt;
use object_store::client::HttpError;
use object_store::path::Path as ObjectPath;
use object_store::{Error, GetOptions, GetRange, ObjectStore};

use super::cache::PartialFile;
use super::error::RemoteError;
use crate::store::Digest;

/// Files that no manifest names are read into memory; none of ours is larger.
const MOST_SMALL: u64 = 1 << 28;

/// A file on a server.
pub(super) struct RemoteFile<'a> {
    pub(super) store: &'a dyn ObjectStore,
    pub(super) path: ObjectPath,
    pub(super) url: String,
    /// Attempts in a row without a new byte before it is given up.
    pub(super) attempts: u32,
}

impl RemoteFile<'_> {
    /// Waits before the next attempt, or says why there is none.
    async fn wait(&self, why: Interrupted, failures: u32) -> Result<(), RemoteError> {
        let reason = match why {
            Interrupted::Final(error) => return Err(error),
            Interrupted::Early(reason) => reason.to_owned(),
            Interrupted::Failed(error) => match refusal(&error) {
                Some(refused) => return Err(refused(self.url.clone(), reason(&error))),
                None => reason(&error),
            },
        };
        if failures >= self.attempts {
            let url = self.url.clone();
            return Err(RemoteError::Failed { url, attempts: failures, reason });
        }
        tokio::time::sleep(pause(failures)).await;
        Ok(())
    }
}

/// Why an answer is not whole.
enum Interrupted {
    /// Another attempt would end in the same way.
    Final(RemoteError),
    Failed(Error),
    /// It ended early, or too late.
    Early(&'static str),
}

impl Interrupted {
    /// Whether the network failed, which tells nothing of what was asked for.
    fn is_weather(&self) -> bool {
        let Self::Failed(error) = self else { return false };
        let mut source = std::error::Error::source(error);
        while let Some(error) = source {
            if error.is::<HttpError>() {
                return true;
            }
            source = error.source();
        }
        false
    }
}

/// What becomes of an answer that another attempt would not change.
fn refusal(error: &Error) -> Option<fn(String, String) -> RemoteError> {
    match error {
        Error::NotFound { .. } => Some(|url, _| RemoteError::NotFound { url }),
        Error::Unauthenticated { .. } | Error::PermissionDenied { .. } => {
            Some(|url, reason| RemoteError::Refused { url, reason })
        }
        Error::InvalidPath { .. } | Error::UnknownConfigurationKey { .. } => {
            Some(|url, reason| RemoteError::Url { url, reason })
        }
        _ => None,
    }
}

/// An error with what it came from, which the crate leaves to be asked for.
fn reason(error: &Error) -> String {
    let mut reason = error.to_string();
    let mut source = std::error::Error::source(error);
    while let Some(error) = source {
        let text = error.to_string();
        if !reason.contains(&text) {
            reason = format!("{reason}: {text}");
        }
        source = error.source();
    }
    reason
}

/// Appends to a download until it is as large as its manifest says. What is there is taken for the
/// beginning.
pub(super) async fn download(
    source: &RemoteFile<'_>,
    part: &mut PartialFile,
    digest: &Digest,
) -> Result<(), RemoteError> {
    if part.len()? > digest.bytes {
        part.empty()?;
    }
    let (mut failures, mut restarted) = (0, false);
    // Only what was never had before counts as getting on: a server that knows no ranges may send
    // the beginning for ever.
    let mut most = part.len()?;
    while part.len()? < digest.bytes {
        let before = part.len()?;
        let Err(why) = stream(source, part, digest).await else { continue };
        let have = part.len()?;
        failures = if have > most { 1 } else { failures + 1 };
        most = most.max(have);
        if before > 0 && have == before && !why.is_weather() && !restarted {
            // The server may not know of ranges, or have another file now: all of it then.
            part.empty()?;
            restarted = true;
        }
        source.wait(why, failures).await?;
    }
    Ok(())
}

/// One answer of the server, from the end of what is there on.
async fn stream(
    source: &RemoteFile<'_>,
    part: &mut PartialFile,
    digest: &Digest,
) -> Result<(), Interrupted> {
    let on_disk = |error| Interrupted::Final(RemoteError::Cache(error));
    let mut have = part.len().map_err(on_disk)?;
    let range = (have > 0).then_some(GetRange::Offset(have));
    let options = GetOptions { range, ..GetOptions::default() };
    let answer = source.store.get_opts(&source.path, options).await;
    let answer = answer.map_err(Interrupted::Failed)?;
    let (expected, found) = (digest.bytes, answer.meta.size);
    if found != expected {
        let url = source.url.clone();
        return Err(Interrupted::Final(RemoteError::Size { url, expected, found }));
    }
    let mut body = answer.into_stream();
    while let Some(chunk) = body.next().await {
        let chunk = chunk.map_err(Interrupted::Failed)?;
        have += chunk.len() as u64;
        if have > expected {
            return Err(Interrupted::Early("more bytes came than the server had announced"));
        }
        part.append(&chunk).map_err(on_disk)?;
    }
    if have < expected {
        return Err(Interrupted::Early("fewer bytes came than the server had announced"));
    }
    Ok(())
}

/// A whole file into memory.
pub(super) async fn download_small(source: &RemoteFile<'_>) -> Result<Vec<u8>, RemoteError> {
    let mut failures = 0;
    loop {
        match small(source).await {
            Ok(bytes) => return Ok(bytes),
            Err(why) => {
                failures += 1;
                source.wait(why, failures).await?;
            }
        }
    }
}

async fn small(source: &RemoteFile<'_>) -> Result<Vec<u8>, Interrupted> {
    let too_large = |bytes| {
        let (url, limit) = (source.url.clone(), MOST_SMALL);
        Interrupted::Final(RemoteError::TooLarge { url, bytes, limit })
    };
    let answer = source.store.get_opts(&source.path, GetOptions::default()).await;
    let answer = answer.map_err(Interrupted::Failed)?;
    if answer.meta.size > MOST_SMALL {
        return Err(too_large(answer.meta.size));
    }
    let mut body = answer.into_stream();
    let mut bytes = Vec::new();
    while let Some(chunk) = body.next().await {
        bytes.extend_from_slice(&chunk.map_err(Interrupted::Failed)?);
        if bytes.len() as u64 > MOST_SMALL {
            return Err(too_large(bytes.len() as u64));
        }
    }
    Ok(bytes)
}

/// How long to wait after so many failures in a row: a fifth of a second, doubled each time, at most
/// ten seconds.
fn pause(failures: u32) -> Duration {
    Duration::from_millis(100).saturating_mul(1 << failures.min(10)).min(Duration::from_secs(10))
}
