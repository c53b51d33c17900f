//! Radio maps of places in Helsinki, made up: one physical map (RSRP known in every cell)
//! can be written in every way that producers do.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use ndarray::{Array2, Axis, s};
use serde_json::{Value, json};
use zip::CompressionMethod;

use super::numpy::{Float, Layout, matrix, npy, npy_text, npz, npz_members};
use super::{Random, rasterise, read_json, run, shared_dir, write};

/// Power of one resource element in all maps, in dBm.
pub(crate) const POWER_PER_RE: f64 = 15.0;
/// Subcarriers where the power is the carrier's total.
pub(crate) const SUBCARRIERS: u32 = 1200;
/// What the product writes where no path arrives, in dBm.
pub(crate) const FLOOR: f64 = -160.0;
/// Cells at least this high are buildings.
const FLIGHT_HEIGHT: f64 = 2.0;
/// Side of a tile and of its central window, in metres and cells of the height grid.
const SIDE: usize = 1080;
pub(crate) const CROP: usize = 484;

/// Rasterised tiles around the Kaisaniemi bay: ten urban ones and two too empty ones.
pub(crate) struct Site {
    pub(crate) tiles: PathBuf,
    pub(crate) ids: Vec<String>,
}

/// The site, rasterised once for each test binary.
pub(crate) static SITE: LazyLock<Site> = LazyLock::new(|| {
    let tiles = shared_dir(concat!("site-", env!("CARGO_CRATE_NAME")));
    let bbox = "24.9385,60.1742,24.9465,60.1772";
    run(rasterise(&tiles).args(["--bbox", bbox])).succeeds();
    let manifest = read_json(&tiles.join("manifest.json"));
    let entries = manifest["tiles"].as_array().expect("a list");
    let id = |tile: &Value| tile["id"].as_str().expect("a name").to_owned();
    let ids: Vec<String> = entries.iter().map(id).collect();
    assert_eq!(ids.len(), 10, "urban tiles");
    Site { tiles, ids }
});

/// A tile of the site that its urban filter left out.
pub(crate) const DROPPED_TILE: &str = "utm35n_e385920_n6672768";

impl Site {
    /// An array of a tile's file, over the central window.
    pub(crate) fn crop(&self, id: &str, array: &str) -> Array2<f64> {
        let members = npz_members(&self.tiles.join(format!("{id}.npz")));
        let offset = (SIDE - CROP) / 2;
        let window = offset..offset + CROP;
        matrix(&members[array]).slice(s![window.clone(), window]).to_owned()
    }

    /// Where buildings are, in cells of a map.
    pub(crate) fn buildings(&self, id: &str, cell: usize) -> Array2<bool> {
        let heights = self.crop(id, "height_m");
        Array2::from_shape_fn((CROP / cell, CROP / cell), |(row, column)| {
            let (row, column) = (row * cell, column * cell);
            let block = heights.slice(s![row..row + cell, column..column + cell]);
            block.iter().all(|&height| height >= FLIGHT_HEIGHT)
        })
    }
}

/// Extent and cells of a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Window {
    /// 1 m over the whole tile.
    Whole,
    /// 1 m over the central window.
    Crop,
    /// 4 m over the central window.
    Coarse,
}

impl Window {
    pub(crate) const ALL: [Self; 3] = [Self::Whole, Self::Crop, Self::Coarse];

    /// Side of a cell, in metres.
    pub(crate) fn cell(self) -> usize {
        if self == Self::Coarse { 4 } else { 1 }
    }

    /// Side of the map, in metres.
    pub(crate) fn size(self) -> usize {
        if self == Self::Whole { SIDE } else { CROP }
    }

    /// Cells along a side.
    pub(crate) fn cells(self) -> usize {
        self.size() / self.cell()
    }

    /// Cells between the border and the central window.
    pub(crate) fn offset(self) -> usize {
        (self.size() - CROP) / 2 / self.cell()
    }
}

