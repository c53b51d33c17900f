//! The command line. Every option that is also a key of the configuration overrides it.

use std::num::NonZero;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueHint};
use holescout::config::Config;

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
    /// Print the configuration, merged from defaults, file and flags
    Config(ConfigArgs),
}

impl Command {
    /// Lets the command's flags override the configuration.
    pub(crate) fn apply(&self, config: &mut Config) {
        match self {
            Self::Rasterise(args) => args.tiles.apply(config),
            Self::Config(args) => args.tiles.apply(config),
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
        long,
        value_name = "W,S,E,N",
        value_delimiter = ',',
        num_args = 1,
        allow_hyphen_values = true,
        conflicts_with = "area"
    )]
    pub(crate) bbox: Option<Vec<f64>>,
    /// Only tiles whose centres lie in the polygons of this GeoJSON file
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub(crate) area: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) tiles: TilesFlags,
}

#[derive(Debug, Args)]
pub(crate) struct ConfigArgs {
    #[command(flatten)]
    pub(crate) tiles: TilesFlags,
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

fn set<T: Clone>(key: &mut T, flag: Option<&T>) {
    if let Some(value) = flag {
        *key = value.clone();
    }
}

impl TilesFlags {
    fn apply(&self, config: &mut Config) {
        let Config {
            grid,
            buildings,
            filter,
            ..
        } = config;
        set(&mut grid.side_m, self.side.as_ref());
        set(&mut grid.spacing_m, self.spacing.as_ref());
        set(&mut grid.cell_m, self.cell.as_ref());
        set(&mut grid.crop_m, self.crop.as_ref());
        grid.epsg = self.epsg.or(grid.epsg);
        set(&mut buildings.parts, self.parts.as_ref());
        set(
            &mut buildings.default_height_m,
            self.default_height.as_ref(),
        );
        set(&mut filter.min_buildings, self.min_buildings.as_ref());
        set(&mut filter.min_built, self.min_built.as_ref());
    }
}
