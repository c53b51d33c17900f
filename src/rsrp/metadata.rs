//! The metadata that come with a map (schema `radio_map.v1`).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::rejection::{Rejection, RejectionCode};
use crate::manifest::ValueKind;

/// Which row comes first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RowOrder {
    /// Row 0 is the southernmost: what Sionna itself emits.
    SouthFirst,
    /// Row 0 is the northernmost: what images have.
    NorthFirst,
}

/// What the transmit power counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PowerReference {
    /// Power of one resource element.
    PerRe,
    /// Power of the whole carrier; `n_subcarriers` must be given.
    Total,
}

/// What cells without a path hold. JSON has no infinities, so these are strings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum NoPathValue {
    /// One value.
    One(Marker),
    /// Any of several, for instance `[0, "-inf", "nan"]`.
    Several(Vec<Marker>),
}

/// A number, also one that JSON cannot write.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Marker {
    /// A number.
    Number(f64),
    /// An infinity or NaN.
    Special(SpecialValue),
}

/// Values that JSON cannot write.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum SpecialValue {
    /// Negative infinity.
    #[serde(rename = "-inf")]
    NegativeInfinity,
    /// Infinity: a path loss without path.
    #[serde(rename = "inf")]
    Infinity,
    /// Not a number.
    #[serde(rename = "nan")]
    Nan,
}

impl Marker {
    /// As a number.
    #[must_use]
    pub fn value(self) -> f64 {
        match self {
            Self::Number(value) => value,
            Self::Special(SpecialValue::NegativeInfinity) => f64::NEG_INFINITY,
            Self::Special(SpecialValue::Infinity) => f64::INFINITY,
            Self::Special(SpecialValue::Nan) => f64::NAN,
        }
    }
}

impl NoPathValue {
    /// All values that mean "no path".
    #[must_use]
    pub fn values(&self) -> Vec<f64> {
        match self {
            Self::One(value) => vec![value.value()],
            Self::Several(values) => values.iter().map(|value| value.value()).collect(),
        }
    }
}

/// Where the transmitters stand: east, north and up from the map's centre on the ground, in metres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum TxPosition {
    /// The transmitter of the map.
    One([f64; 3]),
    /// Those of a file that holds a map for each of them, in its order.
    Several(Vec<[f64; 3]>),
}

impl TxPosition {
    /// All positions.
    #[must_use]
    pub fn all(&self) -> &[[f64; 3]] {
        match self {
            Self::One(position) => std::slice::from_ref(position),
            Self::Several(positions) => positions,
        }
    }
}

/// An EPSG code, written as `32610` or `"EPSG:32610"`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Crs {
    /// `32610`.
    Code(u32),
    /// `"EPSG:32610"`.
    Name(String),
}

impl std::fmt::Display for Crs {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Code(code) => write!(f, "{code}"),
            Self::Name(name) => f.write_str(name),
        }
    }
}

impl Crs {
    /// The code, if the text is one.
    #[must_use]
    pub fn epsg(&self) -> Option<u32> {
        match self {
            Self::Code(code) => Some(*code),
            Self::Name(name) => name.strip_prefix("EPSG:")?.parse().ok(),
        }
    }
}

