//! Flags of importing radio maps.

use clap::{Args, ValueEnum};
use holescout::config::{Config, Preset};
use holescout::units::Dbm;
use serde_json::Value;

use super::set;

/// Flags for `[rsrp]`.
#[derive(Debug, Args)]
pub(crate) struct RsrpFlags {
    /// rsrp.floor_dbm: what cells without a path hold, in dBm
    #[arg(long, value_name = "DBM", allow_hyphen_values = true)]
    floor: Option<f64>,
    /// rsrp.max_array_mib: larger arrays are rejected unread, in MiB
    #[arg(long, value_name = "MIB")]
    max_array: Option<u32>,
    /// rsrp.preset: habits of a producer that writes no metadata
    #[arg(long, value_enum, value_name = "NAME")]
    preset: Option<PresetName>,
    /// rsrp.assume: a key of the metadata, and its value as JSON, where a map does not tell it
    #[arg(long, value_name = "KEY=VALUE", value_parser = assumption)]
    assume: Vec<(String, Value)>,
    /// rsrp.tx: transmitter to take from files that hold several maps, counted from 0
    #[arg(long, value_name = "INDEX")]
    tx: Option<u32>,
    /// rsrp.min_rays: fewer expected rays per cell reject a map
    #[arg(long, value_name = "N")]
    min_rays: Option<f64>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum PresetName {
    /// np.savez(path, path_gain=rm.path_gain)
    Sionna,
    /// Geo2SigMap's .npy
    Geo2sigmap,
    /// sionna-large-radio-maps' .npz
    LargeRadioMaps,
}

impl From<PresetName> for Preset {
    fn from(name: PresetName) -> Self {
        match name {
            PresetName::Sionna => Self::Sionna,
            PresetName::Geo2sigmap => Self::Geo2sigmap,
            PresetName::LargeRadioMaps => Self::LargeRadioMaps,
        }
    }
}

/// `tx_power_dbm=15`, `row_order=north_first`: what is no JSON is text.
fn assumption(text: &str) -> Result<(String, Value), String> {
    let (key, value) = text.split_once('=').ok_or("expected KEY=VALUE")?;
    let value = serde_json::from_str(value).unwrap_or_else(|_| Value::String(value.to_owned()));
    Ok((key.to_owned(), value))
}

impl RsrpFlags {
    pub(super) fn apply(&self, config: &mut Config) {
        let Config { rsrp, .. } = config;
        set(&mut rsrp.floor_dbm, self.floor.map(Dbm).as_ref());
        set(&mut rsrp.max_array_mib, self.max_array.as_ref());
        set(&mut rsrp.min_rays, self.min_rays.as_ref());
        rsrp.preset = self.preset.map(Preset::from).or(rsrp.preset);
        rsrp.tx = self.tx.or(rsrp.tx);
        rsrp.assume.extend(self.assume.iter().cloned());
    }
}
