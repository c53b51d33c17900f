//! `holescout diff`: what changed between two datasets, and which step of a version that is.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use semver::Version;
use serde::Serialize;
use serde_json::{Value, json};

use super::changes::{Change, ChangedRecord, FileChanges, MovedRecord, RecordChanges};
use super::charts::FOLDER;
use super::compare::{PROVENANCE, changed_fields, changed_files, changed_keys, changes};
use super::version::{VersionStep, is_enough, least};
use crate::config::Split;
use crate::dataset::{Dataset, ReadError};
use crate::error::{Fault, FileError, HasFault};
use crate::grid::TileId;
use crate::manifest::{DatasetManifest, IndexEntry};
use crate::progress::Progress;
use crate::store::{SUMS, parse_sums};

/// Why two datasets cannot be compared.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DiffError {
    /// A dataset cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A file cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// The list of checksums is damaged.
    #[error("{}: no checksum of a file of this directory: {line:?}", path.display())]
    Sums {
        /// The list.
        path: PathBuf,
        /// The first line that is none.
        line: String,
    },
}

impl HasFault for DiffError {
    fn fault(&self) -> Fault {
        match self {
            Self::Read(error) => error.fault(),
            Self::File(error) => error.fault(),
            Self::Sums { .. } => Fault::Input,
        }
    }
}

/// One of the two.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Side {
    /// Version of a release.
    pub version: Option<String>,
    /// SHA-256 of the manifest.
    pub manifest_sha256: String,
    /// Number of records.
    pub records: usize,
}

/// Why a version must go as far as it must.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Reason {
    /// The step that this alone asks for.
    pub step: VersionStep,
    /// What changed.
    pub text: String,
}

/// All that changed.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Diff {
    /// The first one.
    pub a: Side,
    /// The second one.
    pub b: Side,
    /// Records.
    pub records: RecordChanges,
    /// Keys of the configuration.
    pub config: Vec<Change>,
    /// Extracts by file name, with their SHA-256.
    pub inputs: Vec<Change>,
    /// Schemas, projection, cells, licence, software.
    pub facts: Vec<Change>,
    /// Files.
    pub files: FileChanges,
    /// The step that a version must go.
    pub step: VersionStep,
    /// What asks for it, the furthest step first.
    pub reasons: Vec<Reason>,
}

impl Diff {
    /// The least version of the second one, if the first one is a release.
    #[must_use]
    pub fn least_version(&self) -> Option<Version> {
        Some(least(&self.a.version.as_ref()?.parse().ok()?, self.step))
    }

    /// Whether the second one's version goes far enough; `None` unless both are releases.
    #[must_use]
    pub fn is_enough(&self) -> Option<bool> {
        let parse = |side: &Side| side.version.as_ref()?.parse::<Version>().ok();
        Some(is_enough(&parse(&self.a)?, &parse(&self.b)?, self.step))
    }
}

/// Compares two datasets, `a` being the earlier one. Records are compared by what they hold, not
/// by how they are compressed or where they lie.
///
/// # Errors
/// [`DiffError`] when one cannot be read.
pub fn diff(a: &Dataset, b: &Dataset, progress: &dyn Progress) -> Result<Diff, DiffError> {
    compare(a, b, &sums(b.root())?, progress)
}

/// As [`diff`]; what files `b` has, by name and SHA-256, is given.
pub(super) fn compare(
    a: &Dataset,
    b: &Dataset,
    files_of_b: &BTreeMap<String, String>,
    progress: &dyn Progress,
) -> Result<Diff, DiffError> {
    let records = compare_records(a, b, progress)?;
    let (old, new) = (a.manifest(), b.manifest());
    let files = changed_files(&sums(a.root())?, files_of_b);
    let mut diff = Diff {
        a: side(a),
        b: side(b),
        records,
        config: changed_keys(&old.config, &new.config),
        inputs: changes(inputs(old), inputs(new)),
        facts: changes(facts(old), facts(new)),
        files,
        step: VersionStep::None,
        reasons: Vec::new(),
    };
    diff.reasons = reasons(&diff);
    diff.step = diff.reasons.iter().map(|reason| reason.step).max().unwrap_or(VersionStep::None);
    Ok(diff)
}

fn side(dataset: &Dataset) -> Side {
    let manifest = dataset.manifest();
    Side {
        version: manifest.release.as_ref().map(|release| release.version.clone()),
        manifest_sha256: dataset.digest().sha256.clone(),
        records: manifest.records.len(),
    }
}

/// The files of a directory by name, with their SHA-256, as its list has them.
pub(super) fn sums(root: &Path) -> Result<BTreeMap<String, String>, DiffError> {
    let path = root.join(SUMS);
    let text = std::fs::read_to_string(&path).map_err(FileError::new("read", &path))?;
    let lines =
        parse_sums(&text).map_err(|line| DiffError::Sums { path, line: line.to_owned() })?;
    Ok(lines.into_iter().map(|(digest, name)| (name.to_owned(), digest.to_owned())).collect())
}

