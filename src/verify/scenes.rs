//! Scenes for a ray tracer.

use std::path::Path;

use super::failure::VerifyFailure;
use super::items::check_items;
use crate::manifest::ScenesManifest;
use crate::progress::Progress;
use crate::scenes::check_scene;
use crate::store::MANIFEST;

/// Lists what is wrong, and returns the number of scenes.
pub(super) fn check(
    root: &Path,
    manifest: &ScenesManifest,
    progress: &dyn Progress,
    failures: &mut Vec<VerifyFailure>,
) -> usize {
    check_items(&manifest.scenes, progress, failures, |entry| {
        let file = entry.files.first().map_or(MANIFEST, |first| &first.file);
        (file, check_scene(root, entry))
    })
}
