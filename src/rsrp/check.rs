//! Is the array what its metadata say? Checks 1, 2, 5 and 6 of the import contract.

use super::convert::{power_per_re, to_rsrp};
use super::map::LoadedMap;
use super::metadata::RadioMapMetadata;
use super::rejection::{Rejection, RejectionCode};
use crate::building::HeightSource;
use crate::config::{GridConfig, RsrpConfig};
use crate::grid::TileId;
use crate::manifest::{MapWarning, MaskCounts, ValueKind, WarningCode};
use crate::store::DType;

/// A map's centre may differ from its tile's by this, in metres.
const CENTER_TOLERANCE_M: f64 = 0.01;
/// Lengths are taken for whole multiples within this relative error.
const WHOLE_TOLERANCE: f64 = 1e-9;
/// Weaker levels are no result of a solver, in dBm: float32 ends at a gain of -449 dB, and
/// chains of diffractions were seen at -343 dB.
const LEAST_RSRP_DBM: f64 = -500.0;
/// A value that more cells share is suspected to be a floor: at least this many ...
const PILE_CELLS: usize = 50;
/// ... and this share of all cells ...
const PILE_SHARE: f64 = 0.01;
/// ... and so many times the second most frequent value (float16 has many equal values).
const PILE_FACTOR: usize = 8;
/// A roof with a `height` tag is this uncertain, in metres.
const HEIGHT_UNCERTAINTY_M: f64 = 1.0;
/// A roof with `building:levels` is this uncertain: two levels, in metres.
const LEVELS_UNCERTAINTY_M: f64 = 6.0;
/// A larger share of outdoor cells without a path is warned of.
const MOST_UNREACHED: f64 = 0.3;

/// How the cells of a map lie on the cells of the tile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Geometry {
    /// Side of a map's cell, in metres.
    pub(super) cell_m: f64,
    /// Cells of the map between its border and the central window.
    pub(super) offset: usize,
    /// Cells of the map along a side of the central window.
    pub(super) cells: usize,
}

/// So many decimals: what is beyond them is chance.
pub(super) fn rounded(value: f64, decimals: i32) -> f64 {
    let scale = 10.0_f64.powi(decimals);
    (value * scale).round() / scale
}

fn whole(value: f64) -> Option<usize> {
    let rounded = value.round();
    ((value - rounded).abs() <= WHOLE_TOLERANCE * rounded.max(1.0)).then_some(rounded as usize)
}

/// Shape, cell size, window and place. `record_cell_m` is the cell that maps must reach.
pub(super) fn geometry(
    map: &LoadedMap,
    metadata: &RadioMapMetadata,
    tile: TileId,
    grid: &GridConfig,
    record_cell_m: f64,
) -> Result<Geometry, Rejection> {
    let (cell, size) = (metadata.cell_size_m, metadata.map_size_m);
    let count = map.values.nrows();
    if whole(size / cell) != Some(count) {
        return Err(Rejection::new(
            RejectionCode::CellSizeContradictsShape,
            format!("{count} cells of {cell} m to make up map_size_m = {size}"),
            format!("{} m", count as f64 * cell),
            "correct cell_size_m or map_size_m",
        ));
    }
    let fits = |one: f64, other: f64| whole(one / other).or_else(|| whole(other / one)).is_some();
    if whole(record_cell_m / cell).is_none_or(|ratio| ratio == 0) || !fits(cell, grid.cell_m) {
        return Err(Rejection::new(
            RejectionCode::IncompatibleCellSize,
            format!("cells that make up {record_cell_m} m and lie on the grid's {} m", grid.cell_m),
            format!("{cell} m"),
            format!("trace with cell_size = {} or {record_cell_m}", grid.cell_m),
        ));
    }
    let crop = f64::from(grid.crop_m);
    if size < crop * (1.0 - WHOLE_TOLERANCE) {
        return Err(Rejection::new(
            RejectionCode::WindowTooSmall,
            format!("at least the central {crop} m"),
            format!("{size} m"),
            format!("trace a map of {crop} m or {} m", grid.side_m),
        ));
    }
    let (Some(offset), Some(cells)) = (whole((size - crop) / 2.0 / cell), whole(crop / cell))
    else {
        return Err(Rejection::new(
            RejectionCode::MisalignedWindow,
            format!("the central {crop} m to begin on a cell"),
            format!("{count} cells of {cell} m: it begins {} cells in", (size - crop) / 2.0 / cell),
            format!("trace {crop} m at {cell} m, or {} m at {} m", grid.side_m, grid.cell_m),
        ));
    };
    let epsg = metadata.crs.epsg();
    if epsg != Some(tile.utm.epsg()) {
        return Err(Rejection::new(
            RejectionCode::WrongCrs,
            tile.utm.to_string(),
            metadata.crs.to_string(),
            "trace the scene of this tile, or correct crs",
        ));
    }
    let [x, y] = metadata.map_center_m;
    let [easting, northing] = tile.center();
    let distance = libm::hypot(x - easting, y - northing);
    if distance.is_nan() || distance > CENTER_TOLERANCE_M {
        return Err(Rejection::new(
            RejectionCode::CenterOff,
            format!("the tile's centre, {easting}, {northing}"),
            format!("{x}, {y}: {distance:.3} m off"),
            "center the map on the tile, or correct map_center_m",
        ));
    }
    Ok(Geometry { cell_m: cell, offset, cells })
}

