//! `[scenes]`: what `scenes` depends on, besides the sections that tiles were made with.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{ConfigError, GridConfig, demand};

/// Where base stations stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Placement {
    /// Over a random cell: over the ground, or over what covers the cell.
    Any,
    /// Over a random cell that a building on the ground covers.
    Roof,
    /// Where a file of sites says.
    File,
}

/// A material of ITU-R P.2040, by the name that Sionna's `ITURadioMaterial` knows it by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[expect(missing_docs, reason = "the names are those of the recommendation")]
pub enum Material {
    Vacuum,
    Concrete,
    Brick,
    Plasterboard,
    Wood,
    Glass,
    CeilingBoard,
    Chipboard,
    Plywood,
    Marble,
    Floorboard,
    Metal,
    VeryDryGround,
    MediumDryGround,
    WetGround,
}

impl Material {
    /// The name used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Vacuum => "vacuum",
            Self::Concrete => "concrete",
            Self::Brick => "brick",
            Self::Plasterboard => "plasterboard",
            Self::Wood => "wood",
            Self::Glass => "glass",
            Self::CeilingBoard => "ceiling_board",
            Self::Chipboard => "chipboard",
            Self::Plywood => "plywood",
            Self::Marble => "marble",
            Self::Floorboard => "floorboard",
            Self::Metal => "metal",
            Self::VeryDryGround => "very_dry_ground",
            Self::MediumDryGround => "medium_dry_ground",
            Self::WetGround => "wet_ground",
        }
    }
}

/// `[scenes]`: scenes for Sionna RT, and the base stations in them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SceneConfig {
    /// Where base stations stand.
    pub placement: Placement,
    /// Random base stations in a scene. A file of sites gives as many as it holds.
    pub base_stations: u32,
    /// Seed of random places. The i-th base station of a tile depends on the seed, the tile and
    /// i alone.
    pub seed: u64,
    /// Height of a base station over the roof that it stands on, in metres, where a file of sites
    /// does not tell.
    pub height_above_m: f64,
    /// Height of a base station on open ground, in metres, where a file of sites does not tell. It
    /// must stand above the receivers: a solver counts rays that cross their plane, and from within
    /// the plane no direct one does.
    pub ground_height_m: f64,
    /// Side of the square around a tile's centre that is to be traced and that base stations
    /// stand in, in metres; by default `grid.crop_m`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub map_size_m: Option<u32>,
    /// Material of walls and roofs.
    pub building_material: Material,
    /// Material of the ground.
    pub ground_material: Material,
}

impl Default for SceneConfig {
    fn default() -> Self {
        Self {
            placement: Placement::Any,
            base_stations: 1,
            seed: 0,
            height_above_m: 2.0,
            ground_height_m: 10.0,
            map_size_m: None,
            building_material: Material::Concrete,
            ground_material: Material::MediumDryGround,
        }
    }
}

impl SceneConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        demand(
            (1..=1000).contains(&self.base_stations),
            "scenes.base_stations",
            self.base_stations,
            "1 to 1000",
        )?;
        demand(
            self.height_above_m > 0.0 && self.height_above_m <= 1000.0,
            "scenes.height_above_m",
            self.height_above_m,
            "more than 0 m and at most 1000 m",
        )?;
        demand(
            self.ground_height_m > 0.0 && self.ground_height_m <= 1000.0,
            "scenes.ground_height_m",
            self.ground_height_m,
            "more than 0 m and at most 1000 m",
        )
    }

    /// Whether base stations on open ground stand above receivers at the flight height of tiles.
    ///
    /// # Errors
    /// [`ConfigError`] if not.
    pub fn check_ground_height(&self, flight_height_m: f64) -> Result<(), ConfigError> {
        let expected =
            format!("more than buildings.flight_height_m = {flight_height_m} of the tiles");
        let height = self.ground_height_m;
        demand(height > flight_height_m, "scenes.ground_height_m", height, expected)
    }

    /// Side of the square that is to be traced, in metres, on tiles of a grid whose maps have
    /// cells of `map_cell_m`.
    ///
    /// # Errors
    /// [`ConfigError`] if such a map could not be imported: it must hold the central window of a
    /// tile, end within the tile, and have whole cells on every side of the window.
    pub fn map_size_m(&self, grid: &GridConfig, map_cell_m: f64) -> Result<u32, ConfigError> {
        let size = self.map_size_m.unwrap_or(grid.crop_m);
        let margin = (f64::from(size) - f64::from(grid.crop_m)) / 2.0;
        let fits = (grid.crop_m..=grid.side_m).contains(&size)
            && (margin / map_cell_m).fract() == 0.0
            && (f64::from(grid.crop_m) / map_cell_m).fract() == 0.0;
        let expected = format!(
            "grid.crop_m = {} to grid.side_m = {} of the tiles, with whole cells of {map_cell_m} m \
             (grid.cell_m x shard.downsample) within and around the window",
            grid.crop_m, grid.side_m
        );
        demand(fits, "scenes.map_size_m", size, expected)?;
        Ok(size)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_that_could_not_be_imported_are_refused() {
        let grid = GridConfig::default();
        let size = |map_size_m| {
            SceneConfig { map_size_m, ..SceneConfig::default() }.map_size_m(&grid, 4.0)
        };
        assert_eq!(size(None), Ok(484));
        assert_eq!(size(Some(492)), Ok(492));
        // The tile itself: 298 cells of 1 m on each side are 74.5 cells of 4 m.
        for wrong in [480, 488, 1080, 1084] {
            let error = size(Some(wrong)).expect_err("no such map");
            assert_eq!((error.key, error.found), ("scenes.map_size_m", wrong.to_string()));
        }
    }

    #[test]
    fn names_of_materials_are_those_of_their_serialisation() {
        let all = [Material::Concrete, Material::CeilingBoard, Material::MediumDryGround];
        for material in all {
            let json = serde_json::to_string(&material).expect("a string");
            assert_eq!(json, format!("\"{}\"", material.name()));
        }
    }
}
