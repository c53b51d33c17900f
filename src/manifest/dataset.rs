//! Manifest of a dataset (`dataset.v1`).

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{BuildingCounts, BuiltBySource, ImportInputs, Input, Manifest, MaskCounts, Software};
use crate::building::{Action, Defect};
use crate::config::{
    BuildingsConfig, FilterConfig, GridConfig, RsrpConfig, ShardConfig, Split, SplitConfig,
};
use crate::grid::TileId;
use crate::store::Digest;
use crate::units::Dbm;

/// The sections of the configuration that a dataset depends on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DatasetConfig {
    /// `[grid]`, as the tiles were rasterised with.
    pub grid: GridConfig,
    /// `[buildings]`, as the tiles were rasterised with.
    pub buildings: BuildingsConfig,
    /// `[filter]`, as the tiles were rasterised with.
    pub filter: FilterConfig,
    /// `[rsrp]`, as the maps were imported with.
    pub rsrp: RsrpConfig,
    /// `[shard]`.
    pub shard: ShardConfig,
    /// `[split]`.
    pub split: SplitConfig,
}

/// One shard file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ShardEntry {
    /// Path within the dataset.
    pub file: String,
    /// The split it belongs to.
    pub split: Split,
    /// Size and SHA-256.
    pub digest: Digest,
    /// Number of records, one a frame.
    pub records: u32,
}

/// Where a record is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct IndexEntry {
    /// The tile.
    pub id: TileId,
    /// Path of the shard within the dataset.
    pub shard: String,
    /// Index of the frame in the shard, from 0.
    pub frame: u32,
}

/// Counts of RSRP values of reached outdoor cells.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RsrpHistogram {
    /// Lower end of the first bin, in dBm; lower values are counted there too.
    pub first_dbm: i32,
    /// Width of a bin, in dB.
    pub step_db: i32,
    /// Values in each bin; higher ones than the last bin's are counted there too.
    pub counts: Vec<u64>,
}

/// Counts of decibels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ShiftHistogram {
    /// Width of a bin, in dB; the first begins at 0.
    pub step_db: f64,
    /// Cells in each bin; those beyond the last one are counted there too.
    pub counts: Vec<u64>,
}

/// How sure coverage holes are, of records whose levels have errors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Reliability {
    /// Records with errors.
    pub records: u64,
    /// Outdoor cells of these records.
    pub outdoor: u64,
    /// Of these, cells that lie below the threshold with a chance of at least 95 %.
    pub sure_holes: u64,
    /// Cells with a chance of more than 5 % and less than 95 %.
    pub unsure: u64,
    /// By how many dB the nearest threshold at which they would be sure differs, of the unsure cells.
    pub threshold_shift: ShiftHistogram,
}

/// Figures of a split.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SplitStatistics {
    /// Number of records.
    pub records: u64,
    /// Cells of all records by the mask's value.
    pub cells: MaskCounts,
    /// Coverage holes at [`SplitStatistics::hole_threshold_dbm`]: outdoor cells below it,
    /// unreached ones included.
    pub holes: u64,
    /// The threshold that `holes` was counted with.
    pub hole_threshold_dbm: Dbm,
    /// RSRP of reached outdoor cells.
    pub rsrp: RsrpHistogram,
    /// Built-up cells of the height grids (before downsampling) by source of height.
    pub built_cells: BuiltBySource,
    /// How sure the holes are at [`SplitStatistics::hole_threshold_dbm`]; absent where no record has
    /// errors.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reliability: Option<Reliability>,
}

/// What did not become a record, and why.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Dropped {
    /// Tiles without a radio map.
    pub tiles_without_map: u64,
    /// Rejected radio maps by reason.
    pub rejected_maps: BTreeMap<String, u64>,
    /// Records left out since they overlap a record of another split.
    pub overlapping_another_split: Vec<TileId>,
    /// Objects of OpenStreetMap skipped, repaired and left out, by reason.
    pub osm_objects: BTreeMap<Action, BTreeMap<Defect, u64>>,
}

/// What makes a dataset a release.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Release {
    /// Short name: letters, digits, `-`, `_` and `.`.
    #[schemars(regex(pattern = "^[A-Za-z0-9][A-Za-z0-9._-]*$"))]
    pub name: String,
    /// Version of the data (semver).
    pub version: String,
    /// Day of publication, `YYYY-MM-DD`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub date: Option<String>,
    /// Where it is published.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub url: Option<String>,
    /// Who made it.
    pub creators: Vec<String>,
    /// What they say of it, in Markdown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub notes: Option<String>,
    /// The program that wrote the release; [`DatasetManifest::software`] wrote the records.
    pub software: Software,
    /// SHA-256 of the manifest of the dataset that was released.
    pub dataset_manifest_sha256: String,
}

/// `DATASET/manifest.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DatasetManifest {
    /// Always `dataset.v1`.
    #[schemars(extend("const" = "dataset.v1"))]
    pub schema: String,
    /// SHA-256 over all that the output depends on.
    pub fingerprint: String,
    /// The program that wrote it.
    pub software: Software,
    /// What a release has beyond a dataset.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub release: Option<Release>,
    /// Licence of the output, as an SPDX identifier.
    pub licence: String,
    /// Attribution that must stay with the output.
    pub attribution: String,
    /// EPSG code of the projection.
    pub epsg: u32,
    /// Polygons that were asked for, as GeoJSON coordinates in degrees; absent for the whole extract.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub area: Option<Vec<Vec<Vec<[f64; 2]>>>>,
    /// Cells along a side of every record.
    pub cells: u32,
    /// Side of a cell, in metres.
    pub cell_m: f64,
    /// The configuration used.
    pub config: DatasetConfig,
    /// The extracts that the buildings come from.
    pub inputs: Vec<Input>,
    /// SHA-256 of the manifest of the tiles.
    pub tiles_manifest_sha256: String,
    /// SHA-256 of the manifest of the radio maps.
    pub rsrp_manifest_sha256: String,
    /// What the radio maps were imported from.
    pub import: ImportInputs,
    /// Buildings of the extracts.
    pub buildings: BuildingCounts,
    /// Figures of every split that has records.
    pub statistics: BTreeMap<Split, SplitStatistics>,
    /// What did not become a record.
    pub dropped: Dropped,
    /// Pairs of records of different splits whose whole tiles overlap, though their windows
    /// do not. `split.strict` drops them.
    pub overlapping_tile_pairs: u64,
    /// The shards, in the order of their names.
    pub shards: Vec<ShardEntry>,
    /// Every record, by name.
    pub records: Vec<IndexEntry>,
}

impl Manifest for DatasetManifest {
    const SCHEMA: &'static str = "dataset.v1";
    const COMMAND: &'static str = "shard";
}
