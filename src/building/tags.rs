//! From OSM tags to a building's attributes.

use super::height::{HeightSource, parse_length, parse_levels};
use super::{Defect, defect::Action};
use crate::config::BuildingsConfig;

/// Values of `building` and `building:part` for what is not there, or not yet, or no more.
/// (Lifecycle *prefixes* such as `demolished:building` are other keys and never match.)
const NOT_THERE: [&str; 6] = ["no", "proposed", "planned", "demolished", "razed", "removed"];

/// Whether an object is a whole building or a part of one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// `building=*`.
    Outline,
    /// `building:part=*`.
    Part,
}

/// What the tags say about a building.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Attributes {
    /// Whole building or part.
    pub kind: Kind,
    /// Height of the top over the ground, in metres.
    pub height_m: f32,
    /// Where the height comes from.
    pub source: HeightSource,
    /// Height of the bottom over the ground, in metres.
    pub min_height_m: f32,
    /// Begins above the flight height or is an open roof: does not block by itself.
    pub elevated: bool,
}

/// The verdict on an object's tags.
#[derive(Debug, Clone, PartialEq)]
pub enum Classified {
    /// Has nothing to do with buildings.
    Unrelated,
    /// Has building tags and is not meant to appear.
    LeftOut(Defect),
    /// A building, with what was wrong with its heights.
    Building(Attributes, Vec<Defect>),
}

/// Classifies an object by its tags; `tag` gives the value of a key.
#[must_use]
pub fn classify<'a>(tag: impl Fn(&str) -> Option<&'a str>, config: &BuildingsConfig) -> Classified {
    let (kind, value) = match (tag("building"), tag("building:part")) {
        (Some(value), _) => (Kind::Outline, value),
        (None, Some(value)) => (Kind::Part, value),
        (None, None) => return Classified::Unrelated,
    };
    if NOT_THERE.contains(&value) || tag("location") == Some("underground") {
        return Classified::LeftOut(Defect::NotABuilding);
    }
    if kind == Kind::Part && !config.parts {
        return Classified::LeftOut(Defect::PartsDisabled);
    }
    let mut defects = Vec::new();
    let (height_m, source) = height(&tag, value, config, &mut defects);
    let min_height_m = min_height(&tag, config);
    let elevated = value == "roof" || min_height_m > config.flight_height_m;
    if elevated {
        defects.push(Defect::Elevated);
    }
    debug_assert!(defects.iter().all(|defect| defect.action() != Action::Skipped));
    Classified::Building(
        Attributes {
            kind,
            height_m: height_m as f32,
            source,
            min_height_m: min_height_m as f32,
            elevated,
        },
        defects,
    )
}

/// Height of the top: `height`, else levels and roof, else a guess.
fn height<'a>(
    tag: &impl Fn(&str) -> Option<&'a str>,
    value: &str,
    config: &BuildingsConfig,
    defects: &mut Vec<Defect>,
) -> (f64, HeightSource) {
    // The bounds hold for the stored type too: nothing positive may become 0 as float32.
    let plausible = |height: f64| (height as f32) > 0.0 && height <= config.max_height_m;
    if let Some(text) = tag("height") {
        match parse_length(text) {
            Some(height) if plausible(height) => return (height, HeightSource::Height),
            Some(_) => defects.push(Defect::HeightImplausible),
            None => defects.push(Defect::HeightUnparsable),
        }
    }
    if let Some(text) = tag("building:levels") {
        match parse_levels(text).map(|levels| levels * config.level_height_m + roof(tag, config)) {
            Some(height) if plausible(height) => return (height, HeightSource::Levels),
            Some(_) => defects.push(Defect::HeightImplausible),
            None => defects.push(Defect::HeightUnparsable),
        }
    }
    let guess = config.default_heights_m.get(value).copied().unwrap_or(config.default_height_m);
    (guess, HeightSource::Default)
}

/// Height of the roof above the levels, 0 if unknown.
fn roof<'a>(tag: &impl Fn(&str) -> Option<&'a str>, config: &BuildingsConfig) -> f64 {
    let plausible = |height: &f64| *height > 0.0 && *height <= config.max_height_m;
    tag("roof:height")
        .and_then(parse_length)
        .filter(plausible)
        .or_else(|| {
            let levels = tag("roof:levels").and_then(parse_levels)?;
            Some(levels * config.level_height_m).filter(plausible)
        })
        .unwrap_or(0.0)
}

