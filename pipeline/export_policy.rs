//! `holescout export-policy`.

use holescout::rl::agent::export_policy;
use serde_json::json;

use crate::cli::ExportPolicyArgs;
use crate::console::Report;
use crate::failure::Failure;

pub(crate) fn run(args: &ExportPolicyArgs) -> Result<Report, Failure> {
    let output = &args.output;
    let manifest = export_policy(&args.checkpoint, &output.out, output.overwrite)?;
    let text = format!(
        "{}: {} parameters after {} updates; its README.md tells how to use them\n",
        output.out.display(),
        manifest.parameters,
        manifest.updates
    );
    let summary = json!({ "stage": "export-policy", "weights_sha256": manifest.weights_sha256 });
    Report::new(text, &summary)
}
