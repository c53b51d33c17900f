//! What `scenes` is asked for.

use std::path::PathBuf;

use clap::{Args, ValueEnum, ValueHint};
use holescout::config::{Config, Placement};

use super::{OutputArgs, TaskArgs, set};

#[derive(Debug, Args)]
pub(crate) struct ScenesArgs {
    /// The OSM extracts (.osm.pbf) that the tiles were made from
    #[arg(long, required = true, num_args = 1.., value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub(crate) osm: Vec<PathBuf>,
    /// Output of `holescout rasterise`; its grid and its buildings are taken over
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) tiles: PathBuf,
    /// Base-station sites, for --placement file (implied): CSV with the columns lon, lat (degrees)
    /// and, if you like, height (metres over the ground, or over the roof if on a building),
    /// on_building (true or false; by default whether a building is there) and name; exports of
    /// OpenCellID with or without header. What would stand inside of a building is raised over its
    /// roof (the higher one of mesh and height grid counts), what would stand no higher than the
    /// receivers to --ground-height
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub(crate) sites: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) output: OutputArgs,
    #[command(flatten)]
    pub(super) scene: SceneFlags,
    #[command(flatten)]
    pub(crate) task: TaskArgs,
}

impl ScenesArgs {
    pub(super) fn apply(&self, config: &mut Config) {
        if self.sites.is_some() && self.scene.placement.is_none() {
            config.scenes.placement = Placement::File;
        }
        self.scene.apply(config);
    }
}

/// A placement by name.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum PlacementName {
    /// Over random cells of the height grid, on the ground or on what covers them
    Any,
    /// Over random cells that a building covers
    Roof,
    /// Where --sites says
    File,
}

/// Flags for `[scenes]`.
#[derive(Debug, Args)]
pub(super) struct SceneFlags {
    /// scenes.placement: where base stations stand
    #[arg(long, value_enum, value_name = "NAME")]
    placement: Option<PlacementName>,
    /// scenes.base_stations: random base stations in a scene
    #[arg(long, value_name = "N")]
    base_stations: Option<u32>,
    /// scenes.seed: of their places
    #[arg(long, value_name = "N")]
    scene_seed: Option<u64>,
    /// scenes.height_above_m: height of a base station over its roof, in metres
    #[arg(long, value_name = "M")]
    height_above: Option<f64>,
    /// scenes.ground_height_m: height of a base station on open ground, in metres
    #[arg(long, value_name = "M")]
    ground_height: Option<f64>,
    /// scenes.map_size_m: side of the square to be traced, in metres [default: that of the tiles' window]
    #[arg(long, value_name = "M")]
    map_size: Option<u32>,
}

impl SceneFlags {
    pub(super) fn apply(&self, config: &mut Config) {
        let Config { scenes, .. } = config;
        let placement = self.placement.map(|name| match name {
            PlacementName::Any => Placement::Any,
            PlacementName::Roof => Placement::Roof,
            PlacementName::File => Placement::File,
        });
        set(&mut scenes.placement, placement.as_ref());
        set(&mut scenes.base_stations, self.base_stations.as_ref());
        set(&mut scenes.seed, self.scene_seed.as_ref());
        set(&mut scenes.height_above_m, self.height_above.as_ref());
        set(&mut scenes.ground_height_m, self.ground_height.as_ref());
        scenes.map_size_m = self.map_size.or(scenes.map_size_m);
    }
}
