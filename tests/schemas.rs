//! `schemas/` says what the program writes: it is up to date, every artefact of a real run
//! validates against it, and an artefact that was tampered with does not.

mod pipeline;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use holescout::config::{RlConfig, TrainConfig};
use holescout::dataset::Record;
use holescout::manifest::{Manifest, PolicyManifest, RunManifest, Software};
use holescout::store::{SeekTable, sha256_bytes};
use jsonschema::Validator;
use serde_json::{Value, json};

use pipeline::numpy::meta_json;
use pipeline::repeats::REPEATED;
use pipeline::{
    DATASET_FILES, HELSINKI, assert_says, fixture, helsinki_config, holescout, plant, read,
    read_json, release, run, shared_dir, temporary_dir, tree, write,
};

/// The committed schemas.
fn schemas() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("schemas")
}

fn schema(name: &str) -> Validator {
    let schema = read_json(&schemas().join(format!("{name}.json")));
    jsonschema::validator_for(&schema).expect("a schema")
}

/// Artefacts of the fixtures, one of each kind (all, where they are few), by schema.
fn artefacts() -> BTreeMap<&'static str, Vec<Value>> {
    let npz = |directory: &Path| -> Vec<Value> {
        let names = tree(directory).into_keys().filter(|name| name.starts_with("utm"));
        names.take(24).map(|name| meta_json(&directory.join(name))).collect()
    };
    let config = run(holescout("config").arg("--json")).succeeds();
    let mut merged = holescout("config");
    merged.arg("--json").arg("--config").arg(helsinki_config());
    let merged = run(&mut merged).succeeds();
    let parse = |text: &str| serde_json::from_str(text).expect("JSON");
    let manifest = |stage: &Path| vec![read_json(&stage.join("manifest.json"))];
    let scenes = tree(&SCENES).into_keys().filter(|name| name.ends_with("scene.json"));
    let scenes = scenes.map(|name| read_json(&SCENES.join(name))).collect();
    BTreeMap::from([
        ("config.v1", vec![parse(&config), parse(&merged)]),
        ("radio_map.v1", [npz(&fixture("helsinki/rsrp")), npz(&REPEATED.maps)].concat()),
        ("tile.v1", npz(&HELSINKI.tiles)),
        ("tiles.v2", manifest(&HELSINKI.tiles)),
        ("scene.v1", scenes),
        ("scenes.v2", manifest(&SCENES)),
        ("rsrp_map.v1", [npz(&HELSINKI.rsrp), npz(&REPEATED.rsrp)].concat()),
        ("rsrp.v1", [manifest(&HELSINKI.rsrp), manifest(&REPEATED.rsrp)].concat()),
        ("record.v1", records(&HELSINKI.dataset)),
        ("record.v2", records(&REPEATED.dataset)),
        (
            "dataset.v1",
            [&HELSINKI.dataset, &REPEATED.dataset, &RELEASE].map(|it| manifest(it)).concat(),
        ),
        ("evaluation.v1", manifest(&EVALUATION)),
        (
            "report.v1",
            [&EVALUATION, &OF_REPEATS].map(|it| read_json(&it.join("report.json"))).to_vec(),
        ),
        ("export.v1", [&HELSINKI.dataset, &REPEATED.dataset].map(|it| export(it)).to_vec()),
        ("policy.v4", vec![policy()]),
        ("run.v1", vec![training()]),
    ])
}

/// What a run of training says of itself; `tests/runs.rs` looks at that of a real one.
fn training() -> Value {
    json!(RunManifest {
        schema: RunManifest::SCHEMA.to_owned(),
        software: Software::this(),
        dataset: sha256_bytes(b"a manifest"),
        rl: RlConfig::default(),
        train: TrainConfig::default(),
    })
}

/// The manifest of a policy; `tests/train.rs` looks at that of a real one.
fn policy() -> Value {
    json!(PolicyManifest {
        schema: PolicyManifest::SCHEMA.to_owned(),
        fingerprint: String::new(),
        software: Software::this(),
        weights_sha256: String::new(),
        parameters: 7,
        cells: 121,
        cell_m: 4.0,
        dataset_sha256: String::new(),
        updates: 100,
        score: None,
        rl: RlConfig::default(),
        train: TrainConfig::default(),
    })
}

