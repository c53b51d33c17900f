//! Tiles: where they lie, what they are called, which of them an area takes.
//!
//! In every array of this project **row 0 is the northernmost and column 0 the
//! westernmost**; all coordinates are UTM metres unless a name says `lon`/`lat`.

mod antimeridian;
mod area;
mod boxes;
mod tile_id;
mod window;

pub use area::{Area, AreaError};
pub use boxes::BoxIndex;
pub use tile_id::{TileId, TileIdError};
pub use window::Window;
