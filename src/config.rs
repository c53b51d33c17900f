//! The configuration: one type a section of the TOML file, with the defaults.
//!
//! Plain data and its validation. It sits low in the import order because every
//! manifest records the sections that made it. Unknown keys are errors.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::units::Dbm;

/// A value of the configuration that cannot be used.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("configuration: {key} is {found}, expected {expected}")]
pub struct ConfigError {
    /// The key, as `section.key`.
    pub key: &'static str,
    /// What was given.
    pub found: String,
    /// What is possible.
    pub expected: String,
}

impl crate::error::HasFault for ConfigError {
    fn fault(&self) -> crate::error::Fault {
        crate::error::Fault::Input
    }
}

fn demand(
    holds: bool,
    key: &'static str,
    found: impl std::fmt::Display,
    expected: impl std::fmt::Display,
) -> Result<(), ConfigError> {
    if holds {
        Ok(())
    } else {
        Err(ConfigError {
            key,
            found: found.to_string(),
            expected: expected.to_string(),
        })
    }
}

/// All sections.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Tiles and their lattice.
    pub grid: GridConfig,
    /// Which buildings count, and how high they are.
    pub buildings: BuildingsConfig,
    /// Which tiles are urban enough.
    pub filter: FilterConfig,
    /// Import of radio maps.
    pub rsrp: RsrpConfig,
    /// Records and shards.
    pub shard: ShardConfig,
    /// Train, validation and test.
    pub split: SplitConfig,
}

impl Config {
    /// Checks every value and every relation between values.
    ///
    /// # Errors
    /// The first [`ConfigError`] found, in the order of the sections.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.grid.validate()?;
        self.buildings.validate()?;
        self.filter.validate()?;
        self.rsrp.validate()?;
        self.shard.validate(&self.grid)?;
        self.split.validate()
    }
}

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
        Self {
            side_m: 1080,
            spacing_m: 512,
            cell_m: 1.0,
            crop_m: 484,
            epsg: None,
        }
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

    fn validate(&self) -> Result<(), ConfigError> {
        demand(
            self.spacing_m > 0,
            "grid.spacing_m",
            self.spacing_m,
            "a positive number",
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
            format!(
                "a whole number of cells of {} m, at most 16384",
                self.cell_m
            ),
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
    /// Heights by value of `building` without any other tag, in metres: guesses.
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
            default_heights_m: table
                .map(|(kind, height)| (kind.to_owned(), height))
                .collect(),
            licence: "ODbL-1.0".to_owned(),
            attribution: "© OpenStreetMap contributors".to_owned(),
        }
    }
}

impl BuildingsConfig {
    fn validate(&self) -> Result<(), ConfigError> {
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
        demand(
            max > 0.0 && max <= 10_000.0,
            "buildings.max_height_m",
            max,
            "0 to 10000 m",
        )?;
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
        Self {
            min_buildings: 20,
            min_built: 0.05,
        }
    }
}

impl FilterConfig {
    fn validate(&self) -> Result<(), ConfigError> {
        demand(
            (0.0..=1.0).contains(&self.min_built),
            "filter.min_built",
            self.min_built,
            "a share from 0 to 1",
        )
    }
}

/// `[rsrp]`: import of radio maps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RsrpConfig {
    /// What cells without a path hold, in dBm. The mask tells them apart, so a trainer
    /// may choose another floor without importing again.
    pub floor_dbm: Dbm,
    /// Larger files are refused before anything is allocated, in MiB of decoded array.
    pub max_array_mib: u32,
}

impl Default for RsrpConfig {
    fn default() -> Self {
        Self {
            floor_dbm: Dbm(-160.0),
            max_array_mib: 256,
        }
    }
}

impl RsrpConfig {
    fn validate(&self) -> Result<(), ConfigError> {
        let Dbm(floor) = self.floor_dbm;
        demand(
            (-300.0..=-100.0).contains(&floor),
            "rsrp.floor_dbm",
            floor,
            "a level below every real one, -300 to -100 dBm",
        )?;
        demand(
            (1..=16_384).contains(&self.max_array_mib),
            "rsrp.max_array_mib",
            self.max_array_mib,
            "1 to 16384",
        )
    }
}

/// How several heights become one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum HeightDownsampling {
    /// The highest: no obstacle is lost.
    Max,
    /// The arithmetic mean.
    Mean,
    /// The cell south-east of the block's centre.
    Nearest,
}

/// How several RSRP values become one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RsrpDownsampling {
    /// Mean of the linear powers of the outdoor cells, unreached ones counted as zero:
    /// what a receiver averaging over the cell would measure.
    LinearMean,
    /// Mean in dB of the reached outdoor cells; biased low by about 1 dB.
    MeanDb,
    /// The cell south-east of the block's centre.
    Nearest,
}

/// `[shard]`: records and the files they are stored in.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ShardConfig {
    /// Cells of the height grid along a side of a record's cell.
    pub downsample: u32,
    /// How heights are downsampled.
    pub height: HeightDownsampling,
    /// How RSRP is downsampled.
    pub rsrp: RsrpDownsampling,
    /// Records in a shard; the last one of a split may hold fewer.
    pub records_per_shard: u32,
    /// Zstandard level, 1 to 19.
    pub zstd_level: i32,
    /// Seed of the order of records within a split.
    pub order_seed: u64,
}

