//! One download, begun again where it broke off.

use futures_util::StreamExt;
use object_store::path::Path as ObjectPath;
use object_store::{Error, GetOptions, GetRange, ObjectStore};

use super::cache::Part;
use super::{RemoteError, pause};
use crate::store::Digest;

/// Files that no manifest names are read into memory; none of ours is larger.
const MOST_SMALL: usize = 1 << 30;

/// A file on a server.
pub(super) struct Source<'a> {
    pub(super) store: &'a dyn ObjectStore,
    pub(super) path: ObjectPath,
    pub(super) url: String,
    /// Attempts in a row without a new byte before it is given up.
    pub(super) attempts: u32,
}

impl Source<'_> {
    /// What becomes of a failure: `None` to try again after a pause.
    async fn failed(&self, error: &Error, failures: u32) -> Option<RemoteError> {
        let url = self.url.clone();
        match error {
            Error::NotFound { .. } => return Some(RemoteError::NotFound { url }),
            Error::Unauthenticated { .. }
            | Error::PermissionDenied { .. }
            | Error::InvalidPath { .. }
            | Error::UnknownConfigurationKey { .. } => {
                return Some(RemoteError::Url { url, reason: reason(error) });
            }
            _ if failures >= self.attempts => {
                let reason = reason(error);
                return Some(RemoteError::Failed { url, attempts: failures, reason });
            }
            _ => {}
        }
        tokio::time::sleep(pause(failures)).await;
        None
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
    source: &Source<'_>,
    part: &mut Part,
    digest: &Digest,
) -> Result<(), RemoteError> {
    let mut failures = 0;
    let mut have = part.len()?;
    if have > digest.bytes {
        part.empty()?;
        have = 0;
    }
    while have < digest.bytes {
        let before = have;
        let Some(error) = stream(source, part, &mut have, digest).await? else { continue };
        if have == before && have > 0 && !is_weather(&error) {
            // The server may not know of ranges: all of it then.
            part.empty()?;
            have = 0;
        }
        failures = if have > before { 1 } else { failures + 1 };
        if let Some(error) = source.failed(&error, failures).await {
            return Err(error);
        }
    }
    Ok(())
}

/// Whether a failure tells nothing of what was asked for.
fn is_weather(error: &Error) -> bool {
    !matches!(error, Error::NotSupported { .. } | Error::Precondition { .. })
}

/// One answer of the server, from `have` on, and why it ended early.
async fn stream(
    source: &Source<'_>,
    part: &mut Part,
    have: &mut u64,
    digest: &Digest,
) -> Result<Option<Error>, RemoteError> {
    let range = (*have > 0).then_some(GetRange::Offset(*have));
    let options = GetOptions { range, ..GetOptions::default() };
    let answer = match source.store.get_opts(&source.path, options).await {
        Ok(answer) => answer,
        Err(error) => return Ok(Some(error)),
    };
    let (expected, found) = (digest.bytes, answer.meta.size);
    if found != expected {
        return Err(RemoteError::Size { url: source.url.clone(), expected, found });
    }
    let mut body = answer.into_stream();
    while let Some(chunk) = body.next().await {
        match chunk {
            Ok(chunk) => {
                part.append(&chunk)?;
                *have += chunk.len() as u64;
            }
            Err(error) => return Ok(Some(error)),
        }
    }
    Ok(None)
}

/// A whole file into memory.
pub(super) async fn download_small(source: &Source<'_>) -> Result<Vec<u8>, RemoteError> {
    let mut failures = 0;
    loop {
        match small(source).await {
            Ok(bytes) => return Ok(bytes),
            Err(error) => {
                failures += 1;
                if let Some(error) = source.failed(&error, failures).await {
                    return Err(error);
                }
            }
        }
    }
}

async fn small(source: &Source<'_>) -> Result<Vec<u8>, Error> {
    let answer = source.store.get_opts(&source.path, GetOptions::default()).await?;
    let mut body = answer.into_stream();
    let mut bytes = Vec::new();
    while let Some(chunk) = body.next().await {
        bytes.extend_from_slice(&chunk?);
        if bytes.len() > MOST_SMALL {
            let message = format!("{}: more than {MOST_SMALL} bytes", source.url);
            return Err(Error::NotSupported { source: message.into() });
        }
    }
    Ok(bytes)
}
