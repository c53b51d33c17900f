//! `holescout schemas`: JSON Schemas generated from the serde types.

use std::path::Path;

use holescout::config::Config;
use holescout::dataset::record_schemas;
use holescout::error::FileError;
use holescout::evaluate::Report as EvaluationReport;
use holescout::manifest::{
    DatasetManifest, EvaluationManifest, ExportManifest, Manifest, PolicyManifest, RsrpManifest,
    RsrpMeta, RunManifest, SceneMeta, ScenesManifest, TileMeta, TilesManifest, json_schema,
};
use holescout::rsrp::RadioMapMetadata;
use holescout::store::write_atomic;
use schemars::JsonSchema;
use serde_json::json;

use crate::cli::SchemasArgs;
use crate::console::Report;
use crate::failure::Failure;

pub(crate) fn run(args: &SchemasArgs) -> Result<Report, Failure> {
    let schemas = all();
    if args.check {
        let stale: Vec<&str> = schemas
            .iter()
            .filter(|(name, text)| std::fs::read(args.out.join(name)).ok().as_ref() != Some(text))
            .map(|(name, _)| name.as_str())
            .collect();
        let known = |name: &str| schemas.iter().any(|(known, _)| known == name);
        let entries = std::fs::read_dir(&args.out).map_err(FileError::new("list", &args.out))?;
        let names = entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned());
        let strange: Vec<String> = names.filter(|name| !known(name)).collect();
        if !strange.is_empty() {
            let strange = strange.join(", ");
            let directory = args.out.display();
            return Err(Failure::input(format!(
                "{directory}: no schemas of this program: {strange}"
            )));
        }
        if !stale.is_empty() {
            let stale = stale.join(", ");
            return Err(Failure::input(format!(
                "{}: not the schemas of this program: {stale}; run `make schemas`",
                args.out.display()
            )));
        }
    } else {
        let create = std::fs::create_dir_all(&args.out);
        create.map_err(FileError::new("create", &args.out))?;
        write(&args.out, &schemas)?;
    }
    let count = schemas.len();
    let state = if args.check { "up to date" } else { "written" };
    let summary = json!({ "stage": "schemas", "schemas": count, "state": state });
    Report::new(format!("{}: {count} schemas {state}\n", args.out.display()), &summary)
}

fn write(directory: &Path, schemas: &[(String, Vec<u8>)]) -> Result<(), FileError> {
    schemas.iter().try_for_each(|(name, text)| write_atomic(&directory.join(name), text))
}

fn all() -> Vec<(String, Vec<u8>)> {
    let records = record_schemas().map(|(name, text)| (format!("{name}.json"), text));
    let mut schemas = vec![
        schema::<Config>("config.v1"),
        schema::<RadioMapMetadata>(RadioMapMetadata::SCHEMA),
        schema::<TileMeta>(TileMeta::SCHEMA),
        schema::<TilesManifest>(TilesManifest::SCHEMA),
        schema::<SceneMeta>(SceneMeta::SCHEMA),
        schema::<ScenesManifest>(ScenesManifest::SCHEMA),
        schema::<RsrpMeta>(RsrpMeta::SCHEMA),
        schema::<RsrpManifest>(RsrpManifest::SCHEMA),
        schema::<DatasetManifest>(DatasetManifest::SCHEMA),
        schema::<EvaluationManifest>(EvaluationManifest::SCHEMA),
        schema::<EvaluationReport>(EvaluationReport::SCHEMA),
        schema::<ExportManifest>(ExportManifest::SCHEMA),
        schema::<PolicyManifest>(PolicyManifest::SCHEMA),
        schema::<RunManifest>(RunManifest::SCHEMA),
    ];
    schemas.extend(records);
    schemas
}

fn schema<T: JsonSchema>(name: &str) -> (String, Vec<u8>) {
    (format!("{name}.json"), json_schema::<T>())
}
