//! `holescout verify --rebuild`: an output is built once more, from the inputs that its manifest
//! records, and every file compared.
//!
//! Manifests name inputs by name and SHA-256, never by path: whoever rebuilds says where they lie,
//! and nothing is built before all of them are there. What is built goes to a temporary directory.

mod compare;
mod error;
mod inputs;
mod records;
mod stages;

use std::path::{Path, PathBuf};

use crate::error::FileError;
use crate::manifest::{
    DatasetManifest, Manifest, RsrpManifest, ScenesManifest, Software, TilesManifest, schema,
};
use crate::progress::Progress;
use crate::store::MANIFEST;
use crate::verify::VerifyFailure;

pub use error::RebuildError;

/// Where the recorded inputs lie.
#[derive(Debug, Clone, Copy, Default)]
pub struct GivenInputs<'a> {
    /// The extracts, in any order, under any names.
    pub osm: &'a [PathBuf],
    /// The directory of radio maps; it may hold more than those recorded.
    pub maps: Option<&'a Path>,
    /// Scenes, if the import was given some.
    pub scenes: Option<&'a Path>,
    /// Tiles, for what was made from tiles alone.
    pub tiles: Option<&'a Path>,
    /// The file of sites, for scenes that were placed by one.
    pub sites: Option<&'a Path>,
}

/// The result of building an output once more.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Rebuilding {
    /// Files that were compared.
    pub files: usize,
    /// What is not the same, a difference of versions first; empty if every file is.
    pub failures: Vec<VerifyFailure>,
    /// Of a dataset that is not the same: what that means for its records, in words.
    pub records: Option<String>,
}

/// Builds the tiles, scenes, maps or dataset in a directory once more and compares every file.
///
/// # Errors
/// [`RebuildError`] if a recorded input is not among those given, or building fails. That the
/// result differs is no error but listed.
pub fn rebuild(
    directory: &Path,
    given: GivenInputs<'_>,
    progress: &dyn Progress,
) -> Result<Rebuilding, RebuildError> {
    let scratch = tempfile::Builder::new().prefix("holescout-rebuild-").tempdir();
    let scratch = scratch.map_err(FileError::new("create", &std::env::temp_dir()))?;
    let mut bench =
        stages::Bench { directory, given, scratch: scratch.path(), progress, failures: Vec::new() };
    let schema = schema(directory);
    let rebuilt = match schema.as_deref() {
        Some(TilesManifest::SCHEMA) => bench.tiles()?,
        Some(ScenesManifest::SCHEMA) => bench.scenes()?,
        Some(RsrpManifest::SCHEMA) => bench.maps()?,
        None | Some(DatasetManifest::SCHEMA) => bench.dataset()?,
        Some(other) => return Err(RebuildError::NoStage { schema: other.to_owned() }),
    };
    let mut failures = bench.failures;
    let files = compare::compare(directory, &rebuilt, &mut failures, progress)?;
    let is_dataset = matches!(schema.as_deref(), None | Some(DatasetManifest::SCHEMA));
    let records = if is_dataset && !failures.is_empty() {
        Some(records::compare(directory, &rebuilt, progress)?)
    } else {
        None
    };
    Ok(Rebuilding { files, failures, records })
}

/// Says so if another version wrote an output: then its bytes may differ for that alone.
fn compare_software(recorded: &Software) -> Option<VerifyFailure> {
    let this = Software::this();
    (*recorded != this).then(|| VerifyFailure {
        file: MANIFEST.to_owned(),
        record: None,
        reason: format!(
            "written by {} {}, rebuilt by {} {}: only the same version is sure to give the same \
             bytes; rebuild with that one",
            recorded.name, recorded.version, this.name, this.version
        ),
    })
}
