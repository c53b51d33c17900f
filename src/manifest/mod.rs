//! What every stage writes about its output, as serde types; `schemas/` is made from them.
//!
//! A manifest names its inputs by content, never by path, and holds no time of day, so
//! that the same inputs give the same manifest anywhere.

mod common;
mod dataset;
mod evaluation;
mod export;
#[cfg(feature = "build")]
mod files;
mod mask;
mod policy;
mod rsrp;
mod run;
mod scenes;
mod tiles;

pub(crate) use common::json_schema_with;
pub use common::{
    Input, Manifest, ManifestError, Software, fingerprint, json_schema, load, parse, schema,
    to_json,
};
pub use dataset::{
    DatasetConfig, DatasetManifest, Dropped, IndexEntry, Release, Reliability, RsrpHistogram,
    ShardEntry, ShiftHistogram, SplitStatistics,
};
pub use evaluation::EvaluationManifest;
pub use export::{ExportColumn, ExportFile, ExportManifest};
#[cfg(feature = "build")]
pub use files::{
    RsrpFile, StageFileError, TileFile, dropped_tiles, read_scene_file, read_scene_meta,
};
pub use mask::{ErrorGrids, MASK_BUILDING, MASK_REACHED, MASK_UNREACHED};
pub use policy::PolicyManifest;
pub use rsrp::{
    BaseStation, Evidence, ImportInputs, MapEntry, MapFile, MapQuality, MapReliability, MapWarning,
    MaskCounts, OrientationScore, Radio, RsrpManifest, RsrpMeta, Solver, SolverCount, SourceMap,
    ValueKind, WarningCode,
};
pub use run::RunManifest;
pub use scenes::{
    LeftOutSolids, SceneEntry, SceneFile, SceneMaterials, SceneMeta, SceneStation, ScenesConfig,
    ScenesManifest, SitesInput,
};
pub use tiles::{
    BuildingCounts, BuiltBySource, TileEntry, TileMeta, TileStatistics, TilesConfig, TilesManifest,
    Verdict,
};
