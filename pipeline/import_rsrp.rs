//! `holescout import-rsrp`.

use std::collections::BTreeMap;

use holescout::config::Config;
use holescout::manifest::{MapWarning, RsrpManifest, WarningCode};
use holescout::progress::Progress;
use holescout::rsrp::{ImportRsrpJob, import_rsrp};
use serde_json::json;

use crate::cli::ImportArgs;
use crate::console::{Console, Report};
use crate::failure::Failure;
use crate::task;

pub(crate) fn run(
    args: &ImportArgs,
    config: &Config,
    console: &Console,
) -> Result<Report, Failure> {
    let job = ImportRsrpJob {
        maps: &args.maps,
        tiles: &args.tiles,
        scenes: args.scenes.as_deref(),
        config,
        out: &args.output.out,
        mode: args.task.mode(args.output.overwrite)?,
    };
    task::report("import-rsrp", import_rsrp(job, console)?, |manifest| {
        report(&manifest, config.rsrp.strict, console)
    })
}

fn report(manifest: &RsrpManifest, strict: bool, console: &Console) -> Result<Report, Failure> {
    for (code, maps) in warnings(manifest) {
        let (example, warning) = &maps[0];
        let count = maps.len();
        console.note(&format!(
            "warning: {}: {count} maps (import.csv), for example {example}: {}",
            code.name(),
            warning.text
        ));
    }
    if manifest.solvers.len() > 1 {
        let count = manifest.solvers.len();
        console.note(&format!(
            "warning: the maps were computed in {count} different ways (see solvers in manifest.json)"
        ));
    }
    let report = Report::new(text(manifest), &summary(manifest))?;
    let rejected = rejected(manifest);
    let fails = strict && rejected > 0;
    Ok(if fails { report.failed(format!("{rejected} maps rejected")) } else { report })
}

/// Maps by what they are warned of, each with its file.
fn warnings(manifest: &RsrpManifest) -> BTreeMap<WarningCode, Vec<(&str, &MapWarning)>> {
    let mut by_code: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for entry in &manifest.maps {
        for warning in &entry.warnings {
            by_code.entry(warning.code).or_default().push((entry.source.file.as_str(), warning));
        }
    }
    by_code
}

fn rejected(manifest: &RsrpManifest) -> u64 {
    manifest.rejected.values().sum()
}

fn summary(manifest: &RsrpManifest) -> serde_json::Value {
    let warnings = warnings(manifest);
    json!({
        "stage": "import-rsrp",
        "imported": manifest.maps.len(),
        "rejected": rejected(manifest),
        "rejected_by_code": manifest.rejected,
        "warnings": warnings.values().map(Vec::len).sum::<usize>(),
        "warnings_by_code": warnings
            .iter()
            .map(|(code, maps)| (code.name(), maps.len()))
            .collect::<BTreeMap<_, _>>(),
        "solvers": manifest.solvers.len(),
    })
}

fn text(manifest: &RsrpManifest) -> String {
    let codes: Vec<_> =
        manifest.rejected.iter().map(|(code, count)| format!("{count} {code}")).collect();
    let reasons = if codes.is_empty() { String::new() } else { format!(": {}", codes.join(", ")) };
    format!(
        "{} maps imported, {} rejected{reasons} (rejected.csv lists them), \
         {} other files ignored; import.csv tells how good each map is\n",
        manifest.maps.len(),
        rejected(manifest),
        manifest.inputs.ignored.len(),
    ) + errors(manifest).as_str()
}

/// How sure holes are, where maps have several repeats.
fn errors(manifest: &RsrpManifest) -> String {
    let unsure: Vec<f64> = manifest
        .maps
        .iter()
        .filter_map(|map| map.quality.reliability.map(|reliability| reliability.unsure))
        .collect();
    if unsure.is_empty() {
        return String::new();
    }
    let mean = 100.0 * unsure.iter().sum::<f64>() / unsure.len() as f64;
    format!(
        "{} maps have errors; {mean:.1} % of their outdoor cells are unsure, holes with a chance of 5 \
         to 95 %\n",
        unsure.len()
    )
}
