//! Evaluations: manifest, report and tables tell the same.

use std::path::Path;

use super::failure::{VerifyFailure, failure};
use crate::evaluate::{Report, derived_tables};
use crate::manifest::EvaluationManifest;

const REPORT: &str = "report.json";

/// Lists what is wrong, and returns the number of files that were compared.
pub(super) fn check(
    root: &Path,
    manifest: &EvaluationManifest,
    failures: &mut Vec<VerifyFailure>,
) -> usize {
    let read = std::fs::read(root.join(REPORT)).map_err(|error| error.to_string());
    let report = read.and_then(|bytes| {
        serde_json::from_slice::<Report>(&bytes).map_err(|error| error.to_string())
    });
    let report = match report {
        Ok(report) => report,
        Err(reason) => {
            failures.push(failure(REPORT, reason));
            return 0;
        }
    };
    let same = [
        ("fingerprint", report.fingerprint == manifest.fingerprint),
        ("software", report.software == manifest.software),
        ("dataset", report.dataset.sha256 == manifest.dataset.sha256),
        ("policy_sha256", report.policy_sha256 == manifest.policy_sha256),
        ("split", report.split == manifest.split),
        ("rl", report.rl == manifest.rl),
        ("evaluate", report.evaluate == manifest.evaluate),
    ];
    for (field, _) in same.into_iter().filter(|(_, same)| !same) {
        failures.push(failure(REPORT, format!("{field} differs from the manifest's")));
    }
    let tables = derived_tables(&report);
    for (name, expected) in &tables {
        if std::fs::read(root.join(name)).ok().as_ref() != Some(expected) {
            failures.push(failure(name, format!("its figures are not those of {REPORT}")));
        }
    }
    1 + tables.len()
}
