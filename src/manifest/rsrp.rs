//! Manifest of imported radio maps (`rsrp.v1`) and the metadata inside each (`rsrp_map.v1`).

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Manifest, Software};
use crate::config::RsrpConfig;
use crate::grid::TileId;
use crate::store::Digest;
use crate::units::Dbm;

/// What the values of a radio map are.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum ValueKind {
    /// Linear path gain, 0 to 1.
    PathGainLinear,
    /// Path gain in dB, negative.
    PathGainDb,
    /// Path loss in dB, positive.
    PathLossDb,
    /// Received signal strength in watts.
    RssW,
    /// Received signal strength in dBm.
    RssDbm,
    /// Power per resource element in dBm.
    RsrpDbm,
}

impl ValueKind {
    /// All kinds, in the order of their declaration.
    pub const ALL: [Self; 6] = [
        Self::PathGainLinear,
        Self::PathGainDb,
        Self::PathLossDb,
        Self::RssW,
        Self::RssDbm,
        Self::RsrpDbm,
    ];

    /// Whether the values are linear (so that "no path" is 0, and float16 loses nearly all).
    #[must_use]
    pub fn is_linear(self) -> bool {
        matches!(self, Self::PathGainLinear | Self::RssW)
    }

    /// The name used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::PathGainLinear => "path_gain_linear",
            Self::PathGainDb => "path_gain_db",
            Self::PathLossDb => "path_loss_db",
            Self::RssW => "rss_w",
            Self::RssDbm => "rss_dbm",
            Self::RsrpDbm => "rsrp_dbm",
        }
    }
}

/// The transmitter of a map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BaseStation {
    /// East, north and up from the tile's centre on the ground, in metres.
    pub position_m: [f64; 3],
    /// Transmit power per resource element, in dBm.
    pub power_per_re_dbm: Dbm,
    /// Antenna pattern, in the producer's words.
    pub pattern: String,
}

/// How a map was computed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Radio {
    /// Carrier frequency, in Hz.
    pub frequency_hz: f64,
    /// Height of the receivers over the ground, in metres.
    pub rx_height_m: f64,
    /// The solver and its version.
    pub sionna_version: String,
    /// Rays for each transmitter.
    pub samples_per_tx: u64,
    /// Most interactions of a path.
    pub max_depth: u32,
    /// Whether paths go through walls.
    pub refraction: bool,
    /// Whether paths bend around edges.
    pub diffraction: bool,
}

/// The file that a map was imported from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SourceMap {
    /// File name without directories.
    pub file: String,
    /// Size and SHA-256 of the file (of the `.npy`, where metadata lie beside it).
    pub digest: Digest,
    /// What its values were.
    pub value_kind: ValueKind,
}

/// `meta_json` inside of an imported map's `.npz`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RsrpMeta {
    /// Always `rsrp_map.v1`.
    #[schemars(extend("const" = "rsrp_map.v1"))]
    pub schema: String,
    /// The tile.
    pub id: TileId,
    /// EPSG code of the projection.
    pub epsg: u32,
    /// Easting and northing of the centre, in metres.
    pub center_m: [f64; 2],
    /// Side of a cell, in metres.
    pub cell_m: f64,
    /// Cells along a side.
    pub cells: u32,
    /// Always `north_first`: row 0 is the northernmost, column 0 the westernmost.
    #[schemars(extend("const" = "north_first"))]
    pub row_order: String,
    /// What cells without a path hold, in dBm.
    pub floor_dbm: Dbm,
    /// The transmitter.
    pub base_station: BaseStation,
    /// How the map was computed.
    pub radio: Radio,
    /// Repeats that the levels are the mean of, where there are several: then there is `std_error_db`,
    /// and `radio.samples_per_tx` counts the rays of one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 2))]
    pub repeats: Option<u32>,
    /// Where it comes from.
    pub source: SourceMap,
    /// SHA-256 of the tile whose buildings make up the mask.
    pub tile_sha256: String,
    /// Licence, as an SPDX identifier.
    pub licence: String,
    /// Attribution that must stay with the file.
    pub attribution: String,
}

impl RsrpMeta {
    /// The value of `schema`.
    pub const SCHEMA: &'static str = "rsrp_map.v1";
}

/// Cells of a map by the mask's value.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MaskCounts {
    /// Outdoor cells that some path reaches (0).
    pub reached: u64,
    /// Building cells (1).
    pub building: u64,
    /// Outdoor cells without a path (2).
    pub unreached: u64,
}

/// What the place of a map on its buildings is judged by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Evidence {
    /// Cells without a path.
    NoPath,
    /// Levels in dB, since paths go through walls.
    Level,
}

impl Evidence {
    /// The name used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::NoPath => "no_path",
            Self::Level => "level",
        }
    }
}

/// How well a map lies on the buildings of its tile.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OrientationScore {
    /// What was compared with the buildings.
    pub evidence: Evidence,
    /// Correlation of the evidence with "is a building", -1 to 1.
    pub correlation: f64,
    /// 1 where exactly the buildings are without path, 0 where they have nothing to do with it.
    pub agreement: Option<f64>,
    /// Lead in correlation over the best of the seven other ways that a square can lie.
    pub lead: f64,
}

