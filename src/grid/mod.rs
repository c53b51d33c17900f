//! Tiles: where they lie, what they are called, which of them an area takes.
//!
//! In every array of this project **row 0 is the northernmost and column 0 the
//! westernmost**; all coordinates are UTM metres unless a name says `lon`/`lat`.

#[cfg(feature = "build")]
mod antimeridian;
#[cfg(feature = "build")]
mod area;
#[cfg(feature = "build")]
mod boxes;
mod tile_id;
mod window;

#[cfg(feature = "build")]
pub use area::{Area, AreaError};
#[cfg(feature = "build")]
pub use boxes::BoxIndex;
pub use tile_id::{TileId, TileIdError};
pub use window::Window;