/// Height of the bottom: `min_height`, else `building:min_level`, else 0.
fn min_height<'a>(tag: &impl Fn(&str) -> Option<&'a str>, config: &BuildingsConfig) -> f64 {
    let plausible = |height: &f64| *height >= 0.0 && *height <= config.max_height_m;
    tag("min_height")
        .and_then(parse_length)
        .filter(plausible)
        .or_else(|| {
            let level = tag("building:min_level").and_then(parse_levels)?;
            Some(level * config.level_height_m).filter(plausible)
        })
        .unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn classify_tags(tags: &[(&str, &'static str)]) -> Classified {
        let find = |key: &str| tags.iter().find(|(k, _)| *k == key).map(|(_, v)| *v);
        classify(find, &BuildingsConfig::default())
    }

    fn building(tags: &[(&str, &'static str)]) -> (Attributes, Vec<Defect>) {
        match classify_tags(tags) {
            Classified::Building(attributes, defects) => (attributes, defects),
            other => panic!("{tags:?} gave {other:?}"),
        }
    }

    #[test]
    fn heights_fall_through_to_the_next_source() {
        use HeightSource::{Default, Height, Levels};
        type Case<'a> = (&'a [(&'a str, &'static str)], f32, HeightSource, &'a [Defect]);
        let cases: &[Case] = &[
            (&[("building", "yes"), ("height", "12,5")], 12.5, Height, &[]),
            (
                &[("building", "yes"), ("height", "0"), ("building:levels", "2")],
                6.0,
                Levels,
                &[Defect::HeightImplausible],
            ),
            (
                &[("building", "yes"), ("building:levels", "3"), ("roof:levels", "1")],
                12.0,
                Levels,
                &[],
            ),
            (
                &[
                    ("building", "yes"),
                    ("building:levels", "3"),
                    ("roof:height", "2"),
                    ("roof:levels", "1"),
                ],
                11.0,
                Levels,
                &[],
            ),
            (&[("building", "garage")], 2.5, Default, &[]),
            (&[("building", "yes"), ("height", "NaN")], 6.0, Default, &[Defect::HeightImplausible]),
            (&[("building", "yes"), ("height", "1e9")], 6.0, Default, &[Defect::HeightImplausible]),
            (
                &[("building", "yes"), ("height", "1e-60")],
                6.0,
                Default,
                &[Defect::HeightImplausible],
            ),
            (&[("building", "yes"), ("height", "tall")], 6.0, Default, &[Defect::HeightUnparsable]),
        ];
        for (tags, height, source, defects) in cases {
            let (attributes, found) = building(tags);
            assert_eq!((attributes.height_m, attributes.source), (*height, *source), "{tags:?}");
            assert_eq!(found, *defects, "{tags:?}");
        }
    }

    #[test]
    fn what_begins_above_the_flight_height_is_elevated() {
        assert!(building(&[("building:part", "yes"), ("min_height", "5")]).0.elevated);
        assert!(building(&[("building:part", "yes"), ("building:min_level", "1")]).0.elevated);
        assert!(building(&[("building", "roof"), ("height", "6")]).0.elevated);
        assert!(!building(&[("building", "yes"), ("min_height", "2")]).0.elevated);
        assert!(!building(&[("building", "yes"), ("min_height", "nonsense")]).0.elevated);
    }

    #[test]
    fn what_is_not_there_is_left_out() {
        for tags in [
            [("building", "no"), ("height", "3")],
            [("building:part", "no"), ("height", "3")],
            [("building", "proposed"), ("height", "3")],
            [("building", "yes"), ("location", "underground")],
        ] {
            assert_eq!(classify_tags(&tags), Classified::LeftOut(Defect::NotABuilding));
        }
        assert_eq!(classify_tags(&[("demolished:building", "yes")]), Classified::Unrelated);
        assert_eq!(classify_tags(&[("landuse", "grass")]), Classified::Unrelated);
    }
}
