//! Is a scene that was written what its manifest says?

use std::path::Path;

use super::mesh::{Mesh, read_ply};
use super::xml::{BUILDINGS, GROUND};
use crate::manifest::{SceneEntry, SceneMeta, read_scene_file, read_scene_meta};

/// Reads a scene of a directory: digests, description, counts, and that the buildings are closed.
///
/// # Errors
/// What is wrong, in words, the file first.
pub fn check_scene(directory: &Path, entry: &SceneEntry) -> Result<(), String> {
    let SceneMeta { id, base_stations, solids, triangles, .. } =
        read_scene_meta(directory, entry).map_err(|error| error.to_string())?;
    read_scene_file(directory, entry, "scene.xml").map_err(|error| error.to_string())?;
    let buildings = mesh(directory, entry, BUILDINGS)?;
    let ground = mesh(directory, entry, GROUND)?;
    let found = (id, base_stations.len(), solids, triangles);
    let expected = (entry.id, entry.base_stations as usize, entry.solids, entry.triangles);
    demand(found == expected, || {
        format!(
            "scene.json: id, base stations, solids and triangles are {found:?}, the manifest says {expected:?}"
        )
    })?;
    let count = buildings.triangles.len();
    demand(count as u64 == triangles, || {
        format!("{BUILDINGS}: {count} triangles, the manifest says {triangles}")
    })?;
    demand(buildings.is_closed(), || format!("{BUILDINGS}: the mesh is not closed"))?;
    let floats = buildings.vertices.iter().chain(&ground.vertices).flatten();
    demand(floats.copied().all(f32::is_finite), || "a vertex is not finite".to_owned())
}

fn mesh(directory: &Path, entry: &SceneEntry, name: &str) -> Result<Mesh, String> {
    let bytes = read_scene_file(directory, entry, name).map_err(|error| error.to_string())?;
    read_ply(&bytes).map_err(|error| format!("{name}: {error}"))
}

fn demand(holds: bool, otherwise: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(otherwise()) }
}
