//! Coordinate reference systems: WGS 84 longitude/latitude and its UTM zones.
//!
//! Deliberately nothing else: tiles are metric and local, and one projection
//! that is exact and the same on every machine beats a library of thousands.

mod utm;

pub use utm::{CrsError, Utm};
