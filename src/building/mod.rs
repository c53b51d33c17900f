//! Buildings: footprint, height and where the height comes from.

mod defect;
mod height;
mod tags;

pub use defect::{Action, Defect, Problem};
pub use height::{HeightSource, parse_length, parse_levels};
pub use tags::{Attributes, Classified, Kind, classify};

use std::fmt;

use geo::MultiPolygon;

/// The OSM object that a building comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ObjectId {
    /// A closed way.
    Way(i64),
    /// A multipolygon relation.
    Relation(i64),
}

impl fmt::Display for ObjectId {
    /// OSM's short notation: `w123`, `r45`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Way(id) => write!(f, "w{id}"),
            Self::Relation(id) => write!(f, "r{id}"),
        }
    }
}

/// One building, or one part of a building.
#[derive(Debug, Clone, PartialEq)]
pub struct Building {
    /// Where it comes from.
    pub object: ObjectId,
    /// What is on the ground, in projected metres. A point is covered if some polygon
    /// covers it; each polygon is taken with the even-odd rule over all its rings, so a
    /// self-intersecting ring and overlapping polygons are both well-defined.
    pub footprint: MultiPolygon<f64>,
    /// What the tags say.
    pub attributes: Attributes,
}
