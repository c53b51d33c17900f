//! Two directories, file by file.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use rayon::prelude::*;
use serde_json::{Map, Value};

use crate::error::FileError;
use crate::progress::Progress;
use crate::store::{Digest, MANIFEST, sha256_file};
use crate::verify::VerifyFailure;

/// Adds what is not the same to the failures; returns how many files were compared.
pub(super) fn compare(
    directory: &Path,
    rebuilt: &Path,
    failures: &mut Vec<VerifyFailure>,
    progress: &dyn Progress,
) -> Result<usize, FileError> {
    progress.begin("comparing with what was rebuilt", None);
    let (here, again) = (digests(directory)?, digests(rebuilt)?);
    progress.end();
    let names: BTreeSet<&String> = here.keys().chain(again.keys()).collect();
    for name in &names {
        let reason = match (here.get(*name), again.get(*name)) {
            (Some(here), Some(again)) if here == again => continue,
            (Some(here), Some(again)) => {
                let fields = if *name == MANIFEST {
                    differing_fields(directory, rebuilt)
                } else {
                    String::new()
                };
                format!("is {here}, but rebuilt {again}{fields}")
            }
            (Some(_), None) => "is not among what was rebuilt".to_owned(),
            (None, _) => "was rebuilt, but is missing here".to_owned(),
        };
        failures.push(VerifyFailure { file: (*name).clone(), record: None, reason });
    }
    Ok(names.len())
}

/// Size and SHA-256 of every file below a directory.
fn digests(root: &Path) -> Result<BTreeMap<String, Digest>, FileError> {
    let mut names = Vec::new();
    let mut pending = vec![root.to_owned()];
    while let Some(directory) = pending.pop() {
        let entries = std::fs::read_dir(&directory).map_err(FileError::new("list", &directory))?;
        for path in entries.flatten().map(|entry| entry.path()) {
            if path.is_dir() && !path.is_symlink() {
                pending.push(path);
            } else {
                let name = path.strip_prefix(root).unwrap_or(&path);
                names.push(name.to_string_lossy().into_owned());
            }
        }
    }
    names
        .into_par_iter()
        .map(|name| {
            let digest = sha256_file(&root.join(&name))?;
            Ok((name, digest))
        })
        .collect()
}

/// The fields in which two manifests differ, as a remark.
fn differing_fields(directory: &Path, rebuilt: &Path) -> String {
    let fields = |root: &Path| -> Map<String, Value> {
        let text = std::fs::read(root.join(MANIFEST)).unwrap_or_default();
        serde_json::from_slice(&text).unwrap_or_default()
    };
    let (here, again) = (fields(directory), fields(rebuilt));
    let names: BTreeSet<&String> = here.keys().chain(again.keys()).collect();
    let differing = names.into_iter().filter(|name| here.get(*name) != again.get(*name));
    let differing: Vec<&str> = differing.map(String::as_str).collect();
    if differing.is_empty() {
        String::new()
    } else {
        format!("; it differs in {}", differing.join(", "))
    }
}
