//! The command line. Every option that is also a key of the configuration overrides it.

#![expect(
    clippy::doc_markdown,
    reason = "these comments are the text of --help, where backticks would show"
)]

use std::num::NonZero;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueHint};
use holescout::config::Config;
use holescout::units::Dbm;

const EXIT_CODES: &str = "Exit codes: 0 done, 1 failed while running, 2 wrong usage, \
3 invalid input.";

/// From OpenStreetMap buildings and ray-traced radio maps to coverage-hole datasets.
#[derive(Debug, Parser)]
#[command(version, after_help = EXIT_CODES)]
pub(crate) struct Cli {
    #[command(flatten)]
    pub(crate) common: Common,
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Args)]
pub(crate) struct Common {
    /// Configuration file (TOML); `holescout config` prints all keys
    #[arg(long, global = true, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub(crate) config: Option<PathBuf>,
    /// Threads to use [default: all cores]; the output does not depend on it
    #[arg(long, global = true, value_name = "N")]
    pub(crate) threads: Option<NonZero<usize>>,
    /// Print a summary as one line of JSON, the last line of standard output
    #[arg(long, global = true)]
    pub(crate) json: bool,
    /// No progress on standard error
    #[arg(long, short, global = true)]
    pub(crate) quiet: bool,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Rasterise the buildings of OSM extracts to height grids
    Rasterise(RasteriseArgs),
    /// Import radio maps that a ray tracer produced for rasterised tiles
    ImportRsrp(ImportArgs),
    /// Crop, downsample and write a sharded dataset
    Shard(ShardArgs),
    /// Check every byte of a stage's output, and that it makes sense
    Verify(VerifyArgs),
    /// Show a dataset's figures, or one record as picture or JSON
    Inspect(InspectArgs),
    /// Write the JSON Schemas of all file formats, or check them
    Schemas(SchemasArgs),
    /// Print the configuration, merged from defaults, file and flags
    Config(ConfigArgs),
}

impl Command {
    /// Lets the command's flags override the configuration.
    pub(crate) fn apply(&self, config: &mut Config) {
        match self {
            Self::Rasterise(args) => args.tiles.apply(config),
            Self::ImportRsrp(args) => args.rsrp.apply(config),
            Self::Shard(args) => args.dataset.apply(config),
            Self::Config(args) => {
                args.tiles.apply(config);
                args.rsrp.apply(config);
                args.dataset.apply(config);
            }
            Self::Verify(_) | Self::Inspect(_) | Self::Schemas(_) => {}
        }
    }
}

/// Where a stage writes to.
#[derive(Debug, Args)]
pub(crate) struct OutputArgs {
    /// Directory to fill; it must be new, empty, or an interrupted run of the same inputs
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) out: PathBuf,
    /// Replace an output of this stage that was made from other inputs
    #[arg(long)]
    pub(crate) overwrite: bool,
}

#[derive(Debug, Args)]
pub(crate) struct RasteriseArgs {
    /// OSM extracts (.osm.pbf)
    #[arg(long, required = true, num_args = 1.., value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub(crate) osm: Vec<PathBuf>,
    #[command(flatten)]
    pub(crate) output: OutputArgs,
    /// Only tiles whose centres lie in this box, in degrees
    #[arg(
        long, value_name = "W,S,E,N", value_parser = bbox, allow_hyphen_values = true,
        conflicts_with = "area"
    )]
    pub(crate) bbox: Option<[f64; 4]>,
    /// Only tiles whose centres lie in the polygons of this GeoJSON file
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub(crate) area: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) tiles: TilesFlags,
}

#[derive(Debug, Args)]
pub(crate) struct ImportArgs {
    /// Directory of radio maps: .npz, or .npy with .json beside them
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) maps: PathBuf,
    /// Output of `holescout rasterise`
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) tiles: PathBuf,
    #[command(flatten)]
    pub(crate) output: OutputArgs,
    #[command(flatten)]
    pub(crate) rsrp: RsrpFlags,
}

#[derive(Debug, Args)]
pub(crate) struct ShardArgs {
    /// Output of `holescout rasterise`
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) tiles: PathBuf,
    /// Output of `holescout import-rsrp` for these tiles
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) rsrp: PathBuf,
    #[command(flatten)]
    pub(crate) output: OutputArgs,
    #[command(flatten)]
    pub(crate) dataset: DatasetFlags,
}

