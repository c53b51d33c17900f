//! What `verify` is asked for.

use std::path::PathBuf;

use clap::{Args, ValueHint};

#[derive(Debug, Args)]
pub(crate) struct VerifyArgs {
    /// A dataset, or the output of another stage
    #[arg(value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) directory: PathBuf,
    /// Build it once more from the recorded inputs, in a temporary directory (TMPDIR), and compare
    /// every file
    #[arg(long)]
    pub(crate) rebuild: bool,
    #[command(flatten)]
    pub(crate) inputs: InputArgs,
}

/// Where the inputs lie that a manifest records by name and SHA-256.
#[derive(Debug, Args)]
#[command(next_help_heading = "Inputs for --rebuild")]
pub(crate) struct InputArgs {
    /// The OSM extracts (.osm.pbf), in any order
    #[arg(long, requires = "rebuild", num_args = 1.., value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub(crate) osm: Vec<PathBuf>,
    /// The directory of radio maps
    #[arg(long, requires = "rebuild", value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) maps: Option<PathBuf>,
    /// The output of `holescout scenes` that the import was given, if it was
    #[arg(long, requires = "rebuild", value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) scenes: Option<PathBuf>,
    /// The tiles, for the output of import-rsrp or scenes
    #[arg(long, requires = "rebuild", value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) tiles: Option<PathBuf>,
    /// The file of sites, for the output of scenes
    #[arg(long, requires = "rebuild", value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub(crate) sites: Option<PathBuf>,
}