fn inputs(manifest: &DatasetManifest) -> BTreeMap<String, Value> {
    let inputs = manifest.inputs.iter();
    inputs.map(|input| (input.file.clone(), json!(input.digest.sha256))).collect()
}

fn facts(manifest: &DatasetManifest) -> BTreeMap<String, Value> {
    let DatasetManifest {
        schema, software, licence, attribution, epsg, cells, cell_m, area, ..
    } = manifest;
    let facts = [
        ("schema", json!(schema)),
        ("software", json!(format!("{} {}", software.name, software.version))),
        ("licence", json!(licence)),
        ("attribution", json!(attribution)),
        ("epsg", json!(epsg)),
        ("cells", json!(cells)),
        ("cell_m", json!(cell_m)),
        ("area", json!(area)),
    ];
    let there = facts.into_iter().filter(|(_, value)| !value.is_null());
    there.map(|(key, value)| (key.to_owned(), value)).collect()
}

/// Where every record is: its split, the digest of its shard, its frame.
fn places(dataset: &Dataset) -> BTreeMap<TileId, (Split, &str, u32)> {
    let manifest = dataset.manifest();
    let shards: BTreeMap<&str, &str> = manifest
        .shards
        .iter()
        .map(|shard| (shard.file.as_str(), shard.digest.sha256.as_str()))
        .collect();
    let entries: BTreeMap<TileId, &IndexEntry> =
        manifest.records.iter().map(|entry| (entry.id, entry)).collect();
    let place = |(id, split)| {
        let entry: &IndexEntry = entries.get(&id)?;
        Some((id, (split, *shards.get(entry.shard.as_str())?, entry.frame)))
    };
    dataset.ids().into_iter().filter_map(place).collect()
}

fn compare_records(
    a: &Dataset,
    b: &Dataset,
    progress: &dyn Progress,
) -> Result<RecordChanges, ReadError> {
    let (old, new) = (places(a), places(b));
    let both: Vec<TileId> = old.keys().filter(|id| new.contains_key(id)).copied().collect();
    progress.begin("comparing records", Some(both.len() as u64));
    let compared = both.par_iter().map(|id| {
        let (_, shard, frame) = old[id];
        let (_, other_shard, other_frame) = new[id];
        // The same frame of the same bytes needs no look.
        let fields = if (shard, frame) == (other_shard, other_frame) {
            Vec::new()
        } else {
            changed_fields(&a.record(*id)?, &b.record(*id)?)
        };
        progress.advance(1);
        Ok(ChangedRecord { id: *id, fields })
    });
    let compared = compared.collect::<Result<Vec<_>, ReadError>>()?;
    progress.end();
    let moved = both.iter().filter_map(|id| {
        let (from, to) = (old[id].0, new[id].0);
        (from != to).then_some(MovedRecord { id: *id, from, to })
    });
    Ok(RecordChanges {
        added: new.keys().filter(|id| !old.contains_key(id)).copied().collect(),
        removed: old.keys().filter(|id| !new.contains_key(id)).copied().collect(),
        moved: moved.collect(),
        changed: compared.into_iter().filter(|record| !record.fields.is_empty()).collect(),
    })
}

fn reasons(diff: &Diff) -> Vec<Reason> {
    let Diff { records, facts, files, .. } = diff;
    let mut reasons = Vec::new();
    let mut reason = |step: VersionStep, count: usize, text: &str| {
        if count > 0 {
            reasons.push(Reason { step, text: format!("{count} {text}") });
        }
    };
    let is_data = |record: &&ChangedRecord| record.fields != [PROVENANCE];
    let data = records.changed.iter().filter(is_data).count();
    reason(VersionStep::Major, records.removed.len(), "records are gone");
    reason(VersionStep::Major, records.moved.len(), "records are in another split");
    reason(VersionStep::Major, data, "records have other values");
    reason(VersionStep::Minor, records.added.len(), "records are new");
    reason(
        VersionStep::Patch,
        records.changed.len() - data,
        "records have another provenance only",
    );
    let breaking = ["schema", "licence", "epsg", "cells", "cell_m"];
    let broken = facts.iter().filter(|change| breaking.contains(&change.key.as_str())).count();
    reason(VersionStep::Major, broken, "of schema, licence, projection and cells differ");
    let essential = |files: &[String]| files.iter().filter(|name| !is_text_or_shard(name)).count();
    reason(VersionStep::Major, essential(&files.removed), "files are gone");
    reason(VersionStep::Minor, essential(&files.added), "files are new");
    let others = files.added.len() + files.removed.len() + files.changed.len();
    reason(VersionStep::Patch, others, "files differ");
    reasons.sort_by_key(|reason| std::cmp::Reverse(reason.step));
    reasons
}

/// Shards may be packed anew, and the card may show other pictures: no reader asks for them by name.
fn is_text_or_shard(name: &str) -> bool {
    let folder = name.split('/').next().unwrap_or_default();
    folder == FOLDER || Split::ALL.iter().any(|split| split.name() == folder)
}
