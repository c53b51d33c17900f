//! Closed prisms, and which of them buildings become.
//!
//! They follow what the height grid does (`rasterise::tile`): parts replace the outline where
//! they cover it, what is elevated floats.

use geo::{BoundingRect, MultiPolygon, Rect};
use rayon::prelude::*;

use super::cap::{Cap, NotConforming};
use super::region::{Region, STEPS_PER_M, snap};
use crate::building::{Attributes, Building, Kind};
use crate::grid::BoxIndex;
use crate::manifest::LeftOutSolids;

/// Thickness of what is known to be elevated but not from where on (`building=roof` without
/// `min_height`), in metres: that of a roof.
const SLAB_M: f32 = 0.3;
/// Side of the blocks that parts are sorted into, in metres: wider than most.
const BLOCK_M: f64 = 256.0;

/// A closed prism over a footprint.
#[derive(Debug, Clone, PartialEq)]
pub struct Solid {
    /// The place that the cap counts from: easting and northing in whole metres.
    origin: [i64; 2],
    cap: Cap,
    bounds: Rect<f64>,
    bottom_m: f32,
    top_m: f32,
}

/// Why a building became no solid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum NoSolid {
    NoHeight,
    CoveredByParts,
    NoArea,
    NotConforming,
}

impl From<NotConforming> for NoSolid {
    fn from(_: NotConforming) -> Self {
        Self::NotConforming
    }
}

impl Solid {
    /// A prism over what is left of a footprint without others.
    fn new(
        footprint: &MultiPolygon<f64>,
        without: &[&MultiPolygon<f64>],
        [bottom_m, top_m]: [f32; 2],
    ) -> Result<Self, NoSolid> {
        // The negation also catches what cannot be compared.
        if !(bottom_m < top_m) {
            return Err(NoSolid::NoHeight);
        }
        let region = Region::new(footprint, without);
        let empty = if without.is_empty() { NoSolid::NoArea } else { NoSolid::CoveredByParts };
        let bounds = region.bounds().ok_or(empty)?;
        let cap = Cap::new(&region.shapes)?;
        Ok(Self { origin: region.origin, cap, bounds, bottom_m, top_m })
    }

    /// Bounding box, in metres of the projection.
    #[must_use]
    pub fn bounds(&self) -> Rect<f64> {
        self.bounds
    }

    /// Height of the bottom and of the top over the ground, in metres.
    #[must_use]
    pub fn heights_m(&self) -> [f32; 2] {
        [self.bottom_m, self.top_m]
    }

    /// Whether a place on the ground (easting and northing in metres) lies in its footprint.
    #[must_use]
    pub fn covers(&self, place: [f64; 2]) -> bool {
        self.cap.covers(snap(place, self.origin))
    }

    /// Number of triangles of its surface.
    #[must_use]
    pub fn triangles(&self) -> usize {
        2 * (self.cap.triangles.len() + self.cap.boundary.len())
    }

    /// Its vertices relative to a place (easting and northing in whole metres): those of the
    /// bottom, then those of the top in the same order.
    pub(super) fn vertices(&self, [easting, northing]: [i64; 2]) -> impl Iterator<Item = [f32; 3]> {
        let [x, y] = self.origin;
        let (dx, dy) = ((x - easting) as f64, (y - northing) as f64);
        [self.bottom_m, self.top_m].into_iter().flat_map(move |z| {
            self.cap.points.iter().map(move |point| {
                let east = dx + f64::from(point.x) / STEPS_PER_M;
                let north = dy + f64::from(point.y) / STEPS_PER_M;
                [east as f32, north as f32, z]
            })
        })
    }

    /// Its triangles as indices of [`Self::vertices`], counter-clockwise seen from outside.
    pub(super) fn faces(&self) -> impl Iterator<Item = [u32; 3]> {
        let up = self.cap.points.len() as u32;
        let Cap { triangles, boundary, .. } = &self.cap;
        let bottom = triangles.iter().map(|&[a, b, c]| [a, c, b]);
        let top = triangles.iter().map(move |triangle| triangle.map(|at| at + up));
        let walls = boundary.iter().flat_map(move |&[a, b]| [[a, b, b + up], [a, b + up, a + up]]);
        bottom.chain(top).chain(walls)
    }
}

/// What buildings become.
#[derive(Debug)]
pub struct Solids {
    /// The solids, in the order of their buildings.
    pub solids: Vec<Solid>,
    /// Buildings that became none, by reason.
    pub left_out: LeftOutSolids,
}

/// Makes solids of buildings.
///
/// - A building on the ground stands on what parts on the ground leave of its footprint.
/// - A part stands on its own footprint, from its `min_height` on.
/// - What is elevated floats between `min_height` and its height; where the underside is not
///   known it is a slab 0.3 m thick below its height.
///
/// `flight_height_m` is the one that buildings were classified with. The order of the solids is
/// that of the buildings, with any number of threads.
#[must_use]
pub fn extrude(buildings: &[Building], flight_height_m: f64) -> Solids {
    let parts: Vec<&Building> = buildings.iter().filter(|building| is_part(building)).collect();
    let boxes = parts.iter().map(|part| bounds(&part.footprint)).collect();
    let index = BoxIndex::new(boxes, BLOCK_M);
    let made: Vec<Result<Solid, NoSolid>> = buildings
        .par_iter()
        .map(|building| {
            let Building { footprint, attributes, .. } = building;
            let heights = heights(attributes, flight_height_m);
            if attributes.elevated || attributes.kind == Kind::Part {
                return Solid::new(footprint, &[], heights);
            }
            let near = index.meeting(&bounds(footprint));
            let parts: Vec<_> = near.into_iter().map(|part| &parts[part].footprint).collect();
            Solid::new(footprint, &parts, heights)
        })
        .collect();
    let mut left_out = LeftOutSolids::default();
    let mut solids = Vec::with_capacity(made.len());
    for solid in made {
        match solid {
            Ok(solid) => solids.push(solid),
            Err(NoSolid::NoHeight) => left_out.no_height += 1,
            Err(NoSolid::CoveredByParts) => left_out.covered_by_parts += 1,
            Err(NoSolid::NoArea) => left_out.no_area += 1,
            Err(NoSolid::NotConforming) => left_out.not_closed += 1,
        }
    }
    Solids { solids, left_out }
}

/// Whether a building is a part that replaces outlines where it covers them.
fn is_part(building: &Building) -> bool {
    building.attributes.kind == Kind::Part && !building.attributes.elevated
}

fn bounds(footprint: &MultiPolygon<f64>) -> Rect<f64> {
    footprint.bounding_rect().expect("a footprint has at least one ring")
}

/// Bottom and top of a building, in metres over the ground.
fn heights(attributes: &Attributes, flight_height_m: f64) -> [f32; 2] {
    let Attributes { height_m, min_height_m, elevated, .. } = *attributes;
    let underside_is_unknown = elevated && f64::from(min_height_m) <= flight_height_m;
    let bottom = if underside_is_unknown { (height_m - SLAB_M).max(0.0) } else { min_height_m };
    [bottom, height_m]
}