/// The manifest of a dataset's export.
fn export(dataset: &Path) -> Value {
    let dir = temporary_dir();
    let out = dir.path().join("out");
    run(holescout("export").arg(dataset).arg("--parquet").arg(&out)).succeeds();
    read_json(&out.join("manifest.json"))
}

/// A release of the fixtures, with all that may be said of one.
static RELEASE: LazyLock<PathBuf> = LazyLock::new(|| {
    let out = shared_dir("schemas-release").join("out");
    let mut command = release(&HELSINKI.dataset, "1.0.0", &out);
    let notes = shared_dir("schemas-notes").join("notes.md");
    write(&notes, "What its makers say.\n");
    command.args(["--date", "2026-07-01", "--url", "https://example.org/", "--creator", "A"]);
    command.arg("--notes").arg(notes);
    run(&mut command).succeeds();
    out
});

/// A small evaluation of the fixtures.
static EVALUATION: LazyLock<PathBuf> = LazyLock::new(|| {
    let out = shared_dir("schemas-evaluation").join("out");
    evaluate(&HELSINKI.dataset, &out);
    out
});

/// The same of maps with repeats.
static OF_REPEATS: LazyLock<PathBuf> = LazyLock::new(|| {
    let out = shared_dir("schemas-evaluation-of-repeats").join("out");
    evaluate(&REPEATED.dataset, &out);
    out
});

fn evaluate(dataset: &Path, out: &Path) {
    let mut evaluate = holescout("evaluate");
    evaluate.arg("--dataset").arg(dataset).arg("--out").arg(out);
    run(evaluate.args(["--split", "val", "--starts", "5", "--bootstrap", "100"])).succeeds();
}

/// Scenes of the fixtures with base stations of a file, so that nothing optional is missing.
static SCENES: LazyLock<PathBuf> = LazyLock::new(|| {
    let dir = shared_dir("schemas-scenes");
    let (out, sites) = (dir.join("out"), dir.join("sites.csv"));
    write(&sites, "lon,lat,name\n24.9425,60.1715,one\n24.9440,60.1700,\n");
    let mut scenes = holescout("scenes");
    scenes
        .arg("--osm")
        .arg(fixture("helsinki/helsinki.osm.pbf"))
        .arg("--tiles")
        .arg(&HELSINKI.tiles);
    run(scenes.arg("--sites").arg(&sites).arg("--out").arg(&out)).succeeds();
    out
});

fn records(dataset: &Path) -> Vec<Value> {
    let mut records = vec![];
    // The maps with repeats all lie in the north, which is one split.
    let shards = [DATASET_FILES[4], DATASET_FILES[5]].map(|name| dataset.join(name));
    for shard in shards.into_iter().filter(|shard| shard.exists()) {
        let (mut file, table) = SeekTable::open(&shard).expect("opened");
        for frame in 0..table.len() {
            let bytes = table.frame(&mut file, frame).expect("whole");
            records.push(json!(Record::decode(&bytes).expect("a record")));
        }
    }
    records
}

#[test]
fn the_committed_schemas_are_those_of_the_program() {
    let said = run(holescout("schemas").arg("--check").arg("--out").arg(schemas())).succeeds();
    assert_says(&said, &["up to date"]);
    let names: Vec<String> = tree(&schemas()).into_keys().collect();
    let expected: Vec<String> =
        artefacts().into_keys().map(|name| format!("{name}.json")).collect();
    assert_eq!(names, expected, "nothing more, nothing less");
}

#[test]
fn a_changed_or_missing_schema_is_named() {
    let dir = temporary_dir();
    plant(dir.path(), &tree(&schemas()));
    let check = || run(holescout("schemas").arg("--check").arg("--out").arg(dir.path()));
    check().succeeds();
    let path = dir.path().join("record.v1.json");
    let text = String::from_utf8(read(&path)).expect("text");
    write(&path, text.replace("\"rsrp_dbm\"", "\"rsrp\""));
    assert_says(&check().refused(), &["record.v1.json", "make schemas"]);
    fs::remove_file(&path).expect("removed");
    assert_says(&check().refused(), &["record.v1.json"]);
    assert!(!path.exists(), "a check changes nothing");
    run(holescout("schemas").arg("--out").arg(dir.path())).succeeds();
    assert_eq!(read(&path), text.as_bytes());
    check().succeeds();
}

