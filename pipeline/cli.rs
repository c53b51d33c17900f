//! The command line. Every option that is also a key of the configuration overrides it.

#![expect(
    clippy::doc_markdown,
    reason = "these comments are the text of --help, where backticks would show"
)]

use std::ffi::OsString;
use std::num::NonZero;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand, ValueEnum, ValueHint};
use holescout::config::{Config, Method};
use holescout::units::Dbm;

use crate::failure::PERMANENT;

mod release;
mod remote;
mod rsrp;
mod scenes;
mod task;
#[cfg(feature = "torch")]
mod train;
mod verify;

pub(crate) use release::{DiffArgs, ReleaseArgs};
pub(crate) use remote::RemoteFlags;
pub(crate) use rsrp::RsrpFlags;
pub(crate) use scenes::ScenesArgs;
pub(crate) use task::TaskArgs;
#[cfg(feature = "torch")]
pub(crate) use train::{DeviceName, ExportPolicyArgs, TrainArgs};
pub(crate) use verify::{InputArgs, VerifyArgs};

const EXIT_CODES: &str = "Exit codes: 0 done, 1 failed while running, 2 wrong usage, \
3 invalid input; of tasks (--task-count) 42 instead of 2 and 3: permanent, do not retry.";

/// Prints what clap has to say, be it help or an error, and exits.
pub(crate) fn report_usage(error: &clap::Error) -> ExitCode {
    // Nobody is left to tell when that fails.
    let _ = error.print();
    let is_task = |arg: OsString| {
        let arg = arg.to_string_lossy().into_owned();
        arg.starts_with("--task-") || arg == "--merge"
    };
    match error.exit_code() {
        0 => ExitCode::SUCCESS,
        _ if std::env::args_os().any(is_task) => ExitCode::from(PERMANENT),
        _ => ExitCode::from(2),
    }
}

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
    /// Write scenes for Sionna RT: the buildings of each tile as closed meshes, and base stations
    Scenes(ScenesArgs),
    /// Import radio maps that a ray tracer produced for rasterised tiles
    ImportRsrp(ImportArgs),
    /// Crop, downsample and write a sharded dataset
    Shard(ShardArgs),
    /// Check every byte of a stage's output, and that it makes sense
    Verify(VerifyArgs),
    /// Show a dataset's figures, or one record as picture or JSON
    Inspect(InspectArgs),
    /// Write a dataset as it is published: with a version, card, pictures, Croissant
    Release(ReleaseArgs),
    /// Write a dataset in a format of others: Parquet, for pandas, Polars, Hugging Face datasets
    Export(ExportArgs),
    /// Say what changed between two datasets or releases, and which version that asks for
    Diff(DiffArgs),
    /// Judge methods on a dataset: precision and recall, with intervals, and a report
    Evaluate(EvaluateArgs),
    /// Train a Q-network on a dataset by Double DQN; goes on from the last checkpoint
    #[cfg(feature = "torch")]
    Train(TrainArgs),
    /// Write a policy to be given away: weights, a manifest, a card that tells how to use it
    #[cfg(feature = "torch")]
    ExportPolicy(ExportPolicyArgs),
    /// Write the JSON Schemas of all file formats, or check them
    Schemas(SchemasArgs),
    /// Print the configuration, merged from defaults, file and flags
    Config(Box<ConfigArgs>),
}

impl Command {
    /// Whether this run is one of several that build an output together, or merges their parts.
    pub(crate) fn is_task(&self) -> bool {
        match self {
            Self::Rasterise(args) => args.task.is_given(),
            Self::Scenes(args) => args.task.is_given(),
            Self::ImportRsrp(args) => args.task.is_given(),
            Self::Shard(args) => args.task.is_given(),
            _ => false,
        }
    }

    /// Lets the command's flags override the configuration.
    pub(crate) fn apply(&self, config: &mut Config) {
        match self {
            Self::Rasterise(args) => args.tiles.apply(config),
            Self::Scenes(args) => args.apply(config),
            Self::ImportRsrp(args) => {
                args.rsrp.apply(config);
                config.rsrp.strict |= args.strict;
            }
            Self::Shard(args) => args.dataset.apply(config),
            Self::Evaluate(args) => {
                args.remote.apply(config);
                args.judging.apply(config);
                let methods = &mut config.evaluate.methods;
                if args.policy.is_some() && !methods.contains(&Method::Agent) {
                    methods.push(Method::Agent);
                }
            }
            #[cfg(feature = "torch")]
            Self::Train(args) => {
                args.remote.apply(config);
                args.training.apply(config);
            }
            Self::Config(args) => {
                args.tiles.apply(config);
                args.scene.apply(config);
                args.rsrp.apply(config);
                args.dataset.apply(config);
                args.judging.apply(config);
            }
            #[cfg(feature = "torch")]
            Self::ExportPolicy(_) => {}
            Self::Inspect(args) => args.remote.apply(config),
            Self::Export(args) => args.remote.apply(config),
            Self::Verify(_) | Self::Release(_) | Self::Diff(_) | Self::Schemas(_) => {}
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
    #[command(flatten)]
    pub(crate) task: TaskArgs,
}

#[derive(Debug, Args)]
pub(crate) struct ImportArgs {
    /// Directory of radio maps: .npz, or .npy with .json beside them
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) maps: PathBuf,
    /// Output of `holescout rasterise`
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) tiles: PathBuf,
    /// Output of `holescout scenes`, for the transmitters of maps that do not tell them
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) scenes: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) output: OutputArgs,
    #[command(flatten)]
    pub(crate) rsrp: RsrpFlags,
    /// rsrp.strict: reject maps for warnings too, and fail if any map is rejected
    #[arg(long)]
    pub(crate) strict: bool,
    #[command(flatten)]
    pub(crate) task: TaskArgs,
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
    #[command(flatten)]
    pub(crate) task: TaskArgs,
}

