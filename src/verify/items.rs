//! The items of an output, each a file or a few.

use rayon::prelude::*;

use super::failure::{VerifyFailure, failure};
use crate::progress::Progress;

/// Reads all items and lists what `check` finds wrong, by the file that it names. Returns their number.
pub(super) fn check_items<'a, T: Sync>(
    entries: &'a [T],
    progress: &dyn Progress,
    failures: &mut Vec<VerifyFailure>,
    check: impl Fn(&'a T) -> (&'a str, Result<(), String>) + Sync,
) -> usize {
    progress.begin("reading items", Some(entries.len() as u64));
    let wrong: Vec<VerifyFailure> = entries
        .par_iter()
        .filter_map(|entry| {
            let (file, result) = check(entry);
            progress.advance(1);
            result.err().map(|reason| failure(file, reason))
        })
        .collect();
    progress.end();
    failures.extend(wrong);
    entries.len()
}
