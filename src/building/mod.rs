//! Buildings: footprint, height and where the height comes from.

#[cfg(feature = "build")]
mod city;
mod defect;
#[cfg(feature = "build")]
mod groups;
mod height;
#[cfg(feature = "build")]
mod prism;
#[cfg(feature = "build")]
mod tags;

#[cfg(feature = "build")]
pub use city::City;
pub use defect::{Action, Defect, Problem};
#[cfg(feature = "build")]
pub use groups::Named;
pub use height::{HeightSource, parse_length, parse_levels};
#[cfg(feature = "build")]
pub use prism::{Limits, Prism};
#[cfg(feature = "build")]
pub use tags::{
    Attributes, BUILDING, BUILDING_PART, Classified, Kind, Told, classify, told_height,
};

use std::fmt;

#[cfg(feature = "build")]
use geo::MultiPolygon;

/// The OSM object that a building comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ObjectId {
    /// A closed way.
    Way(i64),
    /// A relation.
    Relation(i64),
    /// A node: never a building, but it may carry the tags of one.
    Node(i64),
}

impl fmt::Display for ObjectId {
    /// OSM's short notation: `w123`, `r45`, `n6`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Way(id) => write!(f, "w{id}"),
            Self::Relation(id) => write!(f, "r{id}"),
            Self::Node(id) => write!(f, "n{id}"),
        }
    }
}

/// One building, or one part of a building. A relation whose rings have heights of their own
/// makes one for each height.
#[cfg(feature = "build")]
#[derive(Debug, Clone, PartialEq)]
pub struct Building {
    /// Where it comes from.
    pub object: ObjectId,
    /// What is on the ground, in projected metres. A point is covered if some polygon
    /// covers it; each polygon is taken with the even-odd rule over all its rings, so a
    /// self-intersecting ring and overlapping polygons are both well-defined.
    pub footprint: MultiPolygon<f64>,
    /// What is known about it.
    pub attributes: Attributes,
}
