//! `holescout verify`: is every byte what it should be, and does it make sense?
//!
//! Works on the output of every stage. Checksums are the same everywhere; what a manifest tells of
//! is read and compared with it by one check for each type of manifest: `tiles`, `scenes`,
//! `rsrp`, `dataset`, `export`, `policy`, `evaluation`, `run`.

mod dataset;
mod evaluation;
mod export;
mod failure;
mod items;
mod policy;
mod rsrp;
mod run;
mod scenes;
mod sums;
mod tiles;

use std::path::Path;

use crate::manifest::{
    DatasetManifest, EvaluationManifest, ExportManifest, Manifest, ManifestError, PolicyManifest,
    RsrpManifest, RunManifest, ScenesManifest, TilesManifest, load, schema,
};
use crate::progress::Progress;

pub use failure::VerifyFailure;

/// The result of verifying a directory.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Verification {
    /// The manifest's schema: what kind of output this is.
    pub schema: String,
    /// Files whose checksums were compared.
    pub files: usize,
    /// Tiles, scenes, maps, records, checkpoints, tables or tensors that were read.
    pub items: usize,
    /// All that is wrong; empty if the directory is sound.
    pub failures: Vec<VerifyFailure>,
}

/// Verifies the output of any stage.
///
/// # Errors
/// [`ManifestError`] if there is no manifest that could be verified, for instance after an
/// interrupted run. Everything else that is wrong is listed in the result.
pub fn verify(root: &Path, progress: &dyn Progress) -> Result<Verification, ManifestError> {
    let found = schema(root);
    let mut failures = Vec::new();
    if found.is_none() && root.join(RunManifest::FILE).exists() {
        let (files, items) = run::check(root, progress, &mut failures)?;
        let schema = RunManifest::SCHEMA.to_owned();
        return Ok(Verification { schema, files, items, failures: sorted(failures) });
    }
    let files = sums::check(root, &mut failures, progress);
    let items = match found.as_deref() {
        Some(TilesManifest::SCHEMA) => tiles::check(root, &load(root)?.0, progress, &mut failures),
        Some(ScenesManifest::SCHEMA) => {
            scenes::check(root, &load(root)?.0, progress, &mut failures)
        }
        Some(RsrpManifest::SCHEMA) => rsrp::check(root, &load(root)?.0, progress, &mut failures),
        Some(ExportManifest::SCHEMA) => export::check(root, &load(root)?.0, &mut failures),
        Some(PolicyManifest::SCHEMA) => policy::check(root, &load(root)?.0, &mut failures),
        Some(EvaluationManifest::SCHEMA) => evaluation::check(root, &load(root)?.0, &mut failures),
        _ => {
            let (manifest, _) = load::<DatasetManifest>(root)?;
            dataset::check(root, &manifest, progress, &mut failures)
        }
    };
    let schema = found.unwrap_or_default();
    Ok(Verification { schema, files, items, failures: sorted(failures) })
}

fn sorted(mut failures: Vec<VerifyFailure>) -> Vec<VerifyFailure> {
    failures.sort();
    failures.dedup();
    failures
}
