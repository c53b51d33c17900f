//! Lengths as people write them into OSM (wiki: "Key:height", "Map features/Units").
//!
//! What can be read in one way only is read; what may mean two things is no length.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Metres in a foot and in an inch (exact by definition).
const FOOT_M: f64 = 0.3048;
const INCH_M: f64 = 0.0254;
/// Inches in a foot: as many or more after feet are a slip of the pen.
const INCHES: f64 = 12.0;

/// Words for units of length, in metres.
const UNITS: [(&str, f64); 16] = [
    ("m", 1.0),
    ("metre", 1.0),
    ("metres", 1.0),
    ("meter", 1.0),
    ("meters", 1.0),
    ("mt", 1.0),
    ("mts", 1.0),
    ("м", 1.0), // Cyrillic
    ("cm", 0.01),
    ("km", 1000.0),
    ("ft", FOOT_M),
    ("foot", FOOT_M),
    ("feet", FOOT_M),
    ("in", INCH_M),
    ("inch", INCH_M),
    ("inches", INCH_M),
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

impl HeightSource {
    /// Whether somebody said so; a guess never beats what is known.
    #[must_use]
    pub fn is_known(self) -> bool {
        self != Self::Default
    }
}

/// A length in metres: `12`, `12.5 m`, `12,5`, `40 ft`, `1,454 ft`, `39'`, `39'4"`, `5'-6"`.
///
/// `None` for what is no length or may mean two: `1,200` (a comma before three digits divides
/// thousands in feet; in metres it may be either), `12'14"`, `10-12`, `12;15`. The value may be
/// negative or not finite (`-3`, `NaN`, `1e999`); whether it is plausible is the caller's question.
#[must_use]
pub fn parse_length(text: &str) -> Option<f64> {
    let text = plain(text);
    let text = text.trim();
    if let Some((feet, inches)) = text.split_once('\'') {
        return feet_and_inches(feet, inches);
    }
    let (number, unit) = split_unit(text);
    if unit.is_empty() {
        return parse_decimal(number, Thousands::May);
    }
    if unit == "\"" {
        return Some(parse_decimal(number, Thousands::May)? * INCH_M);
    }
    let metres = metres_of(unit)?;
    if metres == FOOT_M {
        return Some(parse_decimal(number, Thousands::Do)? * FOOT_M);
    }
    // "5 ft 6 in": what was taken for the number holds the feet.
    if metres == INCH_M && number.contains(|c: char| c.is_alphabetic()) {
        let (number, feet) = number.split_at(number.find(|c: char| c.is_alphabetic())?);
        let (feet, inches) = feet.split_at(feet.find(|c: char| !c.is_alphabetic())?);
        return if metres_of(feet)? == FOOT_M { feet_and_inches(number, inches) } else { None };
    }
    Some(parse_decimal(number, Thousands::May)? * metres)
}

/// A number of levels: `4`, `2.5`, `2,5`.
#[must_use]
pub fn parse_levels(text: &str) -> Option<f64> {
    parse_decimal(text, Thousands::May)
}

/// The text in small letters with straight signs for feet and inches and plain spaces, which
/// keyboards and telephones replace by typographic ones.
fn plain(text: &str) -> String {
    let straight = text.chars().map(|c| match c {
        '’' | '‘' | '′' | 'ʹ' | '´' | '`' | 'ʼ' => '\'',
        '”' | '“' | '″' | 'ʺ' | '„' => '"',
        '−' | '‐' | '‑' | '–' => '-',
        c if c.is_whitespace() => ' ',
        c => c,
    });
    straight.flat_map(char::to_lowercase).collect::<String>().replace("''", "\"")
}

/// Number and unit; a unit's full stop is taken off.
fn split_unit(text: &str) -> (&str, &str) {
    let is_unit = |c: char| c.is_alphabetic() || c == '"';
    let stopped = text.strip_suffix('.').filter(|text| text.ends_with(is_unit)).unwrap_or(text);
    let number = stopped.trim_end_matches(is_unit);
    // Letters that are numbers themselves: "nan", "inf".
    if number.trim().is_empty() { (text, "") } else { (number, &stopped[number.len()..]) }
}

fn metres_of(unit: &str) -> Option<f64> {
    UNITS.iter().find(|(name, _)| *name == unit).map(|(_, metres)| *metres)
}

/// What stands before and after the sign for feet; a hyphen between them joins.
fn feet_and_inches(feet: &str, inches: &str) -> Option<f64> {
    let whole = parse_decimal(feet, Thousands::Do)?;
    let inches = inches.trim();
    let inches = inches.strip_prefix('-').map_or(inches, str::trim);
    if inches.is_empty() {
        return Some(whole * FOOT_M);
    }
    let inches = parse_decimal(inches.strip_suffix('"').unwrap_or(inches), Thousands::May)?;
    let fits = (0.0..INCHES).contains(&inches) && whole >= 0.0 && whole.fract() == 0.0;
    fits.then_some(whole * FOOT_M + inches * INCH_M)
}

/// What a comma before three digits means.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Thousands {
    /// It divides thousands: where the unit is feet, people use no decimal comma.
    Do,
    /// Thousands or decimals: nobody can tell.
    May,
}

