//! `manifest.json` of an export: which columns its files have, and what they were made from.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Manifest, Software};
use crate::config::Split;
use crate::store::Digest;

/// A column of an export's files.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ExportColumn {
    /// Its name.
    pub name: String,
    /// Type of a value, in NumPy's words; `str` for text.
    pub dtype: String,
    /// Shape of a value, in C order; empty if it is a single one.
    pub shape: Vec<u32>,
    /// Unit, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// What it means.
    pub meaning: String,
    /// Whether some records have no value.
    pub nullable: bool,
}

/// A file of an export.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ExportFile {
    /// Path within the export.
    pub file: String,
    /// The split whose records it holds.
    pub split: Split,
    /// Size and SHA-256.
    pub digest: Digest,
    /// Number of records, one a row.
    pub records: u32,
}

/// The manifest that `holescout export` writes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ExportManifest {
    /// Always `export.v1`.
    #[schemars(extend("const" = "export.v1"))]
    pub schema: String,
    /// SHA-256 over everything that the output depends on.
    pub fingerprint: String,
    /// The program that wrote it.
    pub software: Software,
    /// The dataset's manifest.
    pub dataset: Digest,
    /// Licence, as an SPDX identifier.
    pub licence: String,
    /// The attribution that the licence asks for.
    pub attribution: String,
    /// Columns, the same in all files.
    pub columns: Vec<ExportColumn>,
    /// The files.
    pub files: Vec<ExportFile>,
}

impl Manifest for ExportManifest {
    const SCHEMA: &'static str = "export.v1";
    const COMMAND: &'static str = "export";
}
