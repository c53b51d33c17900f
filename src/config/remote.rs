//! `[remote]`: datasets that are read from a server.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{ConfigError, demand};

/// `[remote]`: how datasets at `http(s)://` and `s3://` are read. It changes no result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RemoteConfig {
    /// Directory of downloads; by default `holescout` in the user's cache directory.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cache_dir: Option<PathBuf>,
    /// Most that it holds, in MB.
    pub cache_mb: u32,
    /// Attempts in a row that may bring no new byte, each after a longer pause, before a download
    /// is given up.
    pub attempts: u32,
    /// Time without a byte after which a connection counts as dead, in seconds.
    pub timeout_s: u32,
}

impl Default for RemoteConfig {
    fn default() -> Self {
        Self { cache_dir: None, cache_mb: 20_000, attempts: 8, timeout_s: 30 }
    }
}

impl RemoteConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        for (key, value, most) in [
            ("remote.cache_mb", self.cache_mb, 1_000_000_000),
            ("remote.attempts", self.attempts, 1000),
            ("remote.timeout_s", self.timeout_s, 3600),
        ] {
            demand((1..=most).contains(&value), key, value, format!("1 to {most}"))?;
        }
        Ok(())
    }
}
