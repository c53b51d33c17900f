//! Imported radio maps.

use std::path::Path;

use super::failure::{VerifyFailure, demand};
use super::items::check_items;
use crate::manifest::{RsrpFile, RsrpManifest};
use crate::progress::Progress;

/// Lists what is wrong, and returns the number of maps.
pub(super) fn check(
    root: &Path,
    manifest: &RsrpManifest,
    progress: &dyn Progress,
    failures: &mut Vec<VerifyFailure>,
) -> usize {
    check_items(&manifest.maps, progress, failures, |entry| {
        let read = RsrpFile::read(root, entry).map_err(|error| error.to_string());
        let matches = read.map(|map| map.meta.id == entry.id);
        (&entry.file, demand(matches, "tile id differs from the manifest's"))
    })
}
