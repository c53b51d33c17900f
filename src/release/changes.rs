//! What may differ between two datasets.

use serde::Serialize;
use serde_json::Value;

use crate::config::Split;
use crate::grid::TileId;

/// A value that differs; what is absent is `None`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change {
    /// Its name.
    pub key: String,
    /// In the first one.
    pub old: Option<Value>,
    /// In the second one.
    pub new: Option<Value>,
}

/// A record that is in both with other values.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ChangedRecord {
    /// The record.
    pub id: TileId,
    /// The fields that differ.
    pub fields: Vec<&'static str>,
}

/// A record that is in another split.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct MovedRecord {
    /// The record.
    pub id: TileId,
    /// Its split in the first one.
    pub from: Split,
    /// Its split in the second one.
    pub to: Split,
}

/// What happened to records.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct RecordChanges {
    /// Only in the second one.
    pub added: Vec<TileId>,
    /// Only in the first one.
    pub removed: Vec<TileId>,
    /// In another split.
    pub moved: Vec<MovedRecord>,
    /// With other values; the split is told apart.
    pub changed: Vec<ChangedRecord>,
}

/// What happened to files, by `SHA256SUMS`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct FileChanges {
    /// Only in the second one.
    pub added: Vec<String>,
    /// Only in the first one.
    pub removed: Vec<String>,
    /// With other bytes.
    pub changed: Vec<String>,
}
