//! Scenes for a ray tracer: the buildings around each tile as one closed mesh, the ground, and
//! base stations.
//!
//! Each building becomes a closed prism, once; a scene is the prisms that meet its tile, whole.
//! All planar geometry is decided in integers, so the meshes are watertight by construction and
//! checked to be so. Roofs are flat: `roof:shape` is not looked at, as in the height grid.

mod cap;
mod check;
mod mesh;
mod place;
mod region;
mod sites;
mod solid;
mod stage;
mod xml;

pub use check::check_scene;
pub use mesh::{Mesh, PlyError, ply_bytes, read_ply};
pub use sites::{Site, SitesError, read_sites};
pub use solid::{Solid, Solids, extrude};
pub use stage::{ScenesError, ScenesJob, scenes};