/// A schema of a format that is no more misleads as well.
#[test]
fn a_schema_too_many_is_named() {
    let dir = temporary_dir();
    plant(dir.path(), &tree(&schemas()));
    write(&dir.path().join("record.v0.json"), "{}");
    let mut check = holescout("schemas");
    let message = run(check.arg("--check").arg("--out").arg(dir.path())).refused();
    assert_says(&message, &["record.v0.json"]);
}

#[test]
fn every_artefact_validates() {
    for (name, artefacts) in artefacts() {
        let schema = schema(name);
        assert!(!artefacts.is_empty());
        for artefact in artefacts {
            let errors: Vec<String> = schema
                .iter_errors(&artefact)
                .map(|error| format!("{}: {error}", error.instance_path()))
                .collect();
            assert!(errors.is_empty(), "{name}: {errors:#?}");
        }
    }
}

#[test]
fn schemas_are_documented() {
    for (name, text) in tree(&schemas()) {
        let schema: Value = serde_json::from_slice(&text).expect("JSON");
        assert_eq!(schema["$schema"], "https://json-schema.org/draft/2020-12/schema");
        for (field, property) in schema["properties"].as_object().expect("fields") {
            assert!(property.get("description").is_some(), "{name}: {field}");
        }
    }
}

/// Every field at the top is described as present and of its type.
#[test]
fn an_artefact_without_a_field_or_with_one_of_another_type_does_not_validate() {
    // Producers may leave these out, and add others.
    let optional = ["schema", "value_kind", "n_subcarriers", "materials", "seed", "osm_sha256"];
    for (name, artefacts) in artefacts() {
        let (schema, artefact) = (schema(name), &artefacts[0]);
        for field in artefact.as_object().expect("fields").keys() {
            let foreign = name == "radio_map.v1" && optional.contains(&field.as_str());
            let mut without = artefact.clone();
            without.as_object_mut().expect("fields").remove(field);
            let of_sites = name == "scenes.v2" && field == "sites";
            let half = name == "record.v2" && field == "first_half_share";
            // Null where it is unknown, which schemas of serde types do not tell from missing.
            let labels = name == "report.v1" && field == "labels";
            let may_lack = foreign || of_sites || half || labels || name == "config.v1";
            assert_eq!(schema.is_valid(&without), may_lack, "{name} without {field}");
            if field != "materials" {
                let mut other = artefact.clone();
                other[field] = json!({"unheard": ["of"]});
                assert!(!schema.is_valid(&other), "{name}: {field} of another type");
            }
        }
        let mut more = artefact.clone();
        more["unheard_of"] = json!(1);
        assert_eq!(schema.is_valid(&more), name == "radio_map.v1", "{name} with a field more");
    }
}