/// Metadata of a radio map. All lengths are metres; unknown further keys are ignored.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RadioMapMetadata {
    /// `radio_map.v1`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub schema: Option<String>,
    /// Id of the tile.
    pub location_id: String,
    /// What the values are; may be left out where the array's name tells it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value_kind: Option<ValueKind>,
    /// Which row comes first. Column 0 is always the westernmost.
    pub row_order: RowOrder,
    /// What cells without a path hold.
    pub no_path_value: NoPathValue,
    /// Side of a cell.
    pub cell_size_m: f64,
    /// Easting and northing of the map's centre.
    pub map_center_m: [f64; 2],
    /// Side of the map.
    pub map_size_m: f64,
    /// Projection of the centre.
    pub crs: Crs,
    /// Height of the receivers over the ground.
    pub rx_height_m: f64,
    /// East, north and up from the centre on the ground; a list where the file holds several maps.
    pub tx_position_m: TxPosition,
    /// Transmit power, in dBm.
    pub tx_power_dbm: f64,
    /// What the transmit power counts.
    pub tx_power_is: PowerReference,
    /// Subcarriers of the carrier, where the power is the total.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub n_subcarriers: Option<u32>,
    /// Carrier frequency, in Hz.
    pub frequency_hz: f64,
    /// Antenna pattern of the transmitter.
    pub tx_pattern: String,
    /// The solver and its version.
    pub sionna_version: String,
    /// Rays for each transmitter; of one repeat, where there are several.
    #[serde(deserialize_with = "whole")]
    pub samples_per_tx: u64,
    /// Most interactions of a path.
    #[serde(deserialize_with = "whole")]
    pub max_depth: u32,
    /// Whether paths go through walls.
    pub refraction: bool,
    /// Whether paths bend around edges.
    pub diffraction: bool,
    /// Materials, in the producer's words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub materials: Option<serde_json::Value>,
    /// Seed of the solver.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Independent repeats that the values are the mean of, in linear power and with zeros; absent
    /// for a single trace, of which no error is known. From two on the archive also holds the array
    /// `<values>_std_error`, and may hold `<values>_first_half` (`docs/LABELS.md`).
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "whole_if_given")]
    #[schemars(range(min = 1))]
    pub repeats: Option<u32>,
    /// What makes repeats independent; absent where the producer does not say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub direction_shift: Option<DirectionShift>,
    /// SHA-256 of the extract that the scene was made from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub osm_sha256: Option<String>,
}

/// How the directions of rays differ from repeat to repeat.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DirectionShift {
    /// By a shift, or a draw, that is random and another one for each repeat.
    Random,
}

/// As [`whole`], of a key that may be missing.
fn whole_if_given<'de, D: serde::Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<u32>, D::Error> {
    #[derive(Deserialize)]
    struct Whole(#[serde(deserialize_with = "whole")] u32);
    Ok(Option::<Whole>::deserialize(deserializer)?.map(|Whole(number)| number))
}

/// A whole number, also if it is written as `3e7` or `5.0`, as Python does.
fn whole<'de, T, D>(deserializer: D) -> Result<T, D::Error>
where
    T: TryFrom<u64>,
    D: serde::Deserializer<'de>,
{
    /// The largest float64 below which every whole number is one.
    const EXACT: f64 = (1_u64 << 53) as f64;
    let number = serde_json::Number::deserialize(deserializer)?;
    let from_float = || {
        let float = number.as_f64().filter(|n| n.fract() == 0.0 && (0.0..EXACT).contains(n));
        float.map(|float| float as u64)
    };
    let whole = number.as_u64().or_else(from_float).and_then(|number| T::try_from(number).ok());
    whole.ok_or_else(|| serde::de::Error::custom(format!("{number} is no whole number in range")))
}

/// The keys that must be there, for one message about all that are missing.
const REQUIRED: [&str; 18] = [
    "location_id",
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
    "frequency_hz",
    "tx_pattern",
    "sionna_version",
    "samples_per_tx",
    "max_depth",
    "refraction",
    "diffraction",
];

/// Metadata as they are written, before they are complete.
pub type Object = serde_json::Map<String, serde_json::Value>;

/// Whether a key has a value.
pub(super) fn is_given(object: &Object, key: &str) -> bool {
    object.get(key).is_some_and(|value| !value.is_null())
}

/// The keys and values of metadata.
pub(super) fn parse_object(json: &[u8]) -> Result<Object, Rejection> {
    const MEND: &str =
        "write it with json.dumps; JSON has no NaN or Infinity, use \"nan\", \"-inf\"";
    let value: serde_json::Value = serde_json::from_slice(json)
        .map_err(|error| invalid("metadata as JSON", error.to_string(), MEND))?;
    match value {
        serde_json::Value::Object(object) => Ok(object),
        other => Err(invalid("an object of keys and values", other.to_string(), MEND)),
    }
}

fn invalid(expected: &str, found: String, mend: &str) -> Rejection {
    Rejection::new(RejectionCode::InvalidMetadata, expected, found, mend)
}

impl RadioMapMetadata {
    /// The value of `schema`.
    pub const SCHEMA: &'static str = "radio_map.v1";

