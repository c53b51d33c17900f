//! The buildings of an extract as one: their groups, and the prisms that follow.

use geo::Rect;
use rayon::prelude::*;

use super::Building;
use super::groups::{Grouped, Named};
use super::prism::{Prism, prisms_of};
use crate::config::BuildingsConfig;

/// Buildings whose prisms are made at a time.
const CHUNK: usize = 1024;

/// All buildings of an extract.
#[derive(Debug)]
pub struct City {
    grouped: Grouped,
    prisms: Vec<Prism>,
    /// Where each building's prisms begin; one more for the end.
    first_prism: Vec<u32>,
}

impl City {
    /// Groups buildings whose footprints are in metres of one projection.
    ///
    /// A part belongs to the outlines that hold at least half of it, to the one that holds most of
    /// it, and to those that a relation names. What it does not tell of its height it inherits
    /// from them: first from those that a relation names, then from the smallest.
    ///
    /// # Panics
    /// If a footprint has no ring at all.
    #[must_use]
    pub fn new(buildings: Vec<Building>, named: &[Named], config: &BuildingsConfig) -> Self {
        let grouped = Grouped::new(buildings, named, config);
        let prisms: Vec<(Vec<Prism>, Vec<u32>)> = grouped
            .buildings()
            .par_chunks(CHUNK)
            .enumerate()
            .map(|(index, chunk)| {
                let (mut prisms, mut ends) = (Vec::with_capacity(chunk.len()), Vec::new());
                for at in 0..chunk.len() {
                    prisms_of(&grouped, index * CHUNK + at, &mut prisms);
                    ends.push(prisms.len() as u32);
                }
                (prisms, ends)
            })
            .collect();
        let mut city = Self { grouped, prisms: Vec::new(), first_prism: vec![0] };
        for (of_chunk, ends) in prisms {
            let before = city.prisms.len() as u32;
            city.prisms.extend(of_chunk);
            city.first_prism.extend(ends.into_iter().map(|end| before + end));
        }
        city
    }

    /// The buildings, in the order given.
    #[must_use]
    pub fn buildings(&self) -> &[Building] {
        self.grouped.buildings()
    }

    /// Bounding boxes of the footprints, in the order of the buildings.
    #[must_use]
    pub fn boxes(&self) -> &[Rect<f64>] {
        self.grouped.boxes()
    }

    /// Indices of the buildings whose bounding boxes meet a box, ascending.
    #[must_use]
    pub fn meeting(&self, bounds: &Rect<f64>) -> Vec<usize> {
        self.grouped.meeting(bounds)
    }

    /// The outlines that a part belongs to.
    #[must_use]
    pub fn outlines_of(&self, part: usize) -> &[u32] {
        self.grouped.outlines_of(part)
    }

    /// What a building is made of.
    #[must_use]
    pub fn prisms_of(&self, building: usize) -> &[Prism] {
        let [first, end] = [building, building + 1].map(|at| self.first_prism[at] as usize);
        &self.prisms[first..end]
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

    fn city(buildings: Vec<Building>, named: &[Named]) -> City {
        City::new(buildings, named, &BuildingsConfig::default())
    }

    fn height(city: &City, at: usize) -> (f32, HeightSource) {
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
