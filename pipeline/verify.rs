//! `holescout verify`.

use std::fmt::Write;

use holescout::rebuild::{GivenInputs, rebuild};
use holescout::verify::verify;
use serde_json::json;

use crate::cli::{InputArgs, VerifyArgs};
use crate::console::{Console, Report};
use crate::failure::Failure;

/// More failures than this are counted, not printed.
const MOST_PRINTED: usize = 100;

pub(crate) fn run(args: &VerifyArgs, console: &Console) -> Result<Report, Failure> {
    let verification = verify(&args.directory, console)?;
    let mut failures = verification.failures;
    let (mut rebuilt, mut records) = (None, None);
    if args.rebuild {
        let InputArgs { osm, maps, scenes, tiles, sites } = &args.inputs;
        let given = GivenInputs {
            osm,
            maps: maps.as_deref(),
            scenes: scenes.as_deref(),
            tiles: tiles.as_deref(),
            sites: sites.as_deref(),
        };
        let rebuilding = rebuild(&args.directory, given, console)?;
        rebuilt = Some(rebuilding.files);
        failures.extend(rebuilding.failures);
        records = rebuilding.records;
    }
    let mut summary = json!({
        "stage": "verify",
        "schema": verification.schema,
        "files": verification.files,
        "items": verification.items,
        "failures": failures.iter().map(ToString::to_string).collect::<Vec<_>>(),
    });
    if let Some(files) = rebuilt {
        summary["rebuilt"] = json!(files);
    }
    if let Some(records) = &records {
        summary["records"] = json!(records);
    }
    let mut text = String::new();
    for failure in failures.iter().take(MOST_PRINTED) {
        writeln!(text, "{failure}").expect("writing to a string cannot fail");
    }
    let directory = args.directory.display();
    if let Some(records) = records {
        writeln!(text, "{directory}: compared with what was rebuilt: {records}")
            .expect("writing to a string cannot fail");
    }
    if failures.is_empty() {
        let (files, items) = (verification.files, verification.items);
        writeln!(text, "{directory}: sound: {files} files and {items} items verified")
            .expect("writing to a string cannot fail");
        if let Some(files) = rebuilt {
            writeln!(text, "{directory}: rebuilt: all {files} files have the same SHA-256")
                .expect("writing to a string cannot fail");
        }
        return Report::new(text, &summary);
    }
    let report = Report::new(text, &summary)?;
    Ok(report.failed(format!("{directory}: {} failures", failures.len())))
}