#[derive(Debug, Args)]
pub(crate) struct InspectArgs {
    /// A dataset: a directory, or an address (feature remote)
    #[arg(value_name = "DATASET", value_hint = ValueHint::DirPath)]
    pub(crate) dataset: PathBuf,
    #[command(flatten)]
    pub(crate) remote: RemoteFlags,
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
pub(crate) struct ExportArgs {
    /// A dataset: a directory, or an address (feature remote)
    #[arg(value_name = "DATASET", value_hint = ValueHint::DirPath)]
    pub(crate) dataset: PathBuf,
    #[command(flatten)]
    pub(crate) remote: RemoteFlags,
    /// Directory to fill with Parquet files; it must be new, empty, or an interrupted run of the same dataset
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) parquet: PathBuf,
    /// Replace an export of another dataset
    #[arg(long)]
    pub(crate) overwrite: bool,
}

#[derive(Debug, Args)]
pub(crate) struct EvaluateArgs {
    /// A dataset: a directory, or an address (feature remote)
    #[arg(long, value_name = "DATASET", value_hint = ValueHint::DirPath)]
    pub(crate) dataset: PathBuf,
    #[command(flatten)]
    pub(crate) remote: RemoteFlags,
    /// Which of its splits
    #[arg(long, value_enum, default_value_t = SplitChoice::Test)]
    pub(crate) split: SplitChoice,
    /// A checkpoint to evaluate as the method `agent`, for instance RUN/best (feature torch)
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) policy: Option<PathBuf>,
    /// Where the policy is computed: auto takes a graphics card if there is one
    #[cfg(feature = "torch")]
    #[arg(long, value_enum, value_name = "DEVICE", default_value = "auto")]
    pub(crate) device: DeviceName,
    #[command(flatten)]
    pub(crate) output: OutputArgs,
    #[command(flatten)]
    pub(crate) judging: JudgingFlags,
}

/// A split of a dataset, or all of them.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum SplitChoice {
    Train,
    Val,
    Test,
    All,
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
    scene: scenes::SceneFlags,
    #[command(flatten)]
    pub(crate) rsrp: RsrpFlags,
    #[command(flatten)]
    pub(crate) dataset: DatasetFlags,
    #[command(flatten)]
    pub(crate) judging: JudgingFlags,
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

/// Flags for `[rl]` and `[evaluate]`.
#[derive(Debug, Args)]
pub(crate) struct JudgingFlags {
    /// rl.hole_threshold_dbm: outdoor cells below this are coverage holes, in dBm
    #[arg(long, value_name = "DBM", allow_hyphen_values = true)]
    threshold: Option<f64>,
    /// rl.flight_height_m: cells at least this high are occupied, in metres
    #[arg(long, value_name = "M")]
    flight_height: Option<f64>,
    /// rl.reach_cells: cells that one step may lead in each direction
    #[arg(long, value_name = "N")]
    reach: Option<u32>,
    /// evaluate.methods, for instance rsp,bnp-8,g-rsp,random-walk,oracle
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    methods: Option<Vec<Method>>,
    /// evaluate.starts: random starts on each map
    #[arg(long, value_name = "N")]
    starts: Option<u32>,
    /// evaluate.steps: numbers of steps to judge after
    #[arg(long, value_name = "K", value_delimiter = ',')]
    steps: Option<Vec<u32>>,
    /// evaluate.seed
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// evaluate.bootstrap: resamples for the 95 % intervals
    #[arg(long, value_name = "N")]
    bootstrap: Option<u32>,
    /// evaluate.gradient_rate: update rate of gradient descent, in cells per dB per cell
    #[arg(long, value_name = "F")]
    gradient_rate: Option<f64>,
    /// evaluate.gradient_smoothing_cells: smoothing before the gradient is taken, in cells
    #[arg(long, value_name = "CELLS")]
    gradient_smoothing: Option<f64>,
    /// evaluate.noise_db: standard deviation of the error of measured levels, in dB
    #[arg(long, value_name = "DB")]
    noise: Option<f64>,
    /// evaluate.stale_share: share of the buildings that the stored map lacks
    #[arg(long, value_name = "F")]
    stale: Option<f64>,
}

impl JudgingFlags {
    fn apply(&self, config: &mut Config) {
        let Config { rl, evaluate, .. } = config;
        set(&mut rl.hole_threshold_dbm, self.threshold.map(Dbm).as_ref());
        set(&mut rl.flight_height_m, self.flight_height.as_ref());
        set(&mut rl.reach_cells, self.reach.as_ref());
        set(&mut evaluate.methods, self.methods.as_ref());
        set(&mut evaluate.starts, self.starts.as_ref());
        set(&mut evaluate.steps, self.steps.as_ref());
        set(&mut evaluate.seed, self.seed.as_ref());
        set(&mut evaluate.bootstrap, self.bootstrap.as_ref());
        set(&mut evaluate.gradient_rate, self.gradient_rate.as_ref());
        set(&mut evaluate.gradient_smoothing_cells, self.gradient_smoothing.as_ref());
        set(&mut evaluate.noise_db, self.noise.as_ref());
        set(&mut evaluate.stale_share, self.stale.as_ref());
    }
}
