//! Which parts belong to which outline, and what they inherit.

use std::collections::HashMap;

use geo::{Area, BooleanOps, BoundingRect, Rect};
use rayon::prelude::*;

use super::{Building, Kind, ObjectId, Told};
use crate::config::BuildingsConfig;
use crate::grid::BoxIndex;

/// Side of the blocks that buildings are sorted into, in metres: wider than most.
const BLOCK_M: f64 = 512.0;
/// Footprints that share less are neighbours, in m²: two readings of one wall.
const MIN_OVERLAP_M2: f64 = 1e-3;
/// A part belongs to every outline that holds so much of it ...
const MEMBER_SHARE: f64 = 0.5;
/// ... and to the one that holds most of it, if that is so much. What laps less over an outline is
/// a skyway or a neighbour.
const LEAST_SHARE: f64 = 0.1;

/// A part that a relation `type=building` names as one of an outline.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Named {
    /// The outline.
    pub outline: ObjectId,
    /// The part.
    pub part: ObjectId,
}

/// Buildings with what they are to each other.
#[derive(Debug)]
pub(super) struct Grouped {
    buildings: Vec<Building>,
    index: BoxIndex,
    /// The outlines that parts belong to, best first.
    outlines: HashMap<u32, Vec<u32>>,
    /// The parts of outlines.
    parts: HashMap<u32, Vec<u32>>,
    flight_height_m: f64,
}

impl Grouped {
    /// Groups buildings whose footprints are in metres of one projection.
    pub(super) fn new(
        mut buildings: Vec<Building>,
        named: &[Named],
        config: &BuildingsConfig,
    ) -> Self {
        let boxes = buildings.iter().map(bounds).collect();
        let index = BoxIndex::new(boxes, BLOCK_M);
        let outlines = outlines_of_parts(&buildings, &index, named);
        for (&part, outlines) in &outlines {
            inherit(&mut buildings, part as usize, outlines, config.level_height_m as f32);
        }
        let mut parts: HashMap<u32, Vec<u32>> = HashMap::new();
        for (&part, outlines) in &outlines {
            for &outline in outlines {
                parts.entry(outline).or_default().push(part);
            }
        }
        for parts in parts.values_mut() {
            parts.sort_unstable();
        }
        Self { buildings, index, outlines, parts, flight_height_m: config.flight_height_m }
    }

    /// The buildings, in the order given.
    pub(super) fn buildings(&self) -> &[Building] {
        &self.buildings
    }

    /// Bounding boxes of the footprints, in the order of the buildings.
    pub(super) fn boxes(&self) -> &[Rect<f64>] {
        self.index.boxes()
    }

    /// Indices of the buildings whose bounding boxes meet a box, ascending.
    pub(super) fn meeting(&self, bounds: &Rect<f64>) -> Vec<usize> {
        self.index.meeting(bounds)
    }

    /// The outlines that a part belongs to.
    pub(super) fn outlines_of(&self, part: usize) -> &[u32] {
        self.outlines.get(&(part as u32)).map_or(&[], Vec::as_slice)
    }

    /// The parts that belong to an outline.
    pub(super) fn parts_of(&self, outline: usize) -> &[u32] {
        self.parts.get(&(outline as u32)).map_or(&[], Vec::as_slice)
    }

    /// What begins above this height is raised, in metres.
    pub(super) fn flight_height_m(&self) -> f64 {
        self.flight_height_m
    }

    /// The buildings that share area with one and fulfil a condition.
    pub(super) fn overlapping(
        &self,
        building: usize,
        condition: impl Fn(&Building) -> bool,
    ) -> Vec<u32> {
        let near = self.meeting(&self.boxes()[building]).into_iter();
        let shares = |&other: &usize| {
            other != building
                && condition(&self.buildings[other])
                && overlap_m2(&self.buildings[building], &self.buildings[other]) > MIN_OVERLAP_M2
        };
        near.filter(shares).map(|other| other as u32).collect()
    }
}

fn bounds(building: &Building) -> Rect<f64> {
    building.footprint.bounding_rect().expect("a footprint has at least one ring")
}

/// Area that two footprints share, in m².
fn overlap_m2(one: &Building, other: &Building) -> f64 {
    one.footprint.intersection(&other.footprint).unsigned_area()
}

/// The outlines that each part belongs to, in the order in which it inherits from them.
fn outlines_of_parts(
    buildings: &[Building],
    index: &BoxIndex,
    named: &[Named],
) -> HashMap<u32, Vec<u32>> {
    let is_part = |at: &usize| buildings[*at].attributes.kind == Kind::Part;
    let parts: Vec<usize> = (0..buildings.len()).filter(is_part).collect();
    if parts.is_empty() {
        return HashMap::new();
    }
    let mut named_outlines: HashMap<ObjectId, Vec<u32>> = HashMap::new();
    if !named.is_empty() {
        let mut at: HashMap<ObjectId, Vec<u32>> = HashMap::new();
        for (index, building) in (0_u32..).zip(buildings) {
            at.entry(building.object).or_default().push(index);
        }
        for Named { outline, part } in named {
            let outlines = at.get(outline).into_iter().flatten().copied();
            let is_outline = |at: &u32| buildings[*at as usize].attributes.kind == Kind::Outline;
            named_outlines.entry(*part).or_default().extend(outlines.filter(is_outline));
        }
    }
    parts
        .into_par_iter()
        .filter_map(|part| {
            let of_relation = named_outlines.get(&buildings[part].object);
            let mut outlines = of_relation.cloned().unwrap_or_default();
            for outline in outlines_at(buildings, index, part) {
                if !outlines.contains(&outline) {
                    outlines.push(outline);
                }
            }
            (!outlines.is_empty()).then_some((part as u32, outlines))
        })
        .collect()
}

