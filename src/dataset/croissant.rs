//! `croissant.json`: the dataset as machines that search and load datasets know it, in
//! `MLCommons` Croissant 1.1 with the keys of `GeoCroissant` 1.0.
//!
//! What Croissant can read is declared as record sets: the list of records and that of shards. It
//! knows no `MessagePack`, so the arrays are described as bands and measured variables, and no
//! record set claims to hold them. A dataset that was never published has neither `version` nor
//! `datePublished`; a release has the latter if it was given a date.
//!
//! Sources: <https://docs.mlcommons.org/croissant/docs/croissant-spec-1.1.html>,
//! <https://docs.mlcommons.org/croissant/docs/croissant-geo-spec.html>.

use serde_json::{Value, json};

use super::card;
use super::statistics::reliability_of;
use super::view::columns;
use crate::config::Split;
use crate::manifest::{DatasetManifest, to_json};
use crate::store::{Digest, MANIFEST};

/// Name of the file.
pub(crate) const FILE: &str = "croissant.json";
/// Name of a release's table of records.
pub(crate) const TABLE: &str = "records.csv";
/// Arrays of a record, those of errors last.
const BANDS: [&str; 5] = ["height_m", "rsrp_dbm", "mask", "std_error_db", "first_half_share"];
const BANDS_OF_ERRORS: usize = 2;
const ZSTD: &str = "application/zstd";

/// The description of a dataset whose manifest has a digest; `table` is that of `records.csv`,
/// where there is one.
pub(crate) fn croissant(
    manifest: &DatasetManifest,
    manifest_digest: &Digest,
    table: Option<&Digest>,
) -> Vec<u8> {
    let DatasetManifest { cells, cell_m, epsg, release, .. } = manifest;
    let mut files = vec![file(
        MANIFEST,
        "application/json",
        manifest_digest,
        "What the dataset was made of, its configuration, figures, shards and records.",
    )];
    files.extend(table.map(|digest| file(TABLE, "text/csv", digest, "A line for each record.")));
    files.extend(manifest.shards.iter().map(|shard| {
        let text = format!(
            "{} records of the {} split: MessagePack in the Zstandard seekable format.",
            shard.records, shard.split
        );
        file(&shard.file, ZSTD, &shard.digest, &text)
    }));
    files.extend(manifest.statistics.keys().map(|split| shards_of(*split)));
    let records = match table {
        Some(_) => table_of_records(manifest),
        None => index_of_records(manifest),
    };
    let [south, west, north, east] = bounds(manifest);
    let has_errors = reliability_of(manifest).is_some();
    let bands = if has_errors { BANDS.as_slice() } else { &BANDS[..BANDS.len() - BANDS_OF_ERRORS] };
    let mut dataset = json!({
        "@context": context(),
        "@type": "sc:Dataset",
        "conformsTo": [
            "http://mlcommons.org/croissant/1.1",
            "http://mlcommons.org/croissant/geo/1.0",
        ],
        "name": name(manifest),
        "description": description(manifest),
        "license": format!("https://spdx.org/licenses/{}", manifest.licence),
        "creator": creators(manifest),
        "citeAs": citation(manifest),
        "keywords": ["radio map", "RSRP", "coverage hole", "OpenStreetMap", "ray tracing", "UAV"],
        "isLiveDataset": false,
        "spatialCoverage": {
            "@type": "Place",
            "geo": {
                "@type": "GeoShape",
                "box": format!("{south:.6} {west:.6} {north:.6} {east:.6}"),
            },
        },
        "geocr:coordinateReferenceSystem": format!("EPSG:{epsg}"),
        "geocr:spatialResolution": quantity(*cell_m, "m"),
        "geocr:bandConfiguration": {
            "@type": "geocr:BandConfiguration",
            "geocr:totalBands": bands.len(),
            "geocr:bandNameList": bands,
        },
        "geocr:samplingStrategy": sampling(manifest),
        "geocr:spatialBias": bias(manifest),
        "variableMeasured": variables(*cells, has_errors),
        "distribution": files,
        "recordSet": [records, table_of_shards(manifest)],
    });
    if let Some(release) = release {
        dataset["version"] = json!(release.version);
        if let Some(date) = &release.date {
            dataset["datePublished"] = json!(date);
        }
        if let Some(url) = &release.url {
            dataset["url"] = json!(url);
        }
    }
    to_json(&dataset)
}

/// A reference in `BibTeX`.
pub(crate) fn citation(manifest: &DatasetManifest) -> String {
    let DatasetManifest { release, software, attribution, .. } = manifest;
    let authors = authors(manifest).join(" and ");
    let title = title(manifest);
    let mut fields = vec![format!("title = {{{title}}}"), format!("author = {{{authors}}}")];
    if let Some(release) = release {
        fields.push(format!("version = {{{}}}", release.version));
        fields.extend(release.date.as_ref().map(|date| format!("year = {{{}}}", &date[..4])));
        fields.extend(release.url.as_ref().map(|url| format!("url = {{{url}}}")));
    }
    let note = format!("Made with {} {}. {attribution}", software.name, software.version);
    fields.push(format!("note = {{{note}, {}}}", manifest.licence));
    format!("@misc{{{},\n  {}\n}}", name(manifest), fields.join(",\n  "))
}

