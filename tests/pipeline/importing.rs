//! One import of a directory with a good map, and what it says of the bad ones.

use std::path::PathBuf;
use std::process::Command;

use serde::Deserialize;
use serde_json::Value;
use tempfile::TempDir;

use super::maps::{SITE, write_good};
use super::{import, read, read_json, run, temporary_dir};

/// A line of `rejected.csv`.
#[derive(Debug, Clone, Deserialize, PartialEq, Eq)]
pub(crate) struct Rejected {
    pub(crate) file: String,
    pub(crate) location: String,
    pub(crate) code: String,
    pub(crate) expected: String,
    pub(crate) found: String,
    pub(crate) mend: String,
}

/// The tile whose map is always good.
pub(crate) fn good_tile() -> &'static str {
    &SITE.ids[SITE.ids.len() - 1]
}

/// A directory of maps beside the place that they are imported to.
pub(crate) struct Import {
    pub(crate) dir: TempDir,
}

impl Import {
    /// Begins with one good map, of the last tile.
    pub(crate) fn new() -> Self {
        let import = Self { dir: temporary_dir() };
        write_good(&import.map("good.npz"), good_tile());
        import
    }

    pub(crate) fn maps(&self) -> PathBuf {
        self.dir.path().join("maps")
    }

    pub(crate) fn map(&self, file: &str) -> PathBuf {
        self.maps().join(file)
    }

    pub(crate) fn out(&self) -> PathBuf {
        self.dir.path().join("rsrp")
    }

    pub(crate) fn command(&self) -> Command {
        import(&self.maps(), &SITE.tiles, &self.out())
    }

    /// Imports with the smallest limit on arrays; demands that the good map came through.
    pub(crate) fn rejected(&self) -> Vec<Rejected> {
        run(self.command().args(["--max-array", "1"])).succeeds();
        self.listed()
    }

    /// Reads the result of an import.
    pub(crate) fn listed(&self) -> Vec<Rejected> {
        let manifest = read_json(&self.out().join("manifest.json"));
        let maps = manifest["maps"].as_array().expect("a list");
        let is_good = |map: &Value| map["source"]["file"] == "good.npz";
        assert!(maps.iter().any(is_good), "the good map was imported");
        let text = read(&self.out().join("rejected.csv"));
        let rejected: Vec<Rejected> = csv::Reader::from_reader(&text[..])
            .deserialize()
            .collect::<Result<_, _>>()
            .expect("a table");
        for line in &rejected {
            let texts = [&line.expected, &line.found, &line.mend];
            assert!(texts.iter().all(|text| !text.is_empty()), "{line:?}");
        }
        let counts: u64 = manifest["rejected"]
            .as_object()
            .expect("counts by code")
            .values()
            .map(|count| count.as_u64().expect("a count"))
            .sum();
        assert_eq!(counts, rejected.len() as u64, "the manifest counts the same");
        rejected
    }

    /// Demands that only `bad.*` was rejected; returns why.
    pub(crate) fn only_rejection(&self) -> Rejected {
        let rejected = self.rejected();
        assert_eq!(rejected.len(), 1, "one line: {rejected:?}");
        assert!(rejected[0].file.starts_with("bad."), "{rejected:?}");
        rejected[0].clone()
    }
}
