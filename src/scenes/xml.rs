//! Mitsuba XML as `sionna.rt.load_scene` reads it.

use std::fmt::Write;

use crate::config::Material;

/// Names of the meshes beside `scene.xml`.
pub(super) const BUILDINGS: &str = "buildings.ply";
pub(super) const GROUND: &str = "ground.ply";

/// Thickness of walls and roofs, in metres: what sets the reflection of a slab in ITU-R P.2040.
/// The maps in `fixtures/` were traced with it.
const WALL_M: f64 = 0.3;

/// The text of `scene.xml`. Sionna takes an empty mesh for a mistake: without buildings their mesh
/// is not named.
pub(super) fn scene_xml(buildings: Option<Material>, ground: Material) -> String {
    let mut materials = String::new();
    let mut shapes = String::new();
    if let Some(material) = buildings {
        let id = format!("mat-itu_{}", material.name());
        materials += &bsdf(&id, material, Some(WALL_M));
        shapes += &shape("mesh-buildings", BUILDINGS, &id);
    }
    // Shapes of one BSDF would be melted into one object, so the ground has its own.
    let suffix = if buildings == Some(ground) { "_ground" } else { "" };
    let id = format!("mat-itu_{}{suffix}", ground.name());
    materials += &bsdf(&id, ground, None);
    shapes += &shape("mesh-ground", GROUND, &id);
    format!("<scene version=\"2.1.0\">\n{materials}{shapes}</scene>\n")
}

fn bsdf(id: &str, material: Material, thickness_m: Option<f64>) -> String {
    let mut text = format!("  <bsdf type=\"itu-radio-material\" id=\"{id}\">\n");
    let name = material.name();
    writeln!(text, "    <string name=\"type\" value=\"{name}\"/>").expect("memory is enough");
    if let Some(thickness) = thickness_m {
        writeln!(text, "    <float name=\"thickness\" value=\"{thickness}\"/>")
            .expect("memory is enough");
    }
    text + "  </bsdf>\n"
}

fn shape(id: &str, file: &str, material: &str) -> String {
    // Without face normals Mitsuba would compute vertex normals that nobody uses.
    format!(
        "  <shape type=\"ply\" id=\"{id}\">\n    <string name=\"filename\" value=\"{file}\"/>\n    \
         <boolean name=\"face_normals\" value=\"true\"/>\n    \
         <ref name=\"bsdf\" id=\"{material}\"/>\n  </shape>\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use Material::{Concrete, MediumDryGround};

    #[test]
    fn buildings_and_ground_have_a_material_each() {
        let ids = |text: &str| -> Vec<String> {
            let bsdfs = text.lines().filter(|line| line.contains("<bsdf"));
            bsdfs.filter_map(|line| line.split('"').nth(3)).map(str::to_owned).collect()
        };
        let text = scene_xml(Some(Concrete), MediumDryGround);
        assert_eq!(ids(&text), ["mat-itu_concrete", "mat-itu_medium_dry_ground"]);
        assert_eq!(text.matches("<shape").count(), 2);
        assert!(text.contains("thickness\" value=\"0.3\""), "{text}");
        let same = scene_xml(Some(Concrete), Concrete);
        assert_eq!(ids(&same), ["mat-itu_concrete", "mat-itu_concrete_ground"]);
    }

    #[test]
    fn a_scene_without_buildings_names_no_mesh_of_them() {
        let text = scene_xml(None, Concrete);
        assert!(!text.contains("buildings") && text.matches("<shape").count() == 1, "{text}");
    }
}
