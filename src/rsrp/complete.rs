//! What a foreign producer did not write: from the configuration, the file's name, its arrays.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Value, json};

use super::metadata::{Object, is_given};
use crate::config::Preset;
use crate::grid::TileId;
use crate::manifest::{SceneEntry, ScenesManifest, StageFileError, read_scene_meta};

/// What is put where metadata have no value. What is written always counts more.
#[derive(Debug, Clone, Copy, Default)]
pub struct Supplement<'a> {
    /// The producer's habits.
    pub preset: Option<Preset>,
    /// `[rsrp.assume]`: values by key of the metadata.
    pub assume: Option<&'a BTreeMap<String, Value>>,
    /// What the scenes of tiles tell, by the same keys.
    pub scenes: Option<&'a BTreeMap<TileId, Object>>,
}

/// What the arrays of a file tell of its metadata.
#[derive(Debug, Clone, Default)]
pub(super) struct ArrayFacts {
    /// Name of the array of values.
    pub(super) name: Option<String>,
    /// Cells along a side.
    pub(super) cells: Option<usize>,
    /// Positions of transmitters from the map's south-west corner, in metres.
    pub(super) tx_from_corner: Option<Vec<[f64; 3]>>,
}

impl Supplement<'_> {
    /// Whether anything is to be added at all. Without, metadata are complete or rejected.
    pub(super) fn is_active(&self) -> bool {
        let assumes = self.assume.is_some_and(|assume| !assume.is_empty());
        assumes || self.preset.is_some() || self.scenes.is_some()
    }

    /// Adds what is missing, and returns the keys that were added, sorted.
    pub(super) fn complete(
        &self,
        object: &mut Object,
        path: &Path,
        facts: &ArrayFacts,
    ) -> Vec<String> {
        let mut added = Vec::new();
        let mut add = |object: &mut Object, key: &str, value: Value| {
            if !is_given(object, key) {
                object.insert(key.to_owned(), value);
                added.push(key.to_owned());
            }
        };
        if let Some(id) = tile_in_name(path) {
            add(object, "location_id", json!(id.to_string()));
        }
        let location = object.get("location_id").and_then(Value::as_str);
        let tile = location.and_then(|name| name.parse::<TileId>().ok());
        let scene = self.scenes.zip(tile).and_then(|(scenes, tile)| scenes.get(&tile));
        for (key, value) in scene.into_iter().flatten() {
            add(object, key, value.clone());
        }
        for (key, value) in self.assume.into_iter().flatten() {
            add(object, key, value.clone());
        }
        for (key, value) in self.preset.into_iter().flat_map(|preset| habits(preset, facts)) {
            add(object, key, value);
        }
        if let Some(id) = tile {
            add(object, "map_center_m", json!(id.center()));
            add(object, "crs", json!(id.utm.epsg()));
        }
        let number = |object: &Object, key: &str| object.get(key).and_then(Value::as_f64);
        if let Some(cells) = facts.cells {
            if let Some(cell) = number(object, "cell_size_m") {
                add(object, "map_size_m", json!(cell * cells as f64));
            } else if let Some(size) = number(object, "map_size_m") {
                add(object, "cell_size_m", json!(size / cells as f64));
            }
        }
        if let (Some(positions), Some(size)) = (&facts.tx_from_corner, number(object, "map_size_m"))
        {
            let centred = |&[x, y, z]: &[f64; 3]| [x - size / 2.0, y - size / 2.0, z];
            let positions: Vec<[f64; 3]> = positions.iter().map(centred).collect();
            add(object, "tx_position_m", json!(positions));
        }
        added.sort_unstable();
        added
    }
}

/// What the format of a producer settles; what its users choose is theirs to tell.
fn habits(preset: Preset, facts: &ArrayFacts) -> Vec<(&'static str, Value)> {
    match preset {
        Preset::Sionna => {
            let south_first = [("row_order", json!("south_first")), ("no_path_value", json!(0.0))];
            let rss =
                (facts.name.as_deref() == Some("rss")).then(|| ("value_kind", json!("rss_w")));
            south_first.into_iter().chain(rss).collect()
        }
        Preset::Geo2sigmap => vec![
            ("value_kind", json!("path_gain_linear")),
            ("row_order", json!("north_first")),
            ("no_path_value", json!([0.0, "-inf", "nan"])),
        ],
        Preset::LargeRadioMaps => vec![
            ("value_kind", json!("path_gain_linear")),
            ("row_order", json!("south_first")),
            ("no_path_value", json!(0.0)),
        ],
    }
}

