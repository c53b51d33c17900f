//! `[rsrp]`: import of radio maps.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{ConfigError, demand};
use crate::units::Dbm;

/// Keys of a map's metadata (schema `radio_map.v1`) that `[rsrp.assume]` may supply.
const ASSUMABLE: [&str; 23] = [
    "value_kind",
    "row_order",
    "no_path_value",
    "cell_size_m",
    "map_center_m",
    "map_size_m",
    "crs",
    "rx_height_m",
    "tx_position_m",
    "tx_power_dbm",
    "tx_power_is",
    "n_subcarriers",
    "frequency_hz",
    "tx_pattern",
    "sionna_version",
    "samples_per_tx",
    "max_depth",
    "refraction",
    "diffraction",
    "materials",
    "seed",
    "repeats",
    "direction_shift",
];

/// Producers whose files are read without metadata of ours.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Preset {
    /// A plain script around Sionna: `np.savez(path, path_gain=rm.path_gain)`.
    Sionna,
    /// `Geo2SigMap`: `.npy`, linear path gain, north first; 0, -inf or NaN where no path arrives.
    Geo2sigmap,
    /// sionna-large-radio-maps: `.npz` with `rm` and `tx_positions` from the south-west corner.
    LargeRadioMaps,
}

/// `[rsrp]`: import of radio maps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RsrpConfig {
    /// What cells without a path hold, in dBm. It is the mask that tells them apart: levels
    /// of weakly reached cells may be lower (diffraction goes down to -330 dBm), and a
    /// trainer may choose another floor without importing again.
    pub floor_dbm: Dbm,
    /// Larger files are refused before anything is allocated, in MiB of decoded array.
    pub max_array_mib: u32,
    /// Habits of a producer that writes no metadata of schema `radio_map.v1`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preset: Option<Preset>,
    /// Transmitter to take from files that hold maps of several, counted from 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tx: Option<u32>,
    /// Reject maps for what is otherwise only a warning, and fail if any map is rejected.
    pub strict: bool,
    /// Fewer expected rays per cell at the window's corner reject a map; 0 accepts all.
    pub min_rays: f64,
    /// Fewer expected rays per cell at the window's corner are warned of.
    pub few_rays: f64,
    /// Metadata of maps that do not tell them, by key of schema `radio_map.v1`.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub assume: BTreeMap<String, serde_json::Value>,
}

impl Default for RsrpConfig {
    fn default() -> Self {
        Self {
            floor_dbm: Dbm(-160.0),
            max_array_mib: 256,
            preset: None,
            tx: None,
            strict: false,
            min_rays: 1.0,
            few_rays: 10.0,
            assume: BTreeMap::new(),
        }
    }
}

impl RsrpConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let Dbm(floor) = self.floor_dbm;
        demand(
            (-300.0..=-100.0).contains(&floor),
            "rsrp.floor_dbm",
            floor,
            "a level at which nothing is received, -300 to -100 dBm",
        )?;
        demand(
            (1..=16_384).contains(&self.max_array_mib),
            "rsrp.max_array_mib",
            self.max_array_mib,
            "1 to 16384",
        )?;
        let rays = |value: f64| value >= 0.0 && value.is_finite();
        demand(rays(self.min_rays), "rsrp.min_rays", self.min_rays, "0 or more")?;
        demand(rays(self.few_rays), "rsrp.few_rays", self.few_rays, "0 or more")?;
        let unknown = self.assume.keys().find(|key| !ASSUMABLE.contains(&key.as_str()));
        demand(
            unknown.is_none(),
            "rsrp.assume",
            unknown.map_or("", String::as_str),
            format!("keys of radio_map.v1: {}", ASSUMABLE.join(", ")),
        )
    }
}
