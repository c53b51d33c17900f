//! Tiles: every grid is sound, and every object of the extract accounted for.

use std::path::Path;

use super::failure::{VerifyFailure, demand, failure};
use super::items::check_items;
use crate::manifest::{TileFile, TilesManifest};
use crate::progress::Progress;
use crate::store::MANIFEST;

/// Lists what is wrong, and returns the number of tiles.
pub(super) fn check(
    root: &Path,
    manifest: &TilesManifest,
    progress: &dyn Progress,
    failures: &mut Vec<VerifyFailure>,
) -> usize {
    let (tagged, accounted) = (manifest.buildings.tagged, manifest.accounted());
    if tagged != accounted {
        let reason = format!(
            "{tagged} objects with building tags, but {accounted} buildings and rows of \
             problems.csv that say why not"
        );
        failures.push(failure(MANIFEST, reason));
    }
    check_items(&manifest.tiles, progress, failures, |entry| {
        let read = TileFile::read(root, entry).map_err(|error| error.to_string());
        let matches = read.map(|tile| tile.meta.id == entry.id);
        (&entry.file, demand(matches, "tile id differs from the manifest's"))
    })
}