#[test]
fn tampered_values_do_not_validate() {
    let artefacts = artefacts();
    let tampered = [
        ("config.v1", "/grid/side_m", json!(-1)),
        ("config.v1", "/shard/rsrp", json!("median")),
        ("config.v1", "/split/areas/0/split", json!("dev")),
        ("radio_map.v1", "/row_order", json!("up")),
        ("radio_map.v1", "/no_path_value", json!("infinite")),
        ("radio_map.v1", "/map_center_m", json!([1.0])),
        ("radio_map.v1", "/tx_position_m", json!([1.0, 2.0, 3.0, 4.0])),
        ("tile.v1", "/id", json!("helsinki")),
        ("tile.v1", "/schema", json!("tile.v2")),
        ("tile.v1", "/row_order", json!("south_first")),
        ("tiles.v2", "/tiles/0/digest/sha256", json!("ABC")),
        ("tiles.v2", "/inputs/0/digest/bytes", json!(-5)),
        ("tiles.v2", "/schema", json!("rsrp.v1")),
        ("scene.v1", "/base_stations/0/position_m", json!([1.0, 2.0])),
        ("scene.v1", "/materials/ground", json!("asphalt")),
        ("scene.v1", "/id", json!("helsinki")),
        ("scene.v1", "/schema", json!("scene.v2")),
        ("scenes.v2", "/scenes/0/files/0/digest/sha256", json!("ABC")),
        ("scenes.v2", "/config/scenes/placement", json!("tower")),
        ("scenes.v2", "/left_out/no_area", json!(-1)),
        ("scenes.v2", "/schema", json!("tiles.v2")),
        ("rsrp_map.v1", "/source/value_kind", json!("gain")),
        ("rsrp_map.v1", "/schema", json!("rsrp_map.v0")),
        ("rsrp_map.v1", "/row_order", json!("south_first")),
        ("rsrp.v1", "/maps/0/cells/reached", json!(1.5)),
        ("rsrp.v1", "/schema", json!("tiles.v2")),
        ("record.v1", "/split", json!("dev")),
        ("record.v1", "/mask/0", json!(256)),
        ("record.v1", "/schema", json!("record.v2")),
        ("record.v1", "/row_order", json!("south_first")),
        ("record.v1", "/repeats", json!(8)),
        ("record.v2", "/schema", json!("record.v1")),
        ("record.v2", "/repeats", json!(1)),
        ("record.v2", "/std_error_db", json!(null)),
        ("record.v2", "/std_error_db/0", json!(-1)),
        ("radio_map.v1", "/repeats", json!(0)),
        ("radio_map.v1", "/direction_shift", json!("none")),
        ("rsrp_map.v1", "/repeats", json!(1)),
        ("rsrp.v1", "/maps/0/quality/reliability/repeats", json!("8")),
        ("record.v1", "/base_station/power_per_re_dbm", json!("15 dBm")),
        ("dataset.v1", "/statistics/train/holes", json!("many")),
        ("dataset.v1", "/records/0/id", json!("utm35_e1_n2")),
        ("dataset.v1", "/shards/0/split", json!("holdout")),
        ("dataset.v1", "/schema", json!("dataset.v2")),
        ("dataset.v1", "/release/name", json!("../x")),
        ("dataset.v1", "/release/version", json!(1)),
        ("evaluation.v1", "/evaluate/methods/0", json!("best")),
        ("evaluation.v1", "/rl/reach_cells", json!(-1)),
        ("evaluation.v1", "/schema", json!("evaluation.v2")),
        ("report.v1", "/scores/0/precision/mean", json!("high")),
        ("report.v1", "/scores/0/method", json!("psr")),
        ("report.v1", "/methods/0/knows", json!("everything")),
        ("report.v1", "/groups/0/kind", json!("city")),
        ("report.v1", "/difficulty/unreachable", json!(-1)),
        ("report.v1", "/labels/repeats", json!([8])),
        ("report.v1", "/labels/ceiling/0/k", json!(-1)),
        ("report.v1", "/distances/0/cells", json!("many")),
        ("report.v1", "/schema", json!("report.v2")),
        ("export.v1", "/columns/0/shape", json!("121 x 121")),
        ("export.v1", "/files/0/split", json!("validation")),
        ("export.v1", "/schema", json!("export.v2")),
        ("policy.v4", "/train/loss", json!("cubic")),
        ("policy.v4", "/cells", json!(-1)),
        ("policy.v4", "/schema", json!("policy.v1")),
        ("run.v1", "/dataset/sha256", json!("abc")),
        ("run.v1", "/train/gamma", json!("high")),
        ("run.v1", "/schema", json!("run.v2")),
    ];
    let mut unnoticed = vec![];
    for (name, path, value) in tampered {
        let mut artefact = artefacts[name].last().expect("one").clone();
        let (parent, key) = path.rsplit_once('/').expect("a path");
        match artefact.pointer_mut(path) {
            Some(place) => *place = value.clone(),
            None => artefact.pointer_mut(parent).expect(path)[key] = value.clone(),
        }
        if schema(name).is_valid(&artefact) {
            unnoticed.push(format!("{name}: {path} = {value}"));
        }
    }
    assert!(unnoticed.is_empty(), "{unnoticed:#?}");
}
