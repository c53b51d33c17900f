//! `SHA256SUMS`, which every output has.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::failure::{VerifyFailure, failure};
use crate::progress::Progress;
use crate::store::{MANIFEST, SUMS, parse_sums, sha256_file};

/// Every listed file has its checksum, and every file is listed.
pub(super) fn check(
    root: &Path,
    failures: &mut Vec<VerifyFailure>,
    progress: &dyn Progress,
) -> usize {
    let text = std::fs::read_to_string(root.join(SUMS)).unwrap_or_default();
    let sums = match parse_sums(&text) {
        Ok(sums) if !sums.is_empty() => sums,
        Ok(_) => {
            failures.push(failure(SUMS, "missing or empty"));
            return 0;
        }
        Err(line) => {
            let reason = format!("no checksum of a file of this directory: {line:?}");
            failures.push(failure(SUMS, reason));
            return 0;
        }
    };
    progress.begin("comparing checksums", Some(sums.len() as u64));
    let wrong: Vec<VerifyFailure> = sums
        .par_iter()
        .filter_map(|(expected, file)| {
            let found = sha256_file(&root.join(file));
            progress.advance(1);
            match found {
                Ok(digest) if digest.sha256 == *expected => None,
                Ok(digest) => {
                    let found = digest.sha256;
                    Some(failure(file, format!("SHA-256 is {found}, expected {expected}")))
                }
                Err(error) => Some(failure(file, error.source.to_string())),
            }
        })
        .collect();
    progress.end();
    failures.extend(wrong);
    let listed: BTreeSet<PathBuf> = sums.iter().map(|(_, file)| PathBuf::from(file)).collect();
    if !listed.contains(Path::new(MANIFEST)) {
        failures.push(failure(SUMS, format!("does not list {MANIFEST}")));
    }
    for file in files_below(root) {
        let relative = file.strip_prefix(root).unwrap_or(&file);
        if relative != Path::new(SUMS) && !listed.contains(relative) {
            let name = relative.to_string_lossy();
            failures.push(failure(&name, format!("not listed in {SUMS}: not part of this output")));
        }
    }
    sums.len()
}

fn files_below(directory: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(directory).into_iter().flatten().flatten();
    entries
        .flat_map(|entry| {
            let path = entry.path();
            if path.is_dir() { files_below(&path) } else { vec![path] }
        })
        .collect()
}
