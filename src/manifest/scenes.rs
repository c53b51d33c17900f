//! Manifest of scenes (`scenes.v2`) and the description inside each (`scene.v1`).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Input, Manifest, Software};
use crate::config::{BuildingsConfig, GridConfig, Material, SceneConfig};
use crate::grid::TileId;
use crate::store::Digest;

/// Buildings and parts that became no solid, by reason.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LeftOutSolids {
    /// `min_height` is not below the height.
    pub no_height: u64,
    /// Parts cover all of the outline, and stand for it.
    pub covered_by_parts: u64,
    /// The footprint encloses nothing on a lattice of 0.12 mm.
    pub no_area: u64,
    /// The mesh would not have been closed: a bug of the triangulation.
    pub not_closed: u64,
}

/// A file of a scene.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    /// Name within the directory.
    pub file: String,
    /// Size and SHA-256 of the file.
    pub digest: Digest,
}

/// A scene that was written.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneEntry {
    /// The tile.
    pub id: TileId,
    /// Its files.
    pub files: Vec<SceneFile>,
    /// Solids in the mesh of buildings.
    pub solids: u64,
    /// Triangles of the mesh of buildings.
    pub triangles: u64,
    /// Base stations.
    pub base_stations: u32,
}

/// What became of the sites of a file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SitesInput {
    /// File name without directories.
    pub file: String,
    /// Size and SHA-256.
    pub digest: Digest,
    /// Sites in the file.
    pub sites: u64,
    /// Of these, those in no scene.
    pub outside: u64,
    /// Base stations left out since another of the scene stands at the same place: the cells of
    /// one mast.
    pub repeated: u64,
    /// Base stations that would have stood inside of a building and were raised over its roof, or
    /// no higher than the receivers and were raised to `scenes.ground_height_m`.
    pub raised: u64,
}

/// The sections of the configuration that scenes depend on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScenesConfig {
    /// `[grid]`, that of the tiles.
    pub grid: GridConfig,
    /// `[buildings]`, that of the tiles.
    pub buildings: BuildingsConfig,
    /// `[scenes]`.
    pub scenes: SceneConfig,
}

/// `SCENES/manifest.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScenesManifest {
    /// Always `scenes.v2`.
    #[schemars(extend("const" = "scenes.v2"))]
    pub schema: String,
    /// SHA-256 over all that the output depends on.
    pub fingerprint: String,
    /// The program that wrote it.
    pub software: Software,
    /// Licence of the output, as an SPDX identifier; that of a file of sites may add to it.
    pub licence: String,
    /// Attribution that must stay with the output.
    pub attribution: String,
    /// EPSG code of the projection.
    pub epsg: u32,
    /// The configuration used.
    pub config: ScenesConfig,
    /// Side of the square around each centre that is to be traced, in metres.
    pub map_size_m: u32,
    /// Side of a cell of a map that makes up the cells of records, in metres.
    pub map_cell_m: f64,
    /// SHA-256 of the manifest of the tiles.
    pub tiles_manifest_sha256: String,
    /// The extracts.
    pub inputs: Vec<Input>,
    /// The file of sites.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sites: Option<SitesInput>,
    /// Buildings that are in no mesh.
    pub left_out: LeftOutSolids,
    /// Tiles without a scene, since no base station stands in them.
    pub without_base_station: Vec<TileId>,
    /// The scenes, by name of tile.
    pub scenes: Vec<SceneEntry>,
}

impl Manifest for ScenesManifest {
    const SCHEMA: &'static str = "scenes.v2";
    const COMMAND: &'static str = "scenes";
}

/// A base station of a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneStation {
    /// East, north and up from the tile's centre on the ground, in metres.
    pub position_m: [f64; 3],
    /// Whether it stands on a building.
    pub on_building: bool,
    /// Its name in the file of sites.
    pub name: Option<String>,
}

/// Materials by the names of ITU-R P.2040.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneMaterials {
    /// Walls and roofs.
    pub buildings: Material,
    /// The ground.
    pub ground: Material,
}

/// `scene.json` of a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneMeta {
    /// Always `scene.v1`.
    #[schemars(extend("const" = "scene.v1"))]
    pub schema: String,
    /// The tile.
    pub id: TileId,
    /// EPSG code of the projection.
    pub epsg: u32,
    /// Easting and northing of the centre, in metres: where the meshes have their origin.
    pub center_m: [f64; 2],
    /// Longitude and latitude of the centre, in degrees.
    pub center_lon_lat: [f64; 2],
    /// Side of the tile, in metres; all buildings that meet it are in the mesh, whole.
    pub side_m: u32,
    /// Side of a cell of the height grid, in metres.
    pub cell_m: f64,
    /// Side of the square around the centre that is to be traced, in metres.
    pub map_size_m: u32,
    /// Side of a cell of a traced map, in metres: that of a record.
    pub map_cell_m: f64,
    /// Height of receivers over the ground, in metres.
    pub rx_height_m: f64,
    /// Base stations; at least one.
    pub base_stations: Vec<SceneStation>,
    /// Materials.
    pub materials: SceneMaterials,
    /// Solids in the mesh of buildings.
    pub solids: u64,
    /// Triangles of the mesh of buildings.
    pub triangles: u64,
    /// SHA-256 of the extracts.
    pub osm_sha256: Vec<String>,
    /// Licence, as an SPDX identifier.
    pub licence: String,
    /// Attribution that must stay with the files.
    pub attribution: String,
}

impl SceneMeta {
    /// The value of `schema`.
    pub const SCHEMA: &'static str = "scene.v1";
}
