//! One map through all checks.
//!
//! Comments, messages of commits and issues may cite them by these numbers:
//!
//! 1. Metadata are complete, of their types and possible (`metadata`, `complete`).
//! 2. The tile is one of those given, and no other map claims it (`stage::locate`).
//! 3. The array is of a supported type, no larger than allowed, and its transmitter is chosen (`load`, `member`).
//! 4. The map is square, its cells make up record cells, its centre is the tile's (`check::geometry`).
//! 5. Values are possible for their kind, and cells without a path are declared (`check::values`).
//! 6. Errors of repeats are possible for powers (`repeats`).
//! 7. The map lies on the buildings as declared, not flipped, shifted or on another tile (`orientation`).
//! 8. The transmitter is inside the map and in no building (`check::transmitter`).
//! 9. Levels are those of their kind and power, held against free space (`free_space`).
//! 10. Enough rays reach the farthest cell (`check::sampling`).
//! 11. Some outdoor cell is reached, and not too few (`check::unreached`).
//!
//! What only looks odd is a warning; with `rsrp.strict` the first one rejects the map.

use std::collections::BTreeMap;
use std::path::Path;

use ndarray::{Array2, s};

use super::align::align;
use super::check::{self, Geometry, rounded};
use super::convert::{power_per_re, to_rsrp};
use super::free_space::{Comparison, FreeSpace};
use super::load::{Described, load_values};
use super::map::{AlignedMap, Repeats};
use super::metadata::{Object, RadioMapMetadata};
use super::orientation::Orientation;
use super::rejection::{Rejection, RejectionCode};
use super::repeats::reliability;
use super::window::{MapWindow, Occupancy, cut_repeats};
use crate::building::HeightSource;
use crate::config::{GridConfig, RsrpConfig};
use crate::grid::TileId;
use crate::manifest::{
    BaseStation, MapQuality, MapWarning, Radio, RsrpMeta, SourceMap, StageFileError, TileEntry,
    TileFile, TilesManifest, Verdict,
};
use crate::store::Digest;

/// A map that hardly fits its tile is compared with the tiles up to so many steps of the lattice away.
const NEIGHBOURS: u64 = 2;

/// Everything that the import of one map needs to know.
pub(super) struct ImportContext<'a> {
    /// Directory of the tiles.
    pub(super) tiles: &'a Path,
    /// What the scenes that the maps were traced from tell, if they are given.
    pub(super) scenes: Option<BTreeMap<TileId, Object>>,
    pub(super) manifest: &'a TilesManifest,
    pub(super) by_id: BTreeMap<TileId, &'a TileEntry>,
    pub(super) dropped: BTreeMap<TileId, Verdict>,
    pub(super) rsrp: &'a RsrpConfig,
    /// Side of a record's cell.
    pub(super) record_cell_m: f64,
    /// Bytes that an array may have.
    pub(super) limit: u64,
}

/// A file of the maps' directory.
pub(super) struct SourceFile<'a> {
    pub(super) path: &'a Path,
    pub(super) name: &'a str,
    pub(super) digest: &'a Digest,
}

/// A map that passed.
pub(super) struct Examined {
    pub(super) meta: RsrpMeta,
    pub(super) map: AlignedMap,
    pub(super) quality: MapQuality,
    pub(super) warnings: Vec<MapWarning>,
}

/// Why a map did not pass: it is to blame, or the tiles are.
pub(super) enum Refusal {
    Rejected(Rejection),
    Failed(StageFileError),
}

impl From<Rejection> for Refusal {
    fn from(rejection: Rejection) -> Self {
        Self::Rejected(rejection)
    }
}

impl From<StageFileError> for Refusal {
    fn from(error: StageFileError) -> Self {
        Self::Failed(error)
    }
}

impl ImportContext<'_> {
    fn grid(&self) -> &GridConfig {
        &self.manifest.config.grid
    }

    /// What is at least as high as the flight height in a tile's central window.
    fn occupied(&self, height_m: &Array2<f32>) -> Array2<bool> {
        let (start, length) = (self.grid().crop_offset_cells(), self.grid().crop_cells());
        let crop = start..start + length;
        let flight_height = self.manifest.config.buildings.flight_height_m;
        let heights = height_m.slice(s![crop.clone(), crop]);
        heights.mapv(|height| f64::from(height) >= flight_height)
    }

    fn occupancy(&self, height_m: &Array2<f32>, geometry: &Geometry) -> Occupancy {
        let ratio = geometry.cell_m / self.grid().cell_m;
        Occupancy::new(&self.occupied(height_m), geometry.cells, ratio)
    }

    /// The buildings of the tiles around one.
    fn nearby(
        &self,
        tile: TileId,
        geometry: &Geometry,
    ) -> Result<Vec<(TileId, Occupancy)>, Refusal> {
        let reach = NEIGHBOURS * u64::from(self.grid().spacing_m);
        let is_near = |other: &TileId| {
            *other != tile
                && other.easting.abs_diff(tile.easting) <= reach
                && other.northing.abs_diff(tile.northing) <= reach
        };
        let near = self.by_id.iter().filter(|(id, _)| is_near(id));
        near.map(|(id, entry)| {
            let heights = TileFile::read_heights(self.tiles, entry)?;
            Ok((*id, self.occupancy(&heights, geometry)))
        })
        .collect()
    }
}