    /// Parses and checks metadata for themselves, without the array or the tile.
    ///
    /// # Errors
    /// [`RejectionCode::MissingMetadata`] names all missing keys at once,
    /// [`RejectionCode::InvalidMetadata`] the first that cannot be used.
    pub fn parse(json: &[u8]) -> Result<Self, Rejection> {
        Self::from_object(parse_object(json)?)
    }

    /// Checks metadata that are complete.
    pub(super) fn from_object(object: Object) -> Result<Self, Rejection> {
        let missing: Vec<_> = REQUIRED.into_iter().filter(|key| !is_given(&object, key)).collect();
        if !missing.is_empty() {
            return Err(Rejection::new(
                RejectionCode::MissingMetadata,
                format!("all keys of {}", Self::SCHEMA),
                format!("no {}", missing.join(", ")),
                "add them to meta_json, or to the .json beside the .npy, or to [rsrp.assume]",
            ));
        }
        let metadata: Self = serde_path_to_error::deserialize(serde_json::Value::Object(object))
            .map_err(|error| {
                let expected = "the types of schema radio_map.v1";
                invalid(expected, error.to_string(), "see schemas/radio_map.v1.json")
            })?;
        metadata.check()?;
        Ok(metadata)
    }

    /// Repeats, if there are several: levels then have an error.
    #[must_use]
    pub fn several_repeats(&self) -> Option<u32> {
        self.repeats.filter(|&repeats| repeats > 1)
    }

    /// Rays of all repeats for each transmitter.
    #[must_use]
    pub fn all_samples(&self) -> f64 {
        self.samples_per_tx as f64 * f64::from(self.repeats.unwrap_or(1))
    }

    fn check(&self) -> Result<(), Rejection> {
        let demand = |holds: bool, key: &str, expected: &str, found: String| {
            let found = format!("{key} = {found}");
            let mend = format!("correct {key} in the metadata");
            let reject = || Rejection::new(RejectionCode::InvalidMetadata, expected, found, mend);
            if holds { Ok(()) } else { Err(reject()) }
        };
        let schema = self.schema.as_deref().unwrap_or(Self::SCHEMA);
        demand(schema == Self::SCHEMA, "schema", Self::SCHEMA, schema.to_owned())?;
        let positive = |key: &str, value: f64| {
            demand(value > 0.0 && value.is_finite(), key, "a positive number", value.to_string())
        };
        positive("cell_size_m", self.cell_size_m)?;
        positive("map_size_m", self.map_size_m)?;
        let frequency = self.frequency_hz;
        demand(
            (1e7..=1e13).contains(&frequency),
            "frequency_hz",
            "hertz, as 3.5e9 for 3.5 GHz",
            frequency.to_string(),
        )?;
        let power = self.tx_power_dbm;
        demand(power.abs() <= 200.0, "tx_power_dbm", "dBm, -200 to 200", power.to_string())?;
        let height = self.rx_height_m;
        demand(
            (0.0..=10_000.0).contains(&height),
            "rx_height_m",
            "0 to 10000 m, a horizontal plane",
            height.to_string(),
        )?;
        let samples = self.samples_per_tx;
        demand(samples > 0, "samples_per_tx", "at least one ray", samples.to_string())?;
        let repeats = self.repeats.unwrap_or(1);
        demand(repeats > 0, "repeats", "at least one repeat", repeats.to_string())?;
        let positions = self.tx_position_m.all();
        let near = |[x, y, z]: &[f64; 3]| {
            let plausible = [x, y].iter().all(|distance| distance.abs() <= 1e7);
            plausible && (0.0..=100_000.0).contains(z)
        };
        demand(
            !positions.is_empty() && positions.iter().all(near),
            "tx_position_m",
            "east, north and up in metres, not below the ground",
            format!("{positions:?}"),
        )?;
        let no_path = self.no_path_value.values();
        demand(!no_path.is_empty(), "no_path_value", "at least one value", "[]".to_owned())?;
        let crs = self.crs.epsg();
        demand(crs.is_some(), "crs", "an EPSG code such as EPSG:32610", self.crs.to_string())?;
        if self.tx_power_is == PowerReference::Total {
            demand(
                self.n_subcarriers.is_some_and(|count| count > 0),
                "n_subcarriers",
                "the number of subcarriers, since tx_power_is = total",
                self.n_subcarriers.map_or("nothing".to_owned(), |count| count.to_string()),
            )?;
        }
        Ok(())
    }
}
