//! Exports: each file has the rows and columns that the manifest says.

use std::path::Path;

use super::failure::{VerifyFailure, failure};
use crate::export::{Shape, read_shape};
use crate::manifest::{ExportFile, ExportManifest};

/// Lists what is wrong, and returns the number of records.
pub(super) fn check(
    root: &Path,
    manifest: &ExportManifest,
    failures: &mut Vec<VerifyFailure>,
) -> usize {
    let columns: Vec<&str> = manifest.columns.iter().map(|column| &*column.name).collect();
    let mut records = 0;
    for ExportFile { file, records: expected, .. } in &manifest.files {
        match read_shape(&root.join(file)) {
            Err(reason) => failures.push(failure(file, reason)),
            Ok(Shape { rows, columns: found }) => {
                if rows != i64::from(*expected) {
                    let reason = format!("{rows} rows, the manifest says {expected}");
                    failures.push(failure(file, reason));
                }
                if found != columns {
                    let reason = format!("columns {found:?}, the manifest says {columns:?}");
                    failures.push(failure(file, reason));
                }
                records += *expected as usize;
            }
        }
    }
    records
}