/// Reads a map, checks it against its metadata and its tile, and aligns it.
pub(super) fn examine(
    source: &SourceFile<'_>,
    described: &Described,
    entry: &TileEntry,
    context: &ImportContext<'_>,
) -> Result<Examined, Refusal> {
    let (grid, rsrp, metadata) = (context.grid(), context.rsrp, &described.metadata);
    // Checks 1 and 2 are done. Check 3:
    let map = load_values(source.path, metadata, context.limit, rsrp.tx.map(|tx| tx as usize))?;
    // 4
    let geometry = check::geometry(&map, metadata, entry.id, grid, context.record_cell_m)?;
    let tile = TileFile::read(context.tiles, entry)?;
    let occupancy = context.occupancy(&tile.height_m, &geometry);
    let window = MapWindow::cut(&map, metadata, &geometry);
    let position = map.tx_position_m;
    let free_space = FreeSpace::new(metadata, position, geometry.cell_m, geometry.cells);
    let levels = Comparison::new(&window, &occupancy, metadata, &free_space);
    // 5. Impossible values are those of another kind more often than not.
    check::values(&map, metadata).map_err(|rejection| {
        let other = (rejection.code == RejectionCode::ValueOutOfRange)
            .then(|| levels.other_kind(map.kind))
            .flatten();
        other.unwrap_or(rejection)
    })?;
    // 6
    if let Some(repeats) = &map.repeats {
        repeats.check(&map, metadata)?;
    }
    let mut warnings = Vec::new();
    // 7. The place comes before the levels: a map that is turned has its strong cells elsewhere.
    let level = |value: f64| to_rsrp(value, map.kind, metadata).0;
    let friis = |at| (power_per_re(metadata) + free_space.gain(at)).0;
    let placement = Orientation::new(&window, &occupancy, metadata, level, friis);
    let placed = placement.check(&occupancy, || context.nearby(entry.id, &geometry))?;
    warnings.extend(placed.warning);
    // 8
    let roof = |x: f64, y: f64| roof(&tile, grid.cell_m, x, y);
    warnings.extend(check::transmitter(position, metadata.map_size_m, roof)?);
    // 9
    let excess_db = levels.check(map.kind)?;
    warnings.extend(Comparison::warning(excess_db));
    // 10
    let rays =
        check::expected_rays(metadata, position, context.record_cell_m, f64::from(grid.crop_m));
    warnings.extend(check::sampling(rays, rsrp)?);

    let repeats = cut_repeats(&map, metadata, &geometry);
    let repeats = repeats.as_ref();
    let aligned = align(&window, repeats, map.kind, metadata, &occupancy, rsrp.floor_dbm);
    // 11
    let unreached = check::unreached(&aligned.counts)?;
    warnings.extend(check::few_reached(unreached));
    warnings.extend(Repeats::warning(metadata));
    if let Some(warning) = warnings.first().filter(|_| rsrp.strict) {
        return Err(strict(warning).into());
    }
    let meta = meta(source, metadata, &map, entry, &geometry, context);
    let quality = MapQuality {
        excess_db: excess_db.map(|excess| rounded(excess, 2)),
        orientation: placed.score,
        unreached: rounded(unreached, 4),
        expected_rays: rounded(rays, 3),
        reliability: reliability(&aligned, metadata.several_repeats()),
    };
    Ok(Examined { meta, map: aligned, quality, warnings })
}

fn strict(warning: &MapWarning) -> Rejection {
    Rejection::new(
        RejectionCode::Warned,
        "no warning, since rsrp.strict is set",
        format!("{}: {}", warning.code.name(), warning.text),
        "trace again, or import without --strict",
    )
}

fn meta(
    source: &SourceFile<'_>,
    metadata: &RadioMapMetadata,
    map: &super::map::LoadedMap,
    entry: &TileEntry,
    geometry: &Geometry,
    context: &ImportContext<'_>,
) -> RsrpMeta {
    RsrpMeta {
        schema: RsrpMeta::SCHEMA.to_owned(),
        id: entry.id,
        epsg: entry.id.utm.epsg(),
        center_m: entry.id.center(),
        cell_m: geometry.cell_m,
        cells: geometry.cells as u32,
        row_order: "north_first".to_owned(),
        floor_dbm: context.rsrp.floor_dbm,
        base_station: BaseStation {
            position_m: map.tx_position_m,
            power_per_re_dbm: power_per_re(metadata),
            pattern: metadata.tx_pattern.clone(),
        },
        radio: Radio {
            frequency_hz: metadata.frequency_hz,
            rx_height_m: metadata.rx_height_m,
            sionna_version: metadata.sionna_version.clone(),
            samples_per_tx: metadata.samples_per_tx,
            max_depth: metadata.max_depth,
            refraction: metadata.refraction,
            diffraction: metadata.diffraction,
        },
        repeats: metadata.several_repeats(),
        source: SourceMap {
            file: source.name.to_owned(),
            digest: source.digest.clone(),
            value_kind: map.kind,
        },
        tile_sha256: entry.digest.sha256.clone(),
        licence: context.manifest.licence.clone(),
        attribution: context.manifest.attribution.clone(),
    }
}

/// Height and its source under a place relative to the tile's centre, if a building is there.
fn roof(tile: &TileFile, cell_m: f64, x: f64, y: f64) -> Option<(f64, HeightSource)> {
    let half = tile.height_m.nrows() as f64 * cell_m / 2.0;
    let index = |distance: f64| {
        let cell = (distance / cell_m).floor();
        (cell >= 0.0).then_some(cell as usize)
    };
    let at = [index(half - y)?, index(half + x)?];
    let source = match tile.height_source.get(at)? {
        1 => HeightSource::Height,
        2 => HeightSource::Levels,
        3 => HeightSource::Default,
        _ => return None,
    };
    Some((f64::from(*tile.height_m.get(at)?), source))
}
