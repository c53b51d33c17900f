//! Flags for `[remote]`.

use std::path::PathBuf;

use clap::{Args, ValueHint};
use holescout::config::Config;

use super::set;

/// Flags of what reads a dataset: a directory, or with the feature `remote` a server.
#[derive(Debug, Args)]
pub(crate) struct RemoteFlags {
    /// remote.cache_dir: where shards from servers are kept [default: the user's cache]
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    cache: Option<PathBuf>,
    /// remote.cache_mb: most that is kept there, in MB
    #[arg(long, value_name = "MB")]
    cache_mb: Option<u32>,
}

impl RemoteFlags {
    pub(super) fn apply(&self, config: &mut Config) {
        let remote = &mut config.remote;
        remote.cache_dir = self.cache.clone().or(remote.cache_dir.take());
        set(&mut remote.cache_mb, self.cache_mb.as_ref());
    }
}
