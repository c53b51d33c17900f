//! How a stage's run ends, be it whole or a task's part.

use holescout::store::Built;
use holescout::store::TaskReport;
use serde_json::json;

use crate::console::Report;
use crate::failure::Failure;

/// The report of a stage: that of its manifest, or what a task did.
pub(crate) fn report<M>(
    stage: &str,
    built: Built<M>,
    whole: impl FnOnce(M) -> Result<Report, Failure>,
) -> Result<Report, Failure> {
    match built {
        Built::Whole(manifest) => whole(manifest),
        Built::Part(TaskReport { task, planned, items, found, .. }) => {
            let built = items.saturating_sub(found);
            let text = format!(
                "task {} of 0 to {}: {items} of {planned} items, {built} built, {found} found done\n",
                task.index,
                task.count - 1,
            );
            let summary = json!({
                "stage": stage,
                "task": task.index,
                "of": task.count,
                "planned": planned,
                "items": items,
                "built": built,
                "found": found,
            });
            Report::new(text, &summary)
        }
        Built::Already => {
            let text = "nothing to do: the output is whole already\n".to_owned();
            Report::new(text, &json!({ "stage": stage, "whole": true }))
        }
    }
}
