//! `holescout rasterise`.

use std::fmt::Write;

use holescout::building::Action;
use holescout::config::Config;
use holescout::grid::Area;
use holescout::manifest::{TilesManifest, Verdict};
use holescout::rasterise::{RasteriseJob, rasterise};
use serde_json::json;

use crate::cli::RasteriseArgs;
use crate::console::{Console, Report};
use crate::failure::Failure;
use crate::task;

pub(crate) fn run(
    args: &RasteriseArgs,
    config: &Config,
    console: &Console,
) -> Result<Report, Failure> {
    let area = match (&args.bbox, &args.area) {
        (Some(bbox), _) => Area::from_bbox(*bbox)?,
        (None, Some(path)) => Area::from_geojson(path)?,
        (None, None) => Area::Whole,
    };
    let job = RasteriseJob {
        osm: &args.osm,
        area: &area,
        config,
        out: &args.output.out,
        mode: args.task.mode(args.output.overwrite)?,
    };
    task::report("rasterise", rasterise(job, console)?, |manifest| {
        Report::new(text(&manifest), &summary(&manifest))
    })
}

fn summary(manifest: &TilesManifest) -> serde_json::Value {
    json!({
        "stage": "rasterise",
        "epsg": manifest.epsg,
        "tiles": manifest.tiles.len(),
        "verdicts": manifest.verdicts,
        "buildings": manifest.buildings,
        "problems": manifest.problems,
    })
}

fn text(manifest: &TilesManifest) -> String {
    let buildings = &manifest.buildings;
    let dropped: u64 = manifest
        .verdicts
        .iter()
        .filter(|(verdict, _)| **verdict != Verdict::Kept)
        .map(|(_, count)| count)
        .sum();
    let mut text = format!(
        "{} tiles in EPSG:{}, {dropped} more were too empty (tiles.csv lists them)\n\
         {} buildings, {} parts, {} raised ones (of {} objects with building tags)\n\
         heights: {} from height, {} from levels, {} guessed\n",
        manifest.tiles.len(),
        manifest.epsg,
        buildings.outlines,
        buildings.parts,
        buildings.raised,
        buildings.tagged,
        buildings.from_height,
        buildings.from_levels,
        buildings.from_default,
    );
    for (action, codes) in &manifest.problems {
        let codes: Vec<_> =
            codes.iter().map(|(code, count)| format!("{count} {}", code.name())).collect();
        let what = match action {
            Action::Skipped => "skipped",
            Action::Repaired => "repaired",
            Action::LeftOut => "left out",
            Action::Noted => "noted",
        };
        writeln!(text, "{what}: {}", codes.join(", ")).expect("writing to a string cannot fail");
    }
    text
}