/// Where the transmitter of every map stands, and its carrier frequency in Hz.
const TX: [f64; 3] = [10.0, -20.0, 80.0];
const FREQUENCY: f64 = 3.5e9;
/// Height of the receivers, in metres.
const RX_HEIGHT: f64 = 2.0;

/// RSRP in dBm over a window of a tile, row 0 north: up to 40 dB below free space, and NaN where no
/// path arrives: in buildings and in a tenth of the other cells.
pub(crate) fn physical(seed: u64, tile: &str, window: Window) -> Array2<f64> {
    let cell = window.cell();
    let buildings = SITE.buildings(tile, cell);
    let is_building = |row: usize, column: usize| {
        let inside = |index: usize| index.checked_sub(window.offset());
        let at = inside(row).zip(inside(column));
        at.and_then(|(row, column)| buildings.get([row, column])).copied().unwrap_or(false)
    };
    let middle = (window.cells() as f64 - 1.0) / 2.0;
    let wavelength = 299_792_458.0 / FREQUENCY;
    let mut random = Random(seed);
    Array2::from_shape_fn((window.cells(), window.cells()), |(row, column)| {
        let (kind, shadow) = (random.share(), 40.0 * random.share());
        let x = (column as f64 - middle) * cell as f64 - TX[0];
        let y = (middle - row as f64) * cell as f64 - TX[1];
        let distance = (x * x + y * y + (RX_HEIGHT - TX[2]).powi(2)).sqrt();
        let friis = 20.0 * (wavelength / (4.0 * std::f64::consts::PI * distance)).log10();
        let hidden = is_building(row, column) || kind < 0.1;
        if hidden { f64::NAN } else { POWER_PER_RE + friis - shadow }
    })
}

/// Metadata of a map over a window of a tile: path gain, south first, 0 for no path.
pub(crate) fn metadata(tile: &str, window: Window) -> Value {
    let (_, place) = tile.split_once("_e").expect("a tile id");
    let (easting, northing) = place.split_once("_n").expect("a tile id");
    let metres = |text: &str| text.parse::<f64>().expect("a number");
    json!({
        "schema": "radio_map.v1",
        "location_id": tile,
        "row_order": "south_first",
        "no_path_value": 0,
        "cell_size_m": window.cell(),
        "map_center_m": [metres(easting), metres(northing)],
        "map_size_m": window.size(),
        "crs": "EPSG:32635",
        "rx_height_m": RX_HEIGHT,
        "tx_position_m": TX,
        "tx_power_dbm": POWER_PER_RE,
        "tx_power_is": "per_re",
        "frequency_hz": FREQUENCY,
        "tx_pattern": "iso",
        "sionna_version": "sionna-rt 2.2.0",
        "samples_per_tx": 30_000_000,
        "max_depth": 5,
        "refraction": false,
        "diffraction": true,
    })
}

/// Writes an `.npz` of one array and its metadata.
pub(crate) fn write_npz(path: &Path, array: &str, values: Vec<u8>, metadata: &Value) {
    let text = npy_text(metadata.to_string().as_bytes());
    let members = [(array, values), ("meta_json", text)];
    write(path, npz(&members, CompressionMethod::Deflated));
}

/// A coarse map that is beyond reproach, of a tile of the site: linear path gain, row 0 south.
pub(crate) fn good_values(tile: &str) -> Array2<f64> {
    let gain = |rsrp: f64| 10.0_f64.powf((rsrp - POWER_PER_RE) / 10.0);
    let mut rsrp = physical(7, tile, Window::Coarse);
    rsrp.invert_axis(Axis(0));
    rsrp.mapv(|rsrp| if rsrp.is_nan() { 0.0 } else { gain(rsrp) })
}

/// Writes [`good_values`] as the map of a tile.
pub(crate) fn write_good(path: &Path, tile: &str) {
    // Of a tile that was dropped only the name matters.
    let known = SITE.ids.iter().find(|id| *id == tile).unwrap_or(&SITE.ids[0]);
    let values = npy(&good_values(known), Layout::plain(Float::F4));
    write_npz(path, "path_gain", values, &metadata(tile, Window::Coarse));
}
