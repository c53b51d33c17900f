//! What a stage gives back: a whole output, or a task's part of one.

use std::path::Path;

use serde::de::DeserializeOwned;

use crate::progress::Progress;
use crate::store::{BuildMode, MANIFEST, OutputDir, OutputError, Part, TaskReport};

/// What a run of a stage built.
#[derive(Debug, Clone, PartialEq)]
pub enum Built<M> {
    /// The output, which now has this manifest.
    Whole(M),
    /// A task's part.
    Part(TaskReport),
    /// Nothing: a task found that the output is whole already.
    Already,
}

impl<M> Built<M> {
    /// The manifest, unless this is a task's part.
    #[must_use]
    pub fn whole(self) -> Option<M> {
        match self {
            Self::Whole(manifest) => Some(manifest),
            Self::Part(_) | Self::Already => None,
        }
    }
}

/// What a stage asks before it reads large inputs: whether its work is done already, as a task or
/// a merge that is run once more finds, else whether the directory can take it.
///
/// # Errors
/// [`OutputError`] if the directory holds something else, or a damaged output.
pub fn already_built<M: DeserializeOwned>(
    out: &Path,
    stage: &str,
    fingerprint: &str,
    mode: BuildMode,
    progress: &dyn Progress,
) -> Result<Option<Built<M>>, OutputError> {
    let Some(manifest) = OutputDir::whole(out, stage, fingerprint, mode, progress)? else {
        OutputDir::check(out, stage, fingerprint, mode)?;
        return Ok(None);
    };
    if let Part::Task(_) = mode.part {
        return Ok(Some(Built::Already));
    }
    let damaged = |_| OutputError::Damaged { path: out.to_owned(), file: MANIFEST.to_owned() };
    serde_json::from_slice(&manifest).map(|manifest| Some(Built::Whole(manifest))).map_err(damaged)
}