impl Default for ShardConfig {
    fn default() -> Self {
        Self {
            downsample: 4,
            height: HeightDownsampling::Max,
            rsrp: RsrpDownsampling::LinearMean,
            records_per_shard: 256,
            zstd_level: 9,
            order_seed: 0,
        }
    }
}

impl ShardConfig {
    /// Side of a record's cell, in metres.
    #[must_use]
    pub fn cell_m(&self, grid: &GridConfig) -> f64 {
        grid.cell_m * f64::from(self.downsample)
    }

    /// Cells along a side of a record.
    #[must_use]
    pub fn record_cells(&self, grid: &GridConfig) -> usize {
        grid.crop_cells() / self.downsample as usize
    }

    fn validate(&self, grid: &GridConfig) -> Result<(), ConfigError> {
        demand(
            self.downsample > 0 && grid.crop_cells().is_multiple_of(self.downsample as usize),
            "shard.downsample",
            self.downsample,
            format!("a divisor of the window's {} cells", grid.crop_cells()),
        )?;
        demand(
            (1..=65_536).contains(&self.records_per_shard),
            "shard.records_per_shard",
            self.records_per_shard,
            "1 to 65536",
        )?;
        demand(
            (1..=19).contains(&self.zstd_level),
            "shard.zstd_level",
            self.zstd_level,
            "1 to 19",
        )
    }
}

/// The part of a dataset that a record belongs to.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// For training.
    Train,
    /// For choosing hyper-parameters and checkpoints.
    Val,
    /// For the final figures only.
    Test,
}

impl Split {
    /// All splits, in the order of their declaration.
    pub const ALL: [Self; 3] = [Self::Train, Self::Val, Self::Test];

    /// The name used for directories and in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Val => "val",
            Self::Test => "test",
        }
    }
}

impl std::fmt::Display for Split {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// A named area whose records all go to one split.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SplitArea {
    /// For people, and for the manifest.
    pub name: String,
    /// The split of every record whose centre lies inside.
    pub split: Split,
    /// West, south, east, north, in degrees (WGS 84).
    pub bbox: [f64; 4],
}

/// `[split]`: spatial blocks are drawn, not single tiles, so that no street of the
/// test split is seen in training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SplitConfig {
    /// Side of a block, in metres.
    pub block_m: u32,
    /// Seed of the draw.
    pub seed: u64,
    /// Share of blocks for validation, 0 to 1.
    pub val: f64,
    /// Share of blocks for the test, 0 to 1; training takes the rest.
    pub test: f64,
    /// Also drop records whose whole tiles, not only their windows, overlap across splits.
    pub strict: bool,
    /// Areas with a split of their own; the first that contains a record decides.
    pub areas: Vec<SplitArea>,
}

impl Default for SplitConfig {
    fn default() -> Self {
        Self {
            block_m: 4096,
            seed: 0,
            val: 0.1,
            test: 0.1,
            strict: false,
            areas: Vec::new(),
        }
    }
}

impl SplitConfig {
    fn validate(&self) -> Result<(), ConfigError> {
        demand(
            self.block_m > 0,
            "split.block_m",
            self.block_m,
            "a positive number",
        )?;
        let share = |value: f64| (0.0..=1.0).contains(&value);
        demand(
            share(self.val),
            "split.val",
            self.val,
            "a share from 0 to 1",
        )?;
        demand(
            share(self.test) && self.val + self.test <= 1.0,
            "split.test",
            self.test,
            "a share from 0 to 1 - val",
        )?;
        for area in &self.areas {
            let [west, south, east, north] = area.bbox;
            demand(
                west < east && south < north,
                "split.areas",
                format!("{:?} for {:?}", area.bbox, area.name),
                "west < east and south < north",
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid_and_give_the_papers_grid() {
        let config = Config::default();
        config.validate().expect("defaults are valid");
        assert_eq!(config.grid.side_cells(), 1080);
        assert_eq!(config.grid.crop_offset_cells(), 298);
        assert_eq!(config.shard.record_cells(&config.grid), 121);
    }

    #[test]
    fn unknown_keys_are_refused() {
        let error = toml::from_str::<Config>("[grid]\nspacing = 5\n").expect_err("no such key");
        assert!(error.to_string().contains("spacing"), "{error}");
    }

    #[test]
    fn impossible_values_are_named() {
        let mut broken: Vec<Config> = vec![Config::default(); 9];
        broken[0].grid.crop_m = 2000;
        broken[1].grid.cell_m = 0.0;
        broken[2].shard.downsample = 5;
        broken[3].split.test = 0.95;
        broken[4].filter.min_built = -0.1;
        broken[5].rsrp.floor_dbm = Dbm(0.0);
        broken[6]
            .buildings
            .default_heights_m
            .insert("house".into(), f64::NAN);
        broken[7].grid.crop_m = 483;
        broken[8].split.areas.push(SplitArea {
            name: "empty".into(),
            split: Split::Test,
            bbox: [1.0, 0.0, 0.0, 1.0],
        });
        let keys = broken
            .iter()
            .map(|config| config.validate().expect_err("invalid").key);
        assert_eq!(
            keys.collect::<Vec<_>>(),
            [
                "grid.crop_m",
                "grid.cell_m",
                "shard.downsample",
                "split.test",
                "filter.min_built",
                "rsrp.floor_dbm",
                "buildings.default_heights_m",
                "grid.crop_m",
                "split.areas"
            ]
        );
    }
}