/// Whether a value stands for "no path", as the file's element type rounds it.
pub(super) fn no_path(metadata: &RadioMapMetadata, dtype: DType) -> impl Fn(f64) -> bool + use<> {
    let stored: Vec<f64> = metadata
        .no_path_value
        .values()
        .into_iter()
        .map(|declared| match dtype {
            DType::Float16 => half::f16::from_f64(declared).to_f64(),
            DType::Float32 => f64::from(declared as f32),
            _ => declared,
        })
        .collect();
    move |value| stored.iter().any(|&no| value == no || (value.is_nan() && no.is_nan()))
}

/// Whether some radio channel has such a value.
pub(super) fn is_possible(value: f64, kind: ValueKind, metadata: &RadioMapMetadata) -> bool {
    let rsrp = to_rsrp(value, kind, metadata).0;
    !(kind.is_linear() && value < 0.0) && (LEAST_RSRP_DBM..power_per_re(metadata).0).contains(&rsrp)
}

/// NaN, infinities, impossible powers and undeclared floors.
pub(super) fn values(map: &LoadedMap, metadata: &RadioMapMetadata) -> Result<(), Rejection> {
    let is_no_path = no_path(metadata, map.dtype);
    let present = || map.values.iter().copied().filter(|&value| !is_no_path(value));
    let total = map.values.len();
    let declared: Vec<String> =
        metadata.no_path_value.values().iter().map(ToString::to_string).collect();

    let undeclared = |code, what: &str, count: usize| {
        let mend = format!("set no_path_value to {what} if it means \"no path\", else trace again");
        let found = format!("{what} in {count} of {total} cells");
        let expected = format!("finite values, or no_path_value = {}", declared.join(", "));
        Err(Rejection::new(code, expected, found, mend))
    };
    let nan = present().filter(|value| value.is_nan()).count();
    if nan > 0 {
        return undeclared(RejectionCode::NanUndeclared, "nan", nan);
    }
    for (infinity, name) in [(f64::NEG_INFINITY, "\"-inf\""), (f64::INFINITY, "\"inf\"")] {
        let count = present().filter(|&value| value == infinity).count();
        if count > 0 {
            return undeclared(RejectionCode::InfinityUndeclared, name, count);
        }
    }
    if map.kind.is_linear() {
        let zeros = present().filter(|&value| value == 0.0).count();
        if zeros > 0 {
            return undeclared(RejectionCode::FloorUndeclared, "0", zeros);
        }
    }
    let is_wrong = |value: &f64| !is_possible(*value, map.kind, metadata);
    let wrong: Vec<f64> = present().filter(is_wrong).collect();
    if let Some(example) = wrong.first() {
        let expected = match map.kind {
            ValueKind::PathGainLinear => "path_gain_linear from 0 to 1".to_owned(),
            ValueKind::PathGainDb => "path_gain_db below 0 dB".to_owned(),
            ValueKind::PathLossDb => "path_loss_db above 0 dB".to_owned(),
            kind => format!("{} below the transmit power", kind.name()),
        };
        let expected = format!("{expected}, and RSRP above {LEAST_RSRP_DBM} dBm");
        return Err(Rejection::new(
            RejectionCode::ValueOutOfRange,
            expected,
            format!("{example} and such in {} of {total} cells", wrong.len()),
            "the values are of another kind, or the power is not the one they were made with",
        ));
    }
    floor(present().collect(), total)
}

/// A value that suspiciously many cells share.
fn floor(mut present: Vec<f64>, total: usize) -> Result<(), Rejection> {
    present.sort_unstable_by(f64::total_cmp);
    let (mut most, mut second, mut value) = (0, 0, f64::NAN);
    for run in present.chunk_by(|a, b| a == b) {
        if run.len() > most {
            (second, most, value) = (most, run.len(), run[0]);
        } else {
            second = second.max(run.len());
        }
    }
    let suspicious = most >= PILE_CELLS
        && most as f64 > PILE_SHARE * total as f64
        && most > PILE_FACTOR * second;
    if !suspicious {
        return Ok(());
    }
    Err(Rejection::new(
        RejectionCode::FloorUndeclared,
        "no_path_value to be the value of cells without a path",
        format!("{value} in {most} of {total} cells"),
        format!("set no_path_value = {value}"),
    ))
}

