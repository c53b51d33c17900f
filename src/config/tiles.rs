//! `[grid]`, `[buildings]` and `[filter]`: what `rasterise` depends on.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{ConfigError, demand};

/// `[grid]`: the lattice of tiles and the cells of a height grid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GridConfig {
    /// Side of a tile, in metres.
    pub side_m: u32,
    /// Distance between tile centres in easting and in northing, in metres.
    pub spacing_m: u32,
    /// Side of a cell, in metres.
    pub cell_m: f64,
    /// Side of the central window that becomes a record, in metres.
    pub crop_m: u32,
    /// EPSG code of the UTM zone; by default the zone of the area's centre.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub epsg: Option<u32>,
}

impl Default for GridConfig {
    fn default() -> Self {
        Self { side_m: 1080, spacing_m: 512, cell_m: 1.0, crop_m: 484, epsg: None }
    }
}

impl GridConfig {
    /// Cells along a side of a tile.
    #[must_use]
    pub fn side_cells(&self) -> usize {
        (f64::from(self.side_m) / self.cell_m).round() as usize
    }

    /// Cells along a side of the central window.
    #[must_use]
    pub fn crop_cells(&self) -> usize {
        (f64::from(self.crop_m) / self.cell_m).round() as usize
    }

    /// Cells between the border of a tile and its central window.
    #[must_use]
    pub fn crop_offset_cells(&self) -> usize {
        (self.side_cells() - self.crop_cells()) / 2
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        demand(self.spacing_m > 0, "grid.spacing_m", self.spacing_m, "a positive number")?;
        let epsg = self.epsg.unwrap_or(32601);
        let is_utm = matches!(epsg, 32601..=32660 | 32701..=32760);
        demand(
            is_utm,
            "grid.epsg",
            epsg,
            "a UTM zone on WGS 84, 32601 to 32660 or 32701 to 32760",
        )?;
        demand(
            self.cell_m >= 0.1 && self.cell_m <= 100.0,
            "grid.cell_m",
            self.cell_m,
            "0.1 to 100 metres",
        )?;
        let whole = |length: f64| (length / self.cell_m).fract() == 0.0;
        demand(
            self.side_m > 0 && whole(self.side_m.into()) && self.side_cells() <= 16_384,
            "grid.side_m",
            self.side_m,
            format!("a whole number of cells of {} m, at most 16384", self.cell_m),
        )?;
        demand(
            self.crop_m > 0
                && self.crop_m <= self.side_m
                && whole(self.crop_m.into())
                && whole(f64::from(self.side_m - self.crop_m) / 2.0),
            "grid.crop_m",
            self.crop_m,
            format!(
                "at most side_m = {} and centred on whole cells of {} m",
                self.side_m, self.cell_m
            ),
        )
    }
}

/// `[buildings]`: what counts as a building, and heights that OSM does not tell.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BuildingsConfig {
    /// Let `building:part=*` replace the outline's height where parts cover it
    /// (OSM wiki, "Simple 3D Buildings").
    pub parts: bool,
    /// Height of the flying vehicle and of the receivers, in metres. What begins above it
    /// (skyways, canopies) does not block, and what is lower is no obstacle.
    pub flight_height_m: f64,
    /// Height of one level, in metres, where only `building:levels` is known.
    pub level_height_m: f64,
    /// Heights above this are taken for mistakes, in metres.
    pub max_height_m: f64,
    /// Height without any tag, in metres: a guess.
    pub default_height_m: f64,
    /// Heights by value of `building` without any other tag, in metres: guesses. A table given
    /// in a file replaces this one as a whole.
    pub default_heights_m: BTreeMap<String, f64>,
    /// Licence of the extract, as an SPDX identifier.
    pub licence: String,
    /// Attribution that the licence asks for.
    pub attribution: String,
}

impl Default for BuildingsConfig {
    fn default() -> Self {
        let low = ["carport", "garage", "garages", "hut", "shed"].map(|kind| (kind, 2.5));
        let one_level = ["bungalow", "greenhouse", "kiosk", "service"].map(|kind| (kind, 3.0));
        let table = low.into_iter().chain(one_level);
        Self {
            parts: true,
            flight_height_m: 2.0,
            level_height_m: 3.0,
            max_height_m: 1000.0,
            default_height_m: 6.0,
            default_heights_m: table.map(|(kind, height)| (kind.to_owned(), height)).collect(),
            licence: "ODbL-1.0".to_owned(),
            attribution: "© OpenStreetMap contributors".to_owned(),
        }
    }
}

impl BuildingsConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        demand(
            self.flight_height_m >= 0.0 && self.flight_height_m.is_finite(),
            "buildings.flight_height_m",
            self.flight_height_m,
            "0 m or more",
        )?;
        demand(
            self.level_height_m > 0.0 && self.level_height_m < 20.0,
            "buildings.level_height_m",
            self.level_height_m,
            "more than 0 m and less than 20 m",
        )?;
        let max = self.max_height_m;
        demand(max > 0.0 && max <= 10_000.0, "buildings.max_height_m", max, "0 to 10000 m")?;
        let plausible = |height: f64| height > 0.0 && height <= max;
        demand(
            plausible(self.default_height_m),
            "buildings.default_height_m",
            self.default_height_m,
            format!("more than 0 m and at most {max} m"),
        )?;
        for (kind, &height) in &self.default_heights_m {
            demand(
                plausible(height),
                "buildings.default_heights_m",
                format!("{height} for {kind}"),
                format!("more than 0 m and at most {max} m"),
            )?;
        }
        Ok(())
    }
}

/// `[filter]`: tiles that are too empty to be of use are left out, and listed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FilterConfig {
    /// Least number of buildings with a cell in the tile.
    pub min_buildings: u32,
    /// Least share of the central window's cells that are built up, 0 to 1.
    pub min_built: f64,
}

impl Default for FilterConfig {
    fn default() -> Self {
        Self { min_buildings: 20, min_built: 0.05 }
    }
}

impl FilterConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        demand(
            (0.0..=1.0).contains(&self.min_built),
            "filter.min_built",
            self.min_built,
            "a share from 0 to 1",
        )
    }
}
