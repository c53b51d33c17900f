//! `holescout scenes`.

use std::fmt::Write;

use holescout::config::Config;
use holescout::manifest::{LeftOutSolids, ScenesManifest, SitesInput};
use holescout::scenes::{ScenesJob, scenes};
use serde_json::json;

use crate::cli::ScenesArgs;
use crate::console::{Console, Report};
use crate::failure::Failure;
use crate::task;

pub(crate) fn run(
    args: &ScenesArgs,
    config: &Config,
    console: &Console,
) -> Result<Report, Failure> {
    let job = ScenesJob {
        osm: &args.osm,
        tiles: &args.tiles,
        sites: args.sites.as_deref(),
        config,
        out: &args.output.out,
        mode: args.task.mode(args.output.overwrite)?,
    };
    task::report("scenes", scenes(job, console)?, |manifest| {
        Report::new(text(&manifest), &summary(&manifest))
    })
}

fn summary(manifest: &ScenesManifest) -> serde_json::Value {
    json!({
        "stage": "scenes",
        "scenes": manifest.scenes.len(),
        "solids": solids(manifest),
        "triangles": triangles(manifest),
        "base_stations": base_stations(manifest),
        "without_base_station": manifest.without_base_station.len(),
        "left_out": manifest.left_out,
        "sites": manifest.sites,
    })
}

fn solids(manifest: &ScenesManifest) -> u64 {
    manifest.scenes.iter().map(|scene| scene.solids).sum()
}

fn triangles(manifest: &ScenesManifest) -> u64 {
    manifest.scenes.iter().map(|scene| scene.triangles).sum()
}

fn base_stations(manifest: &ScenesManifest) -> u64 {
    manifest.scenes.iter().map(|scene| u64::from(scene.base_stations)).sum()
}

fn text(manifest: &ScenesManifest) -> String {
    let mut text = format!(
        "{} scenes with {} base stations, {} solids, {} triangles\n",
        manifest.scenes.len(),
        base_stations(manifest),
        solids(manifest),
        triangles(manifest),
    );
    let mut line = |line: String| writeln!(text, "{line}").expect("memory is enough");
    let without = manifest.without_base_station.len();
    if without > 0 {
        line(format!(
            "{without} tiles left out: no place for a base station (manifest.json lists them)"
        ));
    }
    if let Some(SitesInput { file, sites, outside, repeated, raised, .. }) = &manifest.sites {
        line(format!(
            "{file}: {sites} sites, {outside} in no scene, {repeated} at places taken already, \
             {raised} raised over a roof or the receivers"
        ));
    }
    let LeftOutSolids { no_height, covered_by_parts, no_area, not_closed } = manifest.left_out;
    line(format!(
        "buildings in no mesh: {covered_by_parts} whose parts stand for them, {no_height} that end \
         below their beginning, {no_area} without area, {not_closed} that could not be closed"
    ));
    text
}