/// A decimal number with a point or a comma.
fn parse_decimal(text: &str, thousands: Thousands) -> Option<f64> {
    let text = text.trim();
    if text.starts_with('+') {
        return None;
    }
    let Some(at) = text.find(',') else { return text.parse().ok() };
    if let Some(point) = text.find('.') {
        // With both signs the last one is the decimal one.
        let (group, decimal) = if at < point { (',', '.') } else { ('.', ',') };
        let (whole, fraction) = text.split_once(decimal)?;
        return format!("{}.{}", ungrouped(whole, group)?, digits(fraction)?).parse().ok();
    }
    let (whole, fraction) = text.split_once(',')?;
    if fraction.contains(',') {
        return ungrouped(text, ',')?.parse().ok();
    }
    let is_grouped = ungrouped(text, ',').is_some();
    match (is_grouped, thousands) {
        (true, Thousands::Do) => ungrouped(text, ',')?.parse().ok(),
        (true, Thousands::May) => None,
        (false, _) => format!("{whole}.{}", digits(fraction)?).parse().ok(),
    }
}

/// Groups of three digits without the sign between them; no number begins with a group of zero.
fn ungrouped(text: &str, sign: char) -> Option<String> {
    let mut groups = text.split(sign);
    let first = digits(groups.next()?)?;
    let is_sound = (1..=3).contains(&first.len()) && !first.starts_with('0');
    let rest = groups.map(|group| digits(group).filter(|group| group.len() == 3));
    let rest = rest.collect::<Option<String>>()?;
    is_sound.then(|| format!("{first}{rest}"))
}

fn digits(text: &str) -> Option<&str> {
    let all = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    all.then_some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spellings_that_can_be_read_in_one_way() {
        let foot = |feet: f64, inches: f64| feet * 0.3048 + inches * 0.0254;
        let cases: [(&str, f64); 35] = [
            ("12", 12.0),
            ("12 m", 12.0),
            ("12m", 12.0),
            ("12 m.", 12.0),
            ("12.", 12.0),
            (" 12.5 metres ", 12.5),
            ("12.5\u{a0}M", 12.5),
            ("12,5", 12.5),
            ("89,10 m", 89.1),
            ("0,125", 0.125),
            ("12,3456", 12.3456),
            ("12.345", 12.345),
            ("1200 cm", 12.0),
            ("39'", foot(39.0, 0.0)),
            ("39.5'", foot(39.5, 0.0)),
            ("39'4\"", foot(39.0, 4.0)),
            ("39' 4''", foot(39.0, 4.0)),
            ("39' 4", foot(39.0, 4.0)),
            ("5'-6\"", foot(5.0, 6.0)),
            ("5' - 6.5\"", foot(5.0, 6.5)),
            ("40’", foot(40.0, 0.0)),
            ("40’ 6”", foot(40.0, 6.0)),
            ("6′", foot(6.0, 0.0)),
            ("5 ft 6 in", foot(5.0, 6.0)),
            ("5ft6in", foot(5.0, 6.0)),
            ("66\"", foot(0.0, 66.0)),
            ("30 ft", foot(30.0, 0.0)),
            ("30 ft.", foot(30.0, 0.0)),
            ("30 Feet", foot(30.0, 0.0)),
            ("39,5 ft", foot(39.5, 0.0)),
            ("1,454 ft", foot(1454.0, 0.0)),
            ("1,454'", foot(1454.0, 0.0)),
            ("1,454.5 ft", foot(1454.5, 0.0)),
            ("-3", -3.0),
            ("1e9", 1e9),
        ];
        for (text, metres) in cases {
            let found = parse_length(text).unwrap_or(f64::NAN);
            assert!((found - metres).abs() < 1e-9, "{text:?} gave {found}, not {metres}");
        }
        assert!(parse_length("NaN").is_some_and(f64::is_nan));
        assert_eq!(parse_levels("2,5"), Some(2.5));
    }

    #[test]
    fn what_is_no_length_or_may_be_two_is_refused() {
        let refused = [
            "abc",
            "",
            "m",
            "'",
            "\"",
            ".",
            ",",
            "12;15",
            "12 15",
            "10-12",
            "10 - 12 m",
            "1,200",
            "1,200 m",
            "12,5,6",
            "12'14\"",
            "12'12",
            "5'-6'",
            "5'6\"7",
            "39.5'4\"",
            "-5'6\"",
            "5'--6\"",
            "5'+6\"",
            "+12",
            "12+",
            "~12",
            "12 storeys",
            "12 m (39 ft)",
            "12 m 50",
            "1 454 ft",
            "6 in 5 ft",
            "5 m 6 in",
            "1.2.3",
            "1.234.5",
            "0,500,000",
        ];
        for text in refused {
            assert_eq!(parse_length(text), None, "{text:?}");
        }
        for text in ["1,200", "3-4", "4;5", "G+3", "4 levels"] {
            assert_eq!(parse_levels(text), None, "{text:?}");
        }
    }
}
