//! The list of an output's files and their checksums.

use std::path::{Component, Path};

/// Name of a stage's manifest.
pub const MANIFEST: &str = "manifest.json";
/// Name of the list of checksums, in the format of `sha256sum`.
pub const SUMS: &str = "SHA256SUMS";

/// The lines of a `SHA256SUMS` file as (digest, name).
///
/// # Errors
/// The first line that is malformed or names something outside of the directory.
pub fn parse_sums(text: &str) -> Result<Vec<(&str, &str)>, &str> {
    let sound = |&(digest, name): &(&str, &str)| digest.len() == 64 && stays_inside(name);
    text.lines().map(|line| line.split_once("  ").filter(sound).ok_or(line)).collect()
}

/// A list of files comes from a disk: it must not lead out of its directory.
#[must_use]
pub fn stays_inside(name: &str) -> bool {
    let inside = |part| matches!(part, Component::Normal(_));
    !name.is_empty() && Path::new(name).components().all(inside)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_a_list_are_those_of_files_inside() {
        assert!(["a", "a/b.bin"].into_iter().all(stays_inside));
        assert!(!["", ".", "..", "../a", "a/../..", "/a"].into_iter().any(stays_inside));
    }
}
