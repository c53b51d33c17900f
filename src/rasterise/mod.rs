//! Building footprints to height grids, tile by tile.
//!
//! A cell belongs to a footprint if its centre is inside (even-odd): the rule of
//! `gdal_rasterize` without `ALL_TOUCHED`. A cell's value depends on its place alone, so
//! tiles that overlap agree, whatever area they were built from.

mod index;
mod scanline;
mod stage;
mod tile;
mod unseen;

pub use index::TileSource;
pub use scanline::Scanline;
pub use stage::{RasteriseError, RasteriseJob, rasterise};
pub use tile::{HeightGrid, rasterise_tile};
