//! Datasets in a format of others: Parquet, one record a row, for readers that know nothing of ours.

mod columns;
mod table;

use std::path::Path;

use crate::config::Split;
use crate::dataset::{Dataset, ReadError, card, croissant, reliability_of};
use crate::error::{Fault, FileError, HasFault};
use crate::grid::TileId;
use crate::manifest::{
    DatasetManifest, ExportColumn, ExportFile, ExportManifest, Manifest, Software, fingerprint,
    to_json,
};
use crate::progress::Progress;
use crate::store::{Build, BuildMode, Digest, Item, Items, Opened, OutputError, Parallel};
use table::Table;

pub(crate) use table::{Shape, read_shape};

const README: &str = include_str!("readme.md");
/// Records in a file: some 40 MB of 121 × 121 cells.
const RECORDS_PER_FILE: usize = 1024;

/// Why there is no export.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExportDatasetError {
    /// The dataset cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The output directory cannot be used.
    #[error(transparent)]
    Output(#[from] OutputError),
}

impl HasFault for ExportDatasetError {
    fn fault(&self) -> Fault {
        match self {
            Self::Read(error) => error.fault(),
            Self::Output(error) => error.fault(),
        }
    }
}

impl From<FileError> for ExportDatasetError {
    fn from(error: FileError) -> Self {
        Self::Output(error.into())
    }
}

/// What to export, and where to.
#[derive(Debug, Clone)]
pub struct ExportJob<'a> {
    /// The dataset.
    pub dataset: &'a Dataset,
    /// The directory to fill.
    pub out: &'a Path,
    /// Replace an export of another dataset.
    pub overwrite: bool,
}

/// A file of the plan.
struct ExportPart {
    file: String,
    split: Split,
    ids: Vec<TileId>,
}

/// Exports a dataset as Parquet: `<split>-<number>-of-<files>.parquet`, records in the order of their
/// names. The same dataset gives the same bytes; a run that was killed goes on where it was.
///
/// # Errors
/// [`ExportDatasetError`]; the directory has no manifest then.
pub fn export(
    job: &ExportJob<'_>,
    progress: &dyn Progress,
) -> Result<ExportManifest, ExportDatasetError> {
    let dataset = job.dataset;
    let manifest = dataset.manifest();
    let table = Table::new(manifest.cells, reliability_of(manifest).is_some());
    let columns: Vec<ExportColumn> = table.entries();
    let fingerprint = fingerprint(&("export", dataset.digest(), &columns));
    let mode = BuildMode { overwrite: job.overwrite, ..BuildMode::default() };
    let build = match Build::open(job.out, "export", &fingerprint, mode, progress)? {
        Opened::Done(built) => return Ok(built.whole().expect("it is no task")),
        Opened::Ready(build) => build,
    };
    let write = |part: &ExportPart, item: Item<'_>| -> Result<_, ExportDatasetError> {
        let bytes = table.write(dataset, &part.ids)?;
        let (split, records) = (part.split, part.ids.len() as u32);
        let entry = |digests: &[Digest]| {
            let (file, digest) = (part.file.clone(), digests[0].clone());
            ExportFile { file, split, digest, records }
        };
        Ok(item.finish(&[(&part.file, &bytes)], entry)?)
    };
    let how = ("exporting", Parallel::Across);
    let key = |part: &ExportPart| part.file.clone();
    let Items::All(files, output) = build.run_items(how, &parts(dataset), key, write, progress)?
    else {
        unreachable!("it is no task");
    };
    let export = ExportManifest {
        schema: ExportManifest::SCHEMA.to_owned(),
        fingerprint,
        software: Software::this(),
        dataset: dataset.digest().clone(),
        licence: manifest.licence.clone(),
        attribution: manifest.attribution.clone(),
        columns,
        files,
    };
    output.write("README.md", readme(manifest, &export).as_bytes())?;
    output.write("NOTICE", card::notice(manifest).as_bytes())?;
    output.complete(&to_json(&export))?;
    Ok(export)
}

/// Files of at most [`RECORDS_PER_FILE`] records, named as Hugging Face names those of a split.
fn parts(dataset: &Dataset) -> Vec<ExportPart> {
    let of_split = |split: Split| {
        let ids = dataset.ids_of(split);
        let count = ids.len().div_ceil(RECORDS_PER_FILE);
        let parts: Vec<ExportPart> = ids
            .chunks(RECORDS_PER_FILE)
            .enumerate()
            .map(|(number, ids)| {
                let file = format!("{split}-{number:05}-of-{count:05}.parquet");
                ExportPart { file, split, ids: ids.to_vec() }
            })
            .collect();
        parts
    };
    Split::ALL.into_iter().flat_map(of_split).collect()
}

/// What readers of the format call a split.
fn public_name(split: Split) -> &'static str {
    match split {
        Split::Train => "train",
        Split::Val => "validation",
        Split::Test => "test",
    }
}

fn readme(dataset: &DatasetManifest, export: &ExportManifest) -> String {
    let present = Split::ALL.into_iter().filter(|split| dataset.statistics.contains_key(split));
    let data_files = present
        .map(|split| format!("  - split: {}\n    path: {split}-*.parquet\n", public_name(split)));
    let rows = export.columns.iter().map(|column| {
        let shape: Vec<String> = column.shape.iter().map(u32::to_string).collect();
        let unit = column.unit.as_deref().unwrap_or_default();
        let ExportColumn { name, dtype, meaning, .. } = column;
        format!("| `{name}` | {dtype} | {} | {unit} | {meaning} |\n", shape.join(" × "))
    });
    let release = dataset.release.as_ref();
    let name = release.map_or_else(
        || croissant::default_name(dataset),
        |release| format!("{} {}", release.name, release.version),
    );
    let first = export.files.first();
    let values = [
        ("name", name),
        ("data_files", data_files.collect()),
        ("records", dataset.records.len().to_string()),
        ("cells", dataset.cells.to_string()),
        ("software", format!("{} {}", export.software.name, export.software.version)),
        ("dataset", export.dataset.sha256.clone()),
        ("split", first.map_or("train", |file| public_name(file.split)).to_owned()),
        ("file", first.map_or_else(String::new, |file| file.file.clone())),
        ("columns", rows.collect()),
        ("licence", dataset.licence.clone()),
        ("attribution", dataset.attribution.clone()),
    ];
    let fill = |text: String, (name, value): &(&str, String)| {
        text.replace(&format!("{{{{{name}}}}}"), value)
    };
    values.iter().fold(README.to_owned(), fill)
}