/// What it is called, for people.
pub(crate) fn title(manifest: &DatasetManifest) -> String {
    let records = manifest.records.len();
    format!("Coverage-hole dataset {}: {records} places in EPSG:{}", name(manifest), manifest.epsg)
}

/// Who made a release; where nobody is named, whom its data come from.
pub(crate) fn authors(manifest: &DatasetManifest) -> Vec<String> {
    match &manifest.release {
        Some(release) if !release.creators.is_empty() => release.creators.clone(),
        _ => vec![manifest.attribution.trim_start_matches("© ").to_owned()],
    }
}

fn creators(manifest: &DatasetManifest) -> Vec<Value> {
    let named = manifest.release.as_ref().is_some_and(|release| !release.creators.is_empty());
    let kind = if named { "sc:Person" } else { "sc:Organization" };
    authors(manifest).into_iter().map(|name| json!({ "@type": kind, "name": name })).collect()
}

/// The name of a release; before that, what its first extract is called.
fn name(manifest: &DatasetManifest) -> String {
    match &manifest.release {
        Some(release) => release.name.clone(),
        None => default_name(manifest),
    }
}

/// What the first extract is called, without its endings.
pub(crate) fn default_name(manifest: &DatasetManifest) -> String {
    let file = manifest.inputs.first().map_or("", |input| &input.file);
    let stem = file.split('.').next().unwrap_or_default();
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "-_".contains(letter);
    let name: String =
        stem.chars().map(|letter| if plain(letter) { letter } else { '-' }).collect();
    let name = name.trim_start_matches(['-', '_']);
    if name.is_empty() { "coverage-holes".to_owned() } else { name.to_owned() }
}

fn description(manifest: &DatasetManifest) -> String {
    let DatasetManifest { cells, cell_m, .. } = manifest;
    let reliability = reliability_of(manifest).map_or_else(String::new, |reliability| {
        format!(" {}", card::reliability_in_words(manifest, &reliability))
    });
    format!(
        "Building heights from OpenStreetMap and ray-traced RSRP maps of {cells} × {cells} cells of \
         {cell_m} m, for finding coverage holes. Each record is a MessagePack map with `height_m`, \
         `rsrp_dbm` and `mask` as .npy arrays, base station, radio parameters and provenance.{reliability}"
    )
}

fn sampling(manifest: &DatasetManifest) -> String {
    let config = &manifest.config;
    format!(
        "Windows of {} m around a lattice of {} m that have a radio map; splits by blocks of {} m.",
        config.grid.crop_m, config.grid.spacing_m, config.split.block_m
    )
}

fn bias(manifest: &DatasetManifest) -> String {
    let filter = &manifest.config.filter;
    format!(
        "One area, built-up places only: at least {} buildings in a tile, and {} of the window \
         built over.",
        filter.min_buildings, filter.min_built
    )
}

/// South, west, north and east of all windows, in degrees.
fn bounds(manifest: &DatasetManifest) -> [f64; 4] {
    let half = f64::from(manifest.config.grid.crop_m) / 2.0;
    let mut bounds = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for record in &manifest.records {
        let [x, y] = record.id.center();
        for (dx, dy) in [(-half, -half), (-half, half), (half, -half), (half, half)] {
            let [lon, lat] = record.id.utm.inverse(x + dx, y + dy);
            bounds =
                [bounds[0].min(lat), bounds[1].min(lon), bounds[2].max(lat), bounds[3].max(lon)];
        }
    }
    bounds
}

fn variables(cells: u32, has_errors: bool) -> Value {
    let variable = |name: &str, unit: &str, text: &str| {
        json!({
            "@type": "PropertyValue",
            "name": name,
            "unitText": unit,
            "description": format!("{text} [{cells}, {cells}], row 0 north, column 0 west."),
        })
    };
    let levels = if has_errors {
        "int16: RSRP in 0.01 dBm per resource element, -32768 where no path arrives (record.v2); \
         float32 in dBm in records without errors (record.v1)."
    } else {
        "float32: RSRP in dBm per resource element."
    };
    let mut variables = vec![
        variable(
            "height_m",
            "m",
            "float32: height of the highest building, 0 where there is none.",
        ),
        variable("rsrp_dbm", "dBm", levels),
        variable("mask", "code", "uint8: 0 outdoor, 1 building, 2 outdoor without a path."),
    ];
    if has_errors {
        variables.push(variable(
            "std_error_db",
            "dB",
            "uint16: standard error of rsrp_dbm over independent traces, in 0.01 dB.",
        ));
        variables.push(variable(
            "first_half_share",
            "1",
            "uint8: share of the summed power that the first half of the traces received, in 1/250.",
        ));
    }
    json!(variables)
}

