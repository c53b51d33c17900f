//! Building footprints to height grids, tile by tile.
//!
//! A cell belongs to a footprint if its centre is inside (even-odd): the rule of
//! `gdal_rasterize` without `ALL_TOUCHED`. A cell's value depends on its place alone, so
//! tiles that overlap agree, whatever area they were built from.

mod blocks;
mod pack;
mod scanline;
mod stage;
mod tile;
mod tile_source;
mod unseen;

pub use scanline::Scanline;
pub use stage::{RasteriseError, RasteriseJob, rasterise};
pub use tile::{HeightGrid, rasterise_tile};
pub use tile_source::TileSource;
