//! `holescout shard`.

use std::fmt::Write;

use holescout::config::{Config, Split};
use holescout::dataset::{ShardJob, hole_share, shard, unsure_share};
use holescout::manifest::DatasetManifest;
use holescout::progress::Progress;
use serde_json::json;

use crate::cli::ShardArgs;
use crate::console::{Console, Report};
use crate::failure::Failure;
use crate::task;

pub(crate) fn run(args: &ShardArgs, config: &Config, console: &Console) -> Result<Report, Failure> {
    let job = ShardJob {
        tiles: &args.tiles,
        rsrp: &args.rsrp,
        config,
        out: &args.output.out,
        mode: args.task.mode(args.output.overwrite)?,
    };
    task::report("shard", shard(job, console)?, |manifest| report(&manifest, console))
}

fn report(manifest: &DatasetManifest, console: &Console) -> Result<Report, Failure> {
    for split in Split::ALL {
        if !manifest.statistics.contains_key(&split) {
            console.note(&format!("note: no record fell into the {split} split"));
        }
    }
    let summary = json!({
        "stage": "shard",
        "records": manifest.records.len(),
        "shards": manifest.shards.len(),
        "bytes": bytes(manifest),
        "statistics": manifest.statistics,
        "dropped": manifest.dropped,
        "overlapping_tile_pairs": manifest.overlapping_tile_pairs,
    });
    Report::new(text(manifest), &summary)
}

fn bytes(manifest: &DatasetManifest) -> u64 {
    manifest.shards.iter().map(|shard| shard.digest.bytes).sum()
}

/// The figures of a dataset, a line a split.
pub(crate) fn text(manifest: &DatasetManifest) -> String {
    let mut text = format!(
        "{} records of {} × {} cells of {} m in {} shards, {:.1} MB\n",
        manifest.records.len(),
        manifest.cells,
        manifest.cells,
        manifest.cell_m,
        manifest.shards.len(),
        bytes(manifest) as f64 / 1e6,
    );
    for (split, statistics) in &manifest.statistics {
        let holes = 100.0 * hole_share(statistics);
        let (records, threshold) = (statistics.records, statistics.hole_threshold_dbm.0);
        writeln!(
            text,
            "{split}: {records} records, {holes:.1} % of outdoor cells are holes ({threshold} dBm)"
        )
        .expect("writing to a string cannot fail");
        if let Some(reliability) = &statistics.reliability {
            let (unsure, records) = (100.0 * unsure_share(reliability), reliability.records);
            writeln!(
                text,
                "{split}: {unsure:.1} % of outdoor cells in {records} records with errors are unsure, \
                 holes with a chance of 5 to 95 %"
            )
            .expect("writing to a string cannot fail");
        }
    }
    let dropped = &manifest.dropped;
    writeln!(
        text,
        "left out: {} tiles without a map, {} maps rejected, {} records that overlap another split",
        dropped.tiles_without_map,
        dropped.rejected_maps.values().sum::<u64>(),
        dropped.overlapping_another_split.len(),
    )
    .expect("writing to a string cannot fail");
    text
}
