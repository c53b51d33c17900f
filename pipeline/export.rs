//! `holescout export`.

use holescout::config::Config;
use holescout::dataset::Dataset;
use holescout::export::{ExportJob, export};
use serde_json::json;

use crate::cli::ExportArgs;
use crate::console::{Console, Report};
use crate::failure::Failure;

pub(crate) fn run(
    args: &ExportArgs,
    config: &Config,
    console: &Console,
) -> Result<Report, Failure> {
    let dataset = &Dataset::open_with(&args.dataset, &config.remote)?;
    let job = ExportJob { dataset, out: &args.parquet, overwrite: args.overwrite };
    let manifest = export(&job, console)?;
    let records: u32 = manifest.files.iter().map(|file| file.records).sum();
    let bytes: u64 = manifest.files.iter().map(|file| file.digest.bytes).sum();
    let (out, files) = (args.parquet.display(), manifest.files.len());
    let summary = json!({
        "stage": "export",
        "out": args.parquet,
        "files": files,
        "records": records,
        "bytes": bytes,
    });
    let megabytes = bytes as f64 / 1e6;
    Report::new(
        format!(
            "{out}: {records} records in {files} files, {megabytes:.1} MB; its README.md tells how to read them\n"
        ),
        &summary,
    )
}