/// Is the transmitter where one can be? `roof` gives the height under a place (east and
/// north of the centre, in metres) and its source. Returns a warning where heights are
/// too uncertain to reject the map.
pub(super) fn transmitter(
    tx_position_m: [f64; 3],
    map_size_m: f64,
    roof: impl Fn(f64, f64) -> Option<(f64, HeightSource)>,
) -> Result<Option<MapWarning>, Rejection> {
    let [x, y, z] = tx_position_m;
    let half = map_size_m / 2.0;
    let inside = x.abs() <= half && y.abs() <= half && z.is_finite();
    if !inside {
        return Err(Rejection::new(
            RejectionCode::TransmitterOutside,
            format!("tx_position_m within ±{half} m of the centre"),
            format!("{x}, {y}, {z}"),
            "give the position relative to the map's centre",
        ));
    }
    let Some((height, source)) = roof(x, y).filter(|(height, _)| z < *height) else {
        return Ok(None);
    };
    let uncertainty = match source {
        HeightSource::Height => HEIGHT_UNCERTAINTY_M,
        HeightSource::Levels => LEVELS_UNCERTAINTY_M,
        HeightSource::Default => f64::INFINITY,
    };
    let found = format!("{z:.1} m over the ground, {:.1} m below the roof", height - z);
    if height - z > uncertainty {
        return Err(Rejection::new(
            RejectionCode::TransmitterInsideBuilding,
            format!("above the roof under it, {height:.1} m"),
            found,
            "trace with the buildings of this tile, or correct tx_position_m",
        ));
    }
    let text = format!("transmitter {found}, whose height is uncertain");
    Ok(Some(MapWarning::new(WarningCode::TransmitterBelowRoof, text)))
}

/// Expected line-of-sight rays in a cell at the corner of the window:
/// λ = N·A·h / (4π·(r² + h²)^1.5) for N rays, of all repeats, that leave the transmitter evenly, a cell of area A,
/// a transmitter h above the receivers, and the corner's distance r from the window's centre.
pub(super) fn expected_rays(
    metadata: &RadioMapMetadata,
    tx_position_m: [f64; 3],
    record_cell_m: f64,
    crop_m: f64,
) -> f64 {
    let height = (tx_position_m[2] - metadata.rx_height_m).abs();
    let distance = crop_m / 2.0 * std::f64::consts::SQRT_2;
    let squared = distance * distance + height * height;
    let sphere = 4.0 * std::f64::consts::PI * squared * libm::sqrt(squared);
    metadata.all_samples() * record_cell_m * record_cell_m * height / sphere
}

/// Are there enough rays for cells of this size? A share of e^−λ of the cells that a path could
/// reach is missed, and those that are hit look too strong.
pub(super) fn sampling(rays: f64, config: &RsrpConfig) -> Result<Option<MapWarning>, Rejection> {
    let found = format!("{rays:.3} expected rays per cell at the window's corner");
    if rays.is_nan() || rays < config.min_rays {
        let mend = if rays == 0.0 {
            "the transmitter stands in the receivers' plane, which no direct ray crosses: raise it"
        } else {
            "trace with more samples, or import with larger cells (shard.downsample)"
        };
        return Err(Rejection::new(
            RejectionCode::Undersampled,
            format!("at least {} (rsrp.min_rays)", config.min_rays),
            found,
            mend,
        ));
    }
    let few = rays < config.few_rays;
    let text = || format!("{found}, fewer than {} (rsrp.few_rays)", config.few_rays);
    Ok(few.then(|| MapWarning::new(WarningCode::FewRays, text())))
}

/// Share of outdoor cells that no path reaches; a map without any reached cell is none.
pub(super) fn unreached(counts: &MaskCounts) -> Result<f64, Rejection> {
    let MaskCounts { reached, unreached, .. } = *counts;
    if reached == 0 {
        return Err(Rejection::new(
            RejectionCode::NothingReached,
            "at least one outdoor cell with a path",
            format!("{unreached} outdoor cells, none reached"),
            "check the transmitter's position and the number of samples",
        ));
    }
    Ok(unreached as f64 / (reached + unreached) as f64)
}

/// A warning where many outdoor cells are without path.
pub(super) fn few_reached(unreached: f64) -> Option<MapWarning> {
    let percent = 100.0 * unreached;
    let text = format!("{percent:.0} % of the outdoor cells: few rays, or a hidden transmitter");
    (unreached > MOST_UNREACHED).then(|| MapWarning::new(WarningCode::ManyUnreached, text))
}
