//! Manifest of rasterised tiles (`tiles.v2`) and the metadata inside each (`tile.v1`).

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Input, Manifest, Software};
use crate::building::{Action, Defect};
use crate::config::{BuildingsConfig, FilterConfig, GridConfig};
use crate::grid::TileId;
use crate::store::Digest;

/// Whether a candidate tile is kept.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Verdict {
    /// Urban enough.
    Kept,
    /// Fewer buildings in the tile than `filter.min_buildings`.
    FewBuildings,
    /// A smaller share built up than `filter.min_built`.
    LowBuilt,
}

impl Verdict {
    /// The name used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Kept => "kept",
            Self::FewBuildings => "few_buildings",
            Self::LowBuilt => "low_built",
        }
    }
}

/// Built-up cells of the central window by how well their height is known.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BuiltBySource {
    /// From a `height` tag.
    pub height: u64,
    /// From `building:levels`.
    pub levels: u64,
    /// Guessed by type of building.
    pub default: u64,
}

impl BuiltBySource {
    /// All built-up cells.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.height + self.levels + self.default
    }
}

/// Figures of one tile.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TileStatistics {
    /// Buildings (not parts, not raised ones) with at least one cell in the tile.
    pub buildings: u32,
    /// Share of the central window's cells that are built up, 0 to 1.
    pub built: f64,
    /// Highest cell of the tile, in metres.
    pub max_height_m: f32,
    /// Built-up cells of the central window by source of their height.
    pub built_cells: BuiltBySource,
}

/// A tile that was written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TileEntry {
    /// Its name.
    pub id: TileId,
    /// File name within the directory.
    pub file: String,
    /// Size and SHA-256 of the file.
    pub digest: Digest,
    /// Its figures.
    pub statistics: TileStatistics,
}

/// Buildings by kind and by source of height.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BuildingCounts {
    /// Objects with building tags in the extracts: those that follow, and a row of `problems.csv`
    /// with the action `skipped` or `left_out` for each of the others.
    pub tagged: u64,
    /// Whole buildings on the ground.
    pub outlines: u64,
    /// Building parts on the ground.
    pub parts: u64,
    /// Buildings and parts that begin above the flight height.
    pub raised: u64,
    /// Of outlines, parts and raised ones, with a `height` tag.
    pub from_height: u64,
    /// Of these, with `building:levels`.
    pub from_levels: u64,
    /// Of these, guessed.
    pub from_default: u64,
}

/// The sections of the configuration that tiles depend on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TilesConfig {
    /// `[grid]`.
    pub grid: GridConfig,
    /// `[buildings]`.
    pub buildings: BuildingsConfig,
    /// `[filter]`.
    pub filter: FilterConfig,
}

/// `TILES/manifest.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TilesManifest {
    /// Always `tiles.v2`.
    #[schemars(extend("const" = "tiles.v2"))]
    pub schema: String,
    /// SHA-256 over all that the output depends on.
    pub fingerprint: String,
    /// The program that wrote it.
    pub software: Software,
    /// Licence of the output, as an SPDX identifier.
    pub licence: String,
    /// Attribution that must stay with the output.
    pub attribution: String,
    /// EPSG code of the projection.
    pub epsg: u32,
    /// Polygons that were asked for, as GeoJSON coordinates in degrees; absent for the whole extract.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub area: Option<Vec<Vec<Vec<[f64; 2]>>>>,
    /// The configuration used.
    pub config: TilesConfig,
    /// The extracts.
    pub inputs: Vec<Input>,
    /// Buildings taken from them.
    pub buildings: BuildingCounts,
    /// Objects skipped, repaired, left out and noted, by reason.
    pub problems: BTreeMap<Action, BTreeMap<Defect, u64>>,
    /// Candidate tiles by verdict; `tiles.csv` lists them all.
    pub verdicts: BTreeMap<Verdict, u64>,
    /// The tiles kept, by name.
    pub tiles: Vec<TileEntry>,
}

impl Manifest for TilesManifest {
    const SCHEMA: &'static str = "tiles.v2";
    const COMMAND: &'static str = "rasterise";
}

impl TilesManifest {
    /// Objects with building tags that are buildings or have a row that says why not: as many as
    /// [`BuildingCounts::tagged`].
    #[must_use]
    pub fn accounted(&self) -> u64 {
        let rows = |action: Action| self.problems.get(&action).into_iter().flatten();
        let out = rows(Action::Skipped).chain(rows(Action::LeftOut)).map(|(_, count)| count);
        let BuildingCounts { outlines, parts, raised, .. } = self.buildings;
        outlines + parts + raised + out.sum::<u64>()
    }
}

/// `meta_json` inside of a tile's `.npz`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TileMeta {
    /// Always `tile.v1`.
    #[schemars(extend("const" = "tile.v1"))]
    pub schema: String,
    /// The tile.
    pub id: TileId,
    /// EPSG code of the projection.
    pub epsg: u32,
    /// Easting and northing of the centre, in metres.
    pub center_m: [f64; 2],
    /// Longitude and latitude of the centre, in degrees.
    pub center_lon_lat: [f64; 2],
    /// Side of the tile, in metres.
    pub side_m: u32,
    /// Side of a cell, in metres.
    pub cell_m: f64,
    /// Side of the central window, in metres.
    pub crop_m: u32,
    /// Always `north_first`: row 0 is the northernmost, column 0 the westernmost.
    #[schemars(extend("const" = "north_first"))]
    pub row_order: String,
    /// Licence, as an SPDX identifier.
    pub licence: String,
    /// Attribution that must stay with the file.
    pub attribution: String,
    /// Figures of the tile.
    pub statistics: TileStatistics,
}

impl TileMeta {
    /// The value of `schema`.
    pub const SCHEMA: &'static str = "tile.v1";
}