/// The outlines that a part belongs to by its place, the smallest first.
fn outlines_at(buildings: &[Building], index: &BoxIndex, part: usize) -> Vec<u32> {
    let near = index.meeting(&index.boxes()[part]).into_iter();
    let outlines = near.filter(|&at| buildings[at].attributes.kind == Kind::Outline);
    let area_m2 = buildings[part].footprint.unsigned_area();
    let shares: Vec<(usize, f64)> = outlines
        .map(|at| (at, overlap_m2(&buildings[part], &buildings[at]) / area_m2))
        .filter(|(_, share)| *share >= LEAST_SHARE)
        .collect();
    let most = shares.iter().map(|(_, share)| *share).fold(0.0, f64::max);
    let mut members: Vec<(f64, ObjectId, u32)> = shares
        .into_iter()
        .filter(|(_, share)| *share >= MEMBER_SHARE || *share == most)
        .map(|(at, _)| (buildings[at].footprint.unsigned_area(), buildings[at].object, at as u32))
        .collect();
    members.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
    members.into_iter().map(|(_, _, at)| at).collect()
}

/// What a part does not tell it takes from the first of its outlines that tells a top above the
/// part's bottom. If all that tell one end below, the part is a level high: where it begins is known.
fn inherit(buildings: &mut [Building], part: usize, outlines: &[u32], level_height_m: f32) {
    let min_height_m = buildings[part].attributes.min_height_m;
    let told = outlines.iter().filter_map(|&at| buildings[at as usize].attributes.told());
    let above = told.clone().find(|told| told.height_m > min_height_m);
    let a_level = |told: Told| Told { height_m: min_height_m + level_height_m, ..told };
    let height = above.or_else(|| told.clone().next().map(a_level));
    if let Some(told) = height {
        buildings[part].attributes.inherit(told);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::building::{Attributes, HeightSource};
    use geo::{MultiPolygon, coord};

    /// A rectangle from a place on, 10 m high to the north.
    fn building(id: i64, kind: Kind, [west, east]: [f64; 2], height: Option<f32>) -> Building {
        let rect = Rect::new(coord! { x: west, y: 0.0 }, coord! { x: east, y: 10.0 });
        let attributes = Attributes {
            kind,
            height_m: height.unwrap_or(6.0),
            source: if height.is_some() { HeightSource::Height } else { HeightSource::Default },
            min_height_m: 0.0,
            raised: false,
        };
        let footprint = MultiPolygon(vec![rect.to_polygon()]);
        Building { object: ObjectId::Way(id), footprint, attributes }
    }

    fn raised(mut building: Building, bottom: f32) -> Building {
        building.attributes.min_height_m = bottom;
        building.attributes.raised = true;
        building
    }

    fn city(buildings: Vec<Building>, named: &[Named]) -> Grouped {
        Grouped::new(buildings, named, &BuildingsConfig::default())
    }

    fn height(city: &Grouped, at: usize) -> (f32, HeightSource) {
        let Attributes { height_m, source, .. } = city.buildings()[at].attributes;
        (height_m, source)
    }

    #[test]
    fn a_part_belongs_to_the_outlines_that_hold_it() {
        use Kind::{Outline, Part};
        let made = city(
            vec![
                building(1, Outline, [0.0, 40.0], Some(20.0)),
                building(2, Outline, [40.0, 80.0], Some(30.0)),
                building(3, Outline, [0.0, 100.0], None),
                building(10, Part, [0.0, 20.0], None),
                building(11, Part, [30.0, 50.0], None),
                building(12, Part, [36.0, 60.0], None),
                building(13, Part, [78.0, 120.0], None),
                building(14, Part, [99.0, 140.0], None),
            ],
            &[],
        );
        let outlines = |part: usize| made.outlines_of(part);
        assert_eq!(outlines(3), [0, 2], "the smallest first");
        assert_eq!(outlines(4), [0, 1, 2], "half of it in each of two neighbours");
        assert_eq!(outlines(5), [1, 2], "a sixth in the first");
        assert_eq!(outlines(6), [2], "the one that holds most of it, though that is half");
        assert!(outlines(7).is_empty(), "less than a tenth");
        assert_eq!(made.parts_of(1), [4, 5]);
        assert_eq!(height(&made, 3), (20.0, HeightSource::Height));
        assert_eq!(height(&made, 5), (30.0, HeightSource::Height));
        assert_eq!(height(&made, 6), (6.0, HeightSource::Default), "its outline knows nothing");
    }

    #[test]
    fn relations_name_parts_and_come_first() {
        use Kind::{Outline, Part};
        let buildings = vec![
            building(1, Outline, [0.0, 40.0], Some(20.0)),
            building(2, Outline, [200.0, 240.0], Some(30.0)),
            building(10, Part, [0.0, 20.0], None),
        ];
        let named = [Named { outline: ObjectId::Way(2), part: ObjectId::Way(10) }];
        let made = city(buildings, &named);
        assert_eq!(made.outlines_of(2), [1, 0]);
        assert_eq!(height(&made, 2), (30.0, HeightSource::Height));
    }

    #[test]
    fn what_is_inherited_is_above_the_bottom() {
        use Kind::{Outline, Part};
        let of = |bottom: f32, outline: Option<f32>| {
            let part = raised(building(10, Part, [0.0, 20.0], None), bottom);
            height(&city(vec![building(1, Outline, [0.0, 40.0], outline), part], &[]), 1)
        };
        assert_eq!(of(10.0, Some(15.0)), (15.0, HeightSource::Height));
        assert_eq!(of(20.0, Some(15.0)), (23.0, HeightSource::Height));
        assert_eq!(of(20.0, None), (6.0, HeightSource::Default), "as the tags were read");
    }
}
