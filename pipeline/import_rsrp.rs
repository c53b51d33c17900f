//! `holescout import-rsrp`.

use holescout::config::Config;
use holescout::manifest::RsrpManifest;
use holescout::progress::Progress;
use holescout::radio_map::{ImportJob, import_maps};
use serde_json::json;

use crate::cli::ImportArgs;
use crate::console::{Console, Report};
use crate::failure::Failure;

pub(crate) fn run(
    args: &ImportArgs,
    config: &Config,
    console: &Console,
) -> Result<Report, Failure> {
    let job = ImportJob {
        maps: &args.maps,
        tiles: &args.tiles,
        config,
        out: &args.output.out,
        overwrite: args.output.overwrite,
    };
    let manifest = import_maps(job, console)?;
    for entry in &manifest.maps {
        for warning in &entry.warnings {
            console.note(&format!("warning: {}: {warning}", entry.source.file));
        }
    }
    if manifest.radio.len() > 1 {
        let count = manifest.radio.len();
        console.note(&format!(
            "warning: the maps were computed in {count} different ways (see radio in manifest.json)"
        ));
    }
    Report::new(text(&manifest), &summary(&manifest))
}

fn rejected(manifest: &RsrpManifest) -> u64 {
    manifest.rejected.values().sum()
}

fn summary(manifest: &RsrpManifest) -> serde_json::Value {
    json!({
        "stage": "import-rsrp",
        "imported": manifest.maps.len(),
        "rejected": rejected(manifest),
        "rejected_by_code": manifest.rejected,
        "warnings": manifest.maps.iter().map(|entry| entry.warnings.len()).sum::<usize>(),
        "radio_configurations": manifest.radio.len(),
    })
}

fn text(manifest: &RsrpManifest) -> String {
    let codes: Vec<_> =
        manifest.rejected.iter().map(|(code, count)| format!("{count} {code}")).collect();
    let reasons = if codes.is_empty() { String::new() } else { format!(": {}", codes.join(", ")) };
    format!(
        "{} maps imported, {} rejected{reasons} (rejected.csv lists them), {} other files ignored\n",
        manifest.maps.len(),
        rejected(manifest),
        manifest.ignored.len(),
    )
}
