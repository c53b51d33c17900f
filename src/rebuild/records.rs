//! What two datasets hold, where their bytes differ: whether it is the records or only what is said of them.

use std::collections::BTreeMap;
use std::path::Path;

use crate::dataset::Dataset;
use crate::progress::Progress;
use crate::release::{Diff, DiffError, diff};

/// In words, what the records of a dataset and of its rebuilding have in common.
pub(super) fn compare(
    directory: &Path,
    rebuilt: &Path,
    progress: &dyn Progress,
) -> Result<String, DiffError> {
    let (here, again) = (Dataset::open(directory)?, Dataset::open(rebuilt)?);
    Ok(in_words(&diff(&here, &again, progress)?))
}

fn in_words(diff: &Diff) -> String {
    let records = &diff.records;
    let both = diff.a.records - records.removed.len();
    let mut fields: BTreeMap<&str, usize> = BTreeMap::new();
    for field in records.changed.iter().flat_map(|record| &record.fields) {
        *fields.entry(field).or_default() += 1;
    }
    let fields: Vec<String> =
        fields.iter().map(|(field, count)| format!("{field} in {count}")).collect();
    let mut parts = Vec::new();
    let mut part = |count: usize, text: &str| {
        if count > 0 {
            parts.push(format!("{count} {text}"));
        }
    };
    part(records.changed.len(), &format!("differ ({})", fields.join(", ")));
    part(records.moved.len(), "are in another split");
    part(records.removed.len(), "were not rebuilt");
    part(records.added.len(), "are missing here");
    let keys: Vec<&str> = diff.config.iter().map(|change| change.key.as_str()).collect();
    let of_config = if keys.is_empty() {
        String::new()
    } else {
        format!("; the configuration differs in {}", keys.join(", "))
    };
    if parts.is_empty() {
        return format!(
            "all {both} records are the same in every value: what differs is how they are packed, or what is said \
             of them{of_config}"
        );
    }
    format!("of {both} records that are in both, {}{of_config}", parts.join(", "))
}