/// What scenes tell of the maps that were traced from them, by tile: who transmits from where, and
/// at which height it is received.
///
/// # Errors
/// [`StageFileError`] if a scene is not what its manifest says.
pub(super) fn scene_facts(
    directory: &Path,
    manifest: &ScenesManifest,
) -> Result<BTreeMap<TileId, Object>, StageFileError> {
    let facts = |entry: &SceneEntry| {
        let scene = read_scene_meta(directory, entry)?;
        let positions: Vec<[f64; 3]> =
            scene.base_stations.iter().map(|station| station.position_m).collect();
        let position = match positions[..] {
            [position] => json!(position),
            _ => json!(positions),
        };
        let facts = [("tx_position_m", position), ("rx_height_m", json!(scene.rx_height_m))];
        let facts = facts.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
        Ok((entry.id, facts))
    };
    manifest.scenes.iter().map(facts).collect()
}

/// The tile that a file is named after: `<tile>.npy`, or `<tile>_<anything>.npy`.
fn tile_in_name(path: &Path) -> Option<TileId> {
    const PARTS: usize = 3;
    let stem = path.file_stem()?.to_str()?;
    let end = stem.match_indices('_').nth(PARTS - 1).map_or(stem.len(), |(at, _)| at);
    stem[..end].parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TILE: &str = "utm10n_e590848_n4128256";

    fn completed(supplement: Supplement<'_>, written: Value, facts: &ArrayFacts) -> Object {
        let Value::Object(mut object) = written else { unreachable!("tests pass objects") };
        supplement.complete(&mut object, Path::new(&format!("maps/{TILE}_run2.npy")), facts);
        object
    }

    #[test]
    fn names_tell_the_tile() {
        let tile = |name: &str| tile_in_name(Path::new(name)).map(|id| id.to_string());
        assert_eq!(tile(&format!("{TILE}.npz")).as_deref(), Some(TILE));
        assert_eq!(tile(&format!("a/{TILE}_-244_244_12.5_90.npy")).as_deref(), Some(TILE));
        assert_eq!(tile("rm_00000012.npz"), None);
    }

    #[test]
    fn what_is_written_counts_most_then_what_is_assumed_then_the_preset() {
        let assume = BTreeMap::from([
            ("row_order".to_owned(), json!("north_first")),
            ("cell_size_m".to_owned(), json!(4)),
        ]);
        let supplement =
            Supplement { preset: Some(Preset::Sionna), assume: Some(&assume), scenes: None };
        let facts = ArrayFacts { cells: Some(121), ..ArrayFacts::default() };
        let object = completed(supplement, json!({ "cell_size_m": 2.0 }), &facts);
        assert_eq!(object["cell_size_m"], json!(2.0));
        assert_eq!(object["row_order"], json!("north_first"));
        assert_eq!(object["no_path_value"], json!(0.0));
        assert_eq!(object["location_id"], json!(TILE));
        assert_eq!(object["map_center_m"], json!([590_848.0, 4_128_256.0]));
        assert_eq!(object["map_size_m"], json!(242.0));
    }

    #[test]
    fn the_scene_of_a_tile_counts_more_than_what_is_assumed_of_all() {
        let tile: TileId = TILE.parse().expect("a tile");
        let facts = serde_json::from_value(json!({ "rx_height_m": 1.5 })).expect("an object");
        let scenes = BTreeMap::from([(tile, facts)]);
        let assume = BTreeMap::from([("rx_height_m".to_owned(), json!(2.0))]);
        let supplement = Supplement { assume: Some(&assume), scenes: Some(&scenes), preset: None };
        let nothing = ArrayFacts::default();
        assert_eq!(completed(supplement, json!({}), &nothing)["rx_height_m"], json!(1.5));
        // Metadata tell which scene it is, not the name of the file.
        let other = json!({ "location_id": "utm10n_e1_n1" });
        assert_eq!(completed(supplement, other, &nothing)["rx_height_m"], json!(2.0));
    }

    #[test]
    fn positions_from_the_corner_become_positions_from_the_centre() {
        let facts = ArrayFacts {
            tx_from_corner: Some(vec![[300.0, 100.0, 30.0]]),
            ..ArrayFacts::default()
        };
        let supplement =
            Supplement { preset: Some(Preset::LargeRadioMaps), ..Supplement::default() };
        let object = completed(supplement, json!({ "map_size_m": 484 }), &facts);
        assert_eq!(object["tx_position_m"], json!([[58.0, -142.0, 30.0]]));
    }
}
