//! Lengths as people write them into OSM (wiki: "Key:height", "Key:building:levels").

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Metres in a foot and in an inch (exact by definition).
const FOOT_M: f64 = 0.3048;
const INCH_M: f64 = 0.0254;

/// Spellings of units, longest first where one ends in another, in metres.
const UNITS: [(&str, f64); 8] = [
    ("metres", 1.0),
    ("meters", 1.0),
    ("metre", 1.0),
    ("meter", 1.0),
    ("feet", FOOT_M),
    ("foot", FOOT_M),
    ("ft", FOOT_M),
    ("m", 1.0),
];

/// How well a height is known, best first; the numbers are those of `height_source` in tiles.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum HeightSource {
    /// From the `height` tag.
    Height = 1,
    /// From `building:levels` (and the roof's).
    Levels = 2,
    /// A guess by type of building.
    Default = 3,
}

/// A length in metres: `12`, `12.5 m`, `12,5`, `40 ft`, `39'`, `39'4"`. The value may be
/// negative or not finite (`NaN`, `1e999`); whether it is plausible is the caller's question.
#[must_use]
pub fn parse_length(text: &str) -> Option<f64> {
    let text = text.trim();
    if let Some((feet, rest)) = text.split_once(['\'', '′']) {
        let inches = rest.trim().trim_end_matches(['"', '″']).trim_end_matches("''").trim();
        let inches = if inches.is_empty() { Some(0.0) } else { parse_decimal(inches) }?;
        return Some(parse_decimal(feet)? * FOOT_M + inches * INCH_M);
    }
    let lower = text.to_ascii_lowercase();
    UNITS
        .iter()
        .find_map(|(unit, metres)| Some(parse_decimal(lower.strip_suffix(unit)?)? * metres))
        .or_else(|| parse_decimal(&lower))
}

/// A number of levels: `4`, `2.5`, `2,5`.
#[must_use]
pub fn parse_levels(text: &str) -> Option<f64> {
    parse_decimal(text)
}

/// A decimal number with a point or a comma.
fn parse_decimal(text: &str) -> Option<f64> {
    let text = text.trim();
    match text.split_once(',') {
        None => text.parse().ok(),
        // "1,234.5" and "12,5,6" are ambiguous, hence no number.
        Some((whole, fraction)) if !fraction.contains([',', '.']) => {
            format!("{whole}.{fraction}").parse().ok()
        }
        Some(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spellings_found_in_osm() {
        let cases: [(&str, Option<f64>); 20] = [
            ("12", Some(12.0)),
            ("12 m", Some(12.0)),
            ("12m", Some(12.0)),
            (" 12.5 metres ", Some(12.5)),
            ("12,5", Some(12.5)),
            ("39'", Some(39.0 * 0.3048)),
            ("39'4\"", Some(39.0 * 0.3048 + 4.0 * 0.0254)),
            ("39' 4''", Some(39.0 * 0.3048 + 4.0 * 0.0254)),
            ("6′", Some(6.0 * 0.3048)),
            ("30 ft", Some(30.0 * 0.3048)),
            ("30 Feet", Some(30.0 * 0.3048)),
            ("-3", Some(-3.0)),
            ("1e9", Some(1e9)),
            ("abc", None),
            ("", None),
            ("m", None),
            ("12;15", None),
            ("1,234.5", None),
            ("'", None),
            ("12 storeys", None),
        ];
        for (text, metres) in cases {
            assert_eq!(parse_length(text), metres, "{text:?}");
        }
        assert!(parse_length("NaN").is_some_and(f64::is_nan));
        assert_eq!(parse_levels("2,5"), Some(2.5));
    }
}