fn quantity(value: f64, unit: &str) -> Value {
    json!({ "@type": "QuantitativeValue", "value": value, "unitText": unit })
}

fn file(path: &str, format: &str, digest: &Digest, text: &str) -> Value {
    json!({
        "@type": "cr:FileObject",
        "@id": path,
        "name": path,
        "description": text,
        "contentUrl": path,
        "contentSize": format!("{} B", digest.bytes),
        "encodingFormat": format,
        "sha256": digest.sha256,
    })
}

fn shards_of(split: Split) -> Value {
    json!({
        "@type": "cr:FileSet",
        "@id": format!("{split}-shards"),
        "name": format!("{split} shards"),
        "description": format!("The shards of the {split} split."),
        "encodingFormat": ZSTD,
        "includes": format!("{split}/shard-*.msgpack.zst"),
    })
}

fn record_set(id: &str, key: &str, text: &str, fields: &[Value]) -> Value {
    json!({
        "@type": "cr:RecordSet",
        "@id": id,
        "name": id,
        "description": text,
        "key": { "@id": format!("{id}/{key}") },
        "field": fields,
    })
}

/// A column of a record set; without a source, the record set holds its values itself.
fn field(set: &str, [name, kind, text]: [&str; 3], source: Option<Value>) -> Value {
    let mut field = json!({
        "@type": "cr:Field",
        "@id": format!("{set}/{name}"),
        "name": name,
        "description": text,
        "dataType": kind,
    });
    if let Some(source) = source {
        field["source"] = source;
    }
    field
}

/// The records as `records.csv` has them.
fn table_of_records(manifest: &DatasetManifest) -> Value {
    let fields = columns(manifest).into_iter().map(|column| {
        let extract = json!({ "column": column[0] });
        let source = json!({ "fileObject": { "@id": TABLE }, "extract": extract });
        field("records", column, Some(source))
    });
    let fields: Vec<Value> = fields.collect();
    record_set("records", "id", "Every record, without its arrays.", &fields)
}

/// The records as the manifest has them.
fn index_of_records(manifest: &DatasetManifest) -> Value {
    let columns = columns(manifest).into_iter();
    let columns = columns.filter(|[name, ..]| ["id", "shard", "frame"].contains(name));
    let fields = columns.map(|column| {
        let extract = json!({ "jsonPath": format!("$.records[*].{}", column[0]) });
        let source = json!({ "fileObject": { "@id": MANIFEST }, "extract": extract });
        field("records", column, Some(source))
    });
    record_set("records", "id", "Where every record is.", &fields.collect::<Vec<_>>())
}

/// The shards, which are few.
fn table_of_shards(manifest: &DatasetManifest) -> Value {
    let columns = [
        ["file", "sc:Text", "Path of the shard."],
        ["split", "sc:Text", "train, val or test."],
        ["records", "sc:Integer", "Number of records, one a frame."],
    ];
    let fields = columns.map(|column| field("shards", column, None));
    let mut shards = record_set("shards", "file", "Every shard.", &fields);
    let rows = manifest.shards.iter().map(|shard| {
        json!({
            "shards/file": shard.file,
            "shards/split": shard.split,
            "shards/records": shard.records,
        })
    });
    shards["data"] = rows.collect();
    shards
}

/// The context that `mlcroissant` calls standard for Croissant 1.1, and the prefix of `GeoCroissant`.
fn context() -> Value {
    let mut context = json!({
        "@language": "en",
        "@vocab": "https://schema.org/",
        "sc": "https://schema.org/",
        "cr": "http://mlcommons.org/croissant/",
        "dct": "http://purl.org/dc/terms/",
        "geocr": "http://mlcommons.org/croissant/geo/",
        "rai": "http://mlcommons.org/croissant/RAI/",
        "conformsTo": "dct:conformsTo",
        "data": { "@id": "cr:data", "@type": "@json" },
        "dataType": { "@id": "cr:dataType", "@type": "@vocab" },
        "description": { "@container": "@language" },
        "examples": { "@id": "cr:examples", "@type": "@json" },
        "name": { "@container": "@language" },
    });
    for term in [
        "arrayShape",
        "citeAs",
        "column",
        "containedIn",
        "equivalentProperty",
        "extract",
        "field",
        "fileObject",
        "fileProperty",
        "fileSet",
        "format",
        "includes",
        "isArray",
        "isLiveDataset",
        "jsonPath",
        "key",
        "md5",
        "parentField",
        "path",
        "recordSet",
        "references",
        "regex",
        "repeated",
        "replace",
        "samplingRate",
        "separator",
        "source",
        "subField",
        "transform",
    ] {
        context[term] = json!(format!("cr:{term}"));
    }
    context
}