#[derive(Debug, Args)]
pub(crate) struct VerifyArgs {
    /// A dataset, or the output of `rasterise` or `import-rsrp`
    #[arg(value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) directory: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct InspectArgs {
    /// A dataset
    #[arg(value_name = "DATASET", value_hint = ValueHint::DirPath)]
    pub(crate) dataset: PathBuf,
    /// Show this record
    #[arg(long, value_name = "TILE")]
    pub(crate) id: Option<String>,
    /// Draw the record: heights, RSRP, coverage holes
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub(crate) png: Option<PathBuf>,
    /// Pixels along a side of a cell in the picture
    #[arg(long, value_name = "N", default_value_t = 3)]
    pub(crate) scale: usize,
    /// Outdoor cells below this are drawn as coverage holes, in dBm [default: -100]
    #[arg(long, value_name = "DBM", allow_hyphen_values = true)]
    pub(crate) hole_threshold: Option<f64>,
    /// Write a table of all records
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub(crate) csv: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct SchemasArgs {
    /// Directory of schemas
    #[arg(long, value_name = "DIR", default_value = "schemas", value_hint = ValueHint::DirPath)]
    pub(crate) out: PathBuf,
    /// Change nothing; fail if a schema there is not that of this program
    #[arg(long)]
    pub(crate) check: bool,
}

#[derive(Debug, Args)]
pub(crate) struct ConfigArgs {
    #[command(flatten)]
    pub(crate) tiles: TilesFlags,
    #[command(flatten)]
    pub(crate) rsrp: RsrpFlags,
    #[command(flatten)]
    pub(crate) dataset: DatasetFlags,
}

/// Flags for `[grid]`, `[buildings]` and `[filter]`.
#[derive(Debug, Args)]
pub(crate) struct TilesFlags {
    /// grid.side_m: side of a tile, in metres
    #[arg(long, value_name = "M")]
    side: Option<u32>,
    /// grid.spacing_m: distance between tile centres, in metres
    #[arg(long, value_name = "M")]
    spacing: Option<u32>,
    /// grid.cell_m: side of a cell, in metres
    #[arg(long, value_name = "M")]
    cell: Option<f64>,
    /// grid.crop_m: side of the central window, in metres
    #[arg(long, value_name = "M")]
    crop: Option<u32>,
    /// grid.epsg: UTM zone as an EPSG code [default: that of the area's middle]
    #[arg(long, value_name = "CODE")]
    epsg: Option<u32>,
    /// buildings.parts: whether building parts replace outlines
    #[arg(long, value_name = "BOOL")]
    parts: Option<bool>,
    /// buildings.default_height_m: height without any tag, in metres
    #[arg(long, value_name = "M")]
    default_height: Option<f64>,
    /// filter.min_buildings: least number of buildings in the tile
    #[arg(long, value_name = "N")]
    min_buildings: Option<u32>,
    /// filter.min_built: least built-up share of the central window, 0 to 1
    #[arg(long, value_name = "F")]
    min_built: Option<f64>,
}

/// Four numbers separated by commas.
fn bbox(text: &str) -> Result<[f64; 4], String> {
    let numbers: Result<Vec<f64>, _> =
        text.split(',').map(|number| number.trim().parse()).collect();
    let four = numbers.ok().and_then(|numbers| <[f64; 4]>::try_from(numbers).ok());
    four.ok_or_else(|| "expected four numbers: west,south,east,north in degrees".to_owned())
}

fn set<T: Clone>(key: &mut T, flag: Option<&T>) {
    if let Some(value) = flag {
        *key = value.clone();
    }
}

impl TilesFlags {
    fn apply(&self, config: &mut Config) {
        let Config { grid, buildings, filter, .. } = config;
        set(&mut grid.side_m, self.side.as_ref());
        set(&mut grid.spacing_m, self.spacing.as_ref());
        set(&mut grid.cell_m, self.cell.as_ref());
        set(&mut grid.crop_m, self.crop.as_ref());
        grid.epsg = self.epsg.or(grid.epsg);
        set(&mut buildings.parts, self.parts.as_ref());
        set(&mut buildings.default_height_m, self.default_height.as_ref());
        set(&mut filter.min_buildings, self.min_buildings.as_ref());
        set(&mut filter.min_built, self.min_built.as_ref());
    }
}

/// Flags for `[rsrp]`.
#[derive(Debug, Args)]
pub(crate) struct RsrpFlags {
    /// rsrp.floor_dbm: what cells without a path hold, in dBm
    #[arg(long, value_name = "DBM", allow_hyphen_values = true)]
    floor: Option<f64>,
    /// rsrp.max_array_mib: larger arrays are rejected unread, in MiB
    #[arg(long, value_name = "MIB")]
    max_array: Option<u32>,
}

impl RsrpFlags {
    fn apply(&self, config: &mut Config) {
        let Config { rsrp, .. } = config;
        set(&mut rsrp.floor_dbm, self.floor.map(Dbm).as_ref());
        set(&mut rsrp.max_array_mib, self.max_array.as_ref());
    }
}

/// Flags for `[shard]` and `[split]`.
#[derive(Debug, Args)]
pub(crate) struct DatasetFlags {
    /// shard.downsample: cells of the height grid along a record's cell
    #[arg(long, value_name = "N")]
    downsample: Option<u32>,
    /// shard.records_per_shard
    #[arg(long, value_name = "N")]
    records_per_shard: Option<u32>,
    /// shard.zstd_level: 1 to 19
    #[arg(long, value_name = "N")]
    zstd_level: Option<i32>,
    /// split.block_m: side of the blocks that splits are drawn by, in metres
    #[arg(long, value_name = "M")]
    block: Option<u32>,
    /// split.seed
    #[arg(long, value_name = "N")]
    split_seed: Option<u64>,
    /// split.val: share of blocks for validation
    #[arg(long, value_name = "F")]
    val: Option<f64>,
    /// split.test: share of blocks for the test
    #[arg(long, value_name = "F")]
    test: Option<f64>,
    /// split.strict: whole tiles of different splits must not overlap either
    #[arg(long, value_name = "BOOL")]
    strict: Option<bool>,
}

impl DatasetFlags {
    fn apply(&self, config: &mut Config) {
        let Config { shard, split, .. } = config;
        set(&mut shard.downsample, self.downsample.as_ref());
        set(&mut shard.records_per_shard, self.records_per_shard.as_ref());
        set(&mut shard.zstd_level, self.zstd_level.as_ref());
        set(&mut split.block_m, self.block.as_ref());
        set(&mut split.seed, self.split_seed.as_ref());
        set(&mut split.val, self.val.as_ref());
        set(&mut split.test, self.test.as_ref());
        set(&mut split.strict, self.strict.as_ref());
    }
}
