//! Names of tiles: `utm10n_e598016_n4128768`.

use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};

use crate::crs::Utm;

/// A tile, named after its UTM zone and its centre in whole metres. The same place has
/// the same name whatever extract or area it was built from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct TileId {
    /// The projection.
    pub utm: Utm,
    /// Easting of the centre, in metres.
    pub easting: i64,
    /// Northing of the centre, in metres.
    pub northing: i64,
}

/// A string that names no tile.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("{0:?} is no tile id (expected for instance utm10n_e598016_n4128768)")]
pub struct TileIdError(pub String);

impl TileId {
    /// Centre as easting and northing, in metres.
    #[must_use]
    pub fn center(self) -> [f64; 2] {
        [self.easting as f64, self.northing as f64]
    }

    /// Longitude and latitude of the centre, in degrees.
    #[must_use]
    pub fn lon_lat(self) -> [f64; 2] {
        let [easting, northing] = self.center();
        self.utm.inverse(easting, northing)
    }

    /// Whether squares of a side, centred on two tiles, share more than a border.
    /// Squares of different zones count as apart.
    #[must_use]
    pub fn overlaps(self, other: Self, side_m: u32) -> bool {
        let side = u64::from(side_m);
        self.utm == other.utm
            && self.easting.abs_diff(other.easting) < side
            && self.northing.abs_diff(other.northing) < side
    }
}

impl fmt::Display for TileId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let hemisphere = if self.utm.is_north() { 'n' } else { 's' };
        let zone = self.utm.zone();
        write!(f, "utm{zone:02}{hemisphere}_e{}_n{}", self.easting, self.northing)
    }
}

impl FromStr for TileId {
    type Err = TileIdError;

    fn from_str(name: &str) -> Result<Self, TileIdError> {
        let parse = || {
            let (zone, rest) = name.strip_prefix("utm")?.split_at_checked(2)?;
            let (north, rest) = match rest.split_at_checked(1)? {
                ("n", rest) => (true, rest),
                ("s", rest) => (false, rest),
                _ => return None,
            };
            let (easting, northing) = rest.strip_prefix("_e")?.split_once("_n")?;
            let id = Self {
                utm: Utm::from_zone(zone.parse().ok()?, north)?,
                easting: easting.parse().ok()?,
                northing: northing.parse().ok()?,
            };
            // Only the canonical spelling, so that names can be compared as strings.
            (id.to_string() == name).then_some(id)
        };
        parse().ok_or_else(|| TileIdError(name.to_owned()))
    }
}

impl From<TileId> for String {
    fn from(id: TileId) -> Self {
        id.to_string()
    }
}

impl TryFrom<String> for TileId {
    type Error = TileIdError;
    fn try_from(name: String) -> Result<Self, TileIdError> {
        name.parse()
    }
}

impl JsonSchema for TileId {
    fn schema_name() -> Cow<'static, str> {
        "TileId".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "type": "string",
            "description": "UTM zone, hemisphere, easting and northing of the centre in metres.",
            "pattern": "^utm[0-9]{2}[ns]_e-?[0-9]+_n-?[0-9]+$",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip() {
        for name in ["utm10n_e598016_n4128768", "utm05s_e0_n10000000", "utm35n_e-512_n0"] {
            assert_eq!(name.parse::<TileId>().map(|id| id.to_string()), Ok(name.to_owned()));
        }
    }

    #[test]
    fn other_spellings_are_refused() {
        for name in
            ["", "utm", "utm61n_e0_n0", "utm5n_e0_n0", "utm10x_e0_n0", "utm10n_e01_n0", "utmé"]
        {
            assert_eq!(name.parse::<TileId>(), Err(TileIdError(name.to_owned())));
        }
    }

    #[test]
    fn neighbours_share_a_border_but_do_not_overlap() {
        let a: TileId = "utm10n_e0_n0".parse().expect("an id");
        let b: TileId = "utm10n_e512_n100".parse().expect("an id");
        assert!(!a.overlaps(b, 512) && a.overlaps(b, 513));
    }
}
