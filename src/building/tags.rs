//! From OSM tags to a building's attributes.

use super::Defect;
use super::height::{HeightSource, parse_length, parse_levels};
use crate::config::BuildingsConfig;

/// The key of a whole building.
pub const BUILDING: &str = "building";
/// The key of a part of a building.
pub const BUILDING_PART: &str = "building:part";

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

/// What is known about a building.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Attributes {
    /// Whole building or part.
    pub kind: Kind,
    /// Height of the top over the ground, in metres; never below the bottom.
    pub height_m: f32,
    /// Where the height comes from.
    pub source: HeightSource,
    /// Height of the bottom over the ground, in metres.
    pub min_height_m: f32,
    /// Begins above the flight height or is an open roof: does not block where nothing stands below.
    pub raised: bool,
}

/// A height that tags tell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Told {
    /// Height of the top over the ground, in metres.
    pub height_m: f32,
    /// Which tag told it.
    pub source: HeightSource,
}

impl Told {
    /// Of several heights the best known one, of equally known ones the highest.
    pub fn best(heights: impl IntoIterator<Item = Self>) -> Option<Self> {
        let better = |a: &Self, b: &Self| {
            a.source.cmp(&b.source).then_with(|| b.height_m.total_cmp(&a.height_m))
        };
        heights.into_iter().min_by(better)
    }
}

impl Attributes {
    /// The height, if it is no guess.
    #[must_use]
    pub fn told(&self) -> Option<Told> {
        let Self { height_m, source, .. } = *self;
        source.is_known().then_some(Told { height_m, source })
    }

    /// Takes a height of another object for one that is guessed, unless it ends below the bottom.
    pub fn inherit(&mut self, told: Told) {
        if !self.source.is_known() && told.height_m > self.min_height_m {
            (self.height_m, self.source) = (told.height_m, told.source);
        }
    }
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
    let is_there = |value: &&str| !NOT_THERE.contains(value);
    let (kind, value) = match (tag(BUILDING), tag(BUILDING_PART)) {
        (None, None) => return Classified::Unrelated,
        // No building of its own, but a part of one.
        (Some(value), Some(part)) if !is_there(&value) && is_there(&part) => (Kind::Part, part),
        (Some(value), _) => (Kind::Outline, value),
        (None, Some(value)) => (Kind::Part, value),
    };
    if !is_there(&value) || tag("location") == Some("underground") {
        return Classified::LeftOut(Defect::NotABuilding);
    }
    if kind == Kind::Part && !config.parts {
        return Classified::LeftOut(Defect::PartsDisabled);
    }
    let mut defects = Vec::new();
    let min_height_m = min_height(&tag, config, &mut defects);
    let told = told_height(&tag, min_height_m, config, &mut defects);
    let Told { height_m, source } = told.unwrap_or_else(|| Told {
        height_m: guess(value, min_height_m, config) as f32,
        source: HeightSource::Default,
    });
    let raised = value == "roof" || min_height_m > config.flight_height_m;
    let attributes =
        Attributes { kind, height_m, source, min_height_m: min_height_m as f32, raised };
    Classified::Building(attributes, defects)
}

/// Height of the top as an object tells it itself: `height`, else levels and roof. What
/// would end below the bottom is refused.
///
/// Also for ways that carry no building tag: a relation inherits the height that was left on its
/// outer way.
pub fn told_height<'a>(
    tag: &impl Fn(&str) -> Option<&'a str>,
    min_height_m: f64,
    config: &BuildingsConfig,
    defects: &mut Vec<Defect>,
) -> Option<Told> {
    // The bounds hold for the stored type too: nothing positive may become 0 as float32.
    let plausible = |height: f64| (height as f32) > 0.0 && height <= config.max_height_m;
    let mut judged = |height: Option<f64>| {
        match height {
            Some(height) if plausible(height) && height >= min_height_m => return Some(height),
            Some(height) if plausible(height) => defects.push(Defect::TopBelowBottom),
            Some(_) => defects.push(Defect::HeightImplausible),
            None => defects.push(Defect::HeightUnparsable),
        }
        None
    };
    if let Some(height) = tag("height").and_then(|text| judged(parse_length(text))) {
        return Some(Told { height_m: height as f32, source: HeightSource::Height });
    }
    let levels = parse_levels(tag("building:levels")?);
    let height = levels.map(|levels| levels * config.level_height_m + roof(tag, config));
    let height = judged(height)?;
    Some(Told { height_m: height as f32, source: HeightSource::Levels })
}

/// A height by type of building in metres; what begins high is at least a level high.
fn guess(value: &str, min_height_m: f64, config: &BuildingsConfig) -> f64 {
    let by_type = config.default_heights_m.get(value).copied().unwrap_or(config.default_height_m);
    if min_height_m > 0.0 { by_type.max(min_height_m + config.level_height_m) } else { by_type }
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
fn min_height<'a>(
    tag: &impl Fn(&str) -> Option<&'a str>,
    config: &BuildingsConfig,
    defects: &mut Vec<Defect>,
) -> f64 {
    let mut judged = |height: Option<f64>| {
        let plausible = |height: &f64| (0.0..=config.max_height_m).contains(height);
        if height.is_none() {
            defects.push(Defect::HeightUnparsable);
        }
        height.filter(plausible)
    };
    let told = tag("min_height").and_then(|text| judged(parse_length(text)));
    told.or_else(|| {
        let levels = parse_levels(tag("building:min_level")?);
        judged(levels.map(|levels| levels * config.level_height_m))
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
            (
                &[("building", "yes"), ("height", "1,200 m")],
                6.0,
                Default,
                &[Defect::HeightUnparsable],
            ),
            (&[("building:part", "yes"), ("min_height", "20")], 23.0, Default, &[]),
            (&[("building:part", "yes"), ("building:min_level", "1")], 6.0, Default, &[]),
            (
                &[("building:part", "yes"), ("height", "8"), ("min_height", "20")],
                23.0,
                Default,
                &[Defect::TopBelowBottom],
            ),
            (
                &[("building:part", "yes"), ("building:levels", "2"), ("building:min_level", "5")],
                18.0,
                Default,
                &[Defect::TopBelowBottom],
            ),
            (&[("building:part", "yes"), ("height", "8"), ("min_height", "8")], 8.0, Height, &[]),
        ];
        for (tags, height, source, defects) in cases {
            let (attributes, found) = building(tags);
            assert_eq!((attributes.height_m, attributes.source), (*height, *source), "{tags:?}");
            assert_eq!(found, *defects, "{tags:?}");
        }
    }

    #[test]
    fn what_begins_above_the_flight_height_is_raised() {
        assert!(building(&[("building:part", "yes"), ("min_height", "5")]).0.raised);
        assert!(building(&[("building:part", "yes"), ("building:min_level", "1")]).0.raised);
        assert!(building(&[("building", "roof"), ("height", "6")]).0.raised);
        assert!(!building(&[("building", "yes"), ("min_height", "2")]).0.raised);
        assert!(!building(&[("building", "yes"), ("min_height", "nonsense")]).0.raised);
    }

    #[test]
    fn an_object_may_be_a_part_of_a_building_and_no_building_itself() {
        let (attributes, _) = building(&[("building", "no"), ("building:part", "yes")]);
        assert_eq!(attributes.kind, Kind::Part);
        let (attributes, _) = building(&[("building", "yes"), ("building:part", "no")]);
        assert_eq!(attributes.kind, Kind::Outline);
        let (attributes, _) = building(&[("building", "yes"), ("building:part", "yes")]);
        assert_eq!(attributes.kind, Kind::Outline);
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
