//! `[shard]` and `[split]`: what makes records of tiles and maps.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{ConfigError, GridConfig, demand};

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

    pub(super) fn validate(&self, grid: &GridConfig) -> Result<(), ConfigError> {
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
        demand((1..=19).contains(&self.zstd_level), "shard.zstd_level", self.zstd_level, "1 to 19")
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

impl std::str::FromStr for Split {
    type Err = UnknownSplit;

    fn from_str(name: &str) -> Result<Self, UnknownSplit> {
        let found = Self::ALL.into_iter().find(|split| split.name() == name);
        found.ok_or_else(|| UnknownSplit(name.to_owned()))
    }
}

/// No split has this name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no split: expected train, val or test")]
pub struct UnknownSplit(pub String);

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
        Self { block_m: 4096, seed: 0, val: 0.1, test: 0.1, strict: false, areas: Vec::new() }
    }
}

impl SplitConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        demand(self.block_m > 0, "split.block_m", self.block_m, "a positive number")?;
        let share = |value: f64| (0.0..=1.0).contains(&value);
        demand(share(self.val), "split.val", self.val, "a share from 0 to 1")?;
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