/// What a user should look at, though the map was taken.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum WarningCode {
    /// The transmitter lies below a roof whose height is uncertain.
    TransmitterBelowRoof,
    /// Turned or flipped, the map fits the buildings nearly as well.
    OrientationUnclear,
    /// Too few cells are reached, or built, to tell the orientation.
    OrientationUntold,
    /// Even the strongest cells are far below free space.
    WeakLevels,
    /// Fewer rays than `rsrp.few_rays`.
    FewRays,
    /// Many outdoor cells are without path.
    ManyUnreached,
    /// Nothing says that repeats are independent.
    DependentRepeats,
}

impl WarningCode {
    /// The name used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::TransmitterBelowRoof => "transmitter_below_roof",
            Self::OrientationUnclear => "orientation_unclear",
            Self::OrientationUntold => "orientation_untold",
            Self::WeakLevels => "weak_levels",
            Self::FewRays => "few_rays",
            Self::ManyUnreached => "many_unreached",
            Self::DependentRepeats => "dependent_repeats",
        }
    }
}

/// A warning about one map.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MapWarning {
    /// What it is about.
    pub code: WarningCode,
    /// In words.
    pub text: String,
}

impl MapWarning {
    /// A warning in words.
    #[must_use]
    pub fn new(code: WarningCode, text: impl Into<String>) -> Self {
        Self { code, text: text.into() }
    }
}

/// How far the repeats of a map agree.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MapReliability {
    /// Independent repeats.
    pub repeats: u32,
    /// Median of the standard errors of reached outdoor cells, in dB.
    pub median_std_error_db: f64,
    /// Share of outdoor cells that are holes at -100 dBm with a chance of more than 5 % and less
    /// than 95 %.
    pub unsure: f64,
}

/// What the checks of a map found, beyond passing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MapQuality {
    /// 99th percentile of the level over that of free space, outdoors, in dB; sound maps lie
    /// between -2 and 8 unless their transmitter is hidden.
    pub excess_db: Option<f64>,
    /// How the map lies on the buildings.
    pub orientation: OrientationScore,
    /// Share of outdoor cells that no path reaches.
    pub unreached: f64,
    /// Expected line-of-sight rays in a cell of a record at the window's corner, of all repeats.
    pub expected_rays: f64,
    /// How far repeats agree; absent where there are not several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reliability: Option<MapReliability>,
}

/// A map that was imported.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MapEntry {
    /// The tile.
    pub id: TileId,
    /// File name within the directory.
    pub file: String,
    /// Size and SHA-256 of the file.
    pub digest: Digest,
    /// Where it comes from.
    pub source: SourceMap,
    /// Cells by kind.
    pub cells: MaskCounts,
    /// What the checks found.
    pub quality: MapQuality,
    /// Metadata that the producer did not write, by key.
    pub assumed: Vec<String>,
    /// What a user should look at, though the map was taken.
    pub warnings: Vec<MapWarning>,
}

/// What maps must share to be comparable: how they were computed, whatever the number of rays.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Solver {
    /// Carrier frequency, in Hz.
    pub frequency_hz: f64,
    /// Height of the receivers over the ground, in metres.
    pub rx_height_m: f64,
    /// The solver and its version.
    pub sionna_version: String,
    /// Most interactions of a path.
    pub max_depth: u32,
    /// Whether paths go through walls.
    pub refraction: bool,
    /// Whether paths bend around edges.
    pub diffraction: bool,
}

impl From<&Radio> for Solver {
    fn from(radio: &Radio) -> Self {
        let Radio { frequency_hz, rx_height_m, max_depth, refraction, diffraction, .. } = *radio;
        let sionna_version = radio.sionna_version.clone();
        Self { frequency_hz, rx_height_m, sionna_version, max_depth, refraction, diffraction }
    }
}

/// The maps that share a solver.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SolverCount {
    /// How they were computed.
    pub solver: Solver,
    /// How many maps.
    pub maps: u64,
    /// Least and most rays for a transmitter, of one repeat.
    pub samples_per_tx: [u64; 2],
}

/// A file of the directory of maps.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MapFile {
    /// File name without directories.
    pub file: String,
    /// Size and SHA-256; absent if it could not be read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub digest: Option<Digest>,
    /// Those of the `.json` of the same name, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sidecar: Option<Digest>,
}

/// What an import depends on, beside tiles and configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ImportInputs {
    /// Side of a record's cell that rays were counted for, in metres.
    pub record_cell_m: f64,
    /// SHA-256 of the manifest of the scenes, if they told where transmitters stand.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scenes_manifest_sha256: Option<String>,
    /// The maps, those that were rejected too, by name.
    pub maps: Vec<MapFile>,
    /// Files that are no maps, such as a README.
    pub ignored: Vec<String>,
}

/// `RSRP/manifest.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RsrpManifest {
    /// Always `rsrp.v1`.
    #[schemars(extend("const" = "rsrp.v1"))]
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
    /// The configuration used.
    pub config: RsrpConfig,
    /// SHA-256 of the manifest of the tiles.
    pub tiles_manifest_sha256: String,
    /// Ways of computing; more than one means that maps are not comparable.
    pub solvers: Vec<SolverCount>,
    /// Rejected files by reason; `rejected.csv` lists them.
    pub rejected: BTreeMap<String, u64>,
    /// What was read beside the tiles.
    pub inputs: ImportInputs,
    /// The maps imported, by name of tile.
    pub maps: Vec<MapEntry>,
}

impl Manifest for RsrpManifest {
    const SCHEMA: &'static str = "rsrp.v1";
    const COMMAND: &'static str = "import-rsrp";
}
