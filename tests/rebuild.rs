//! `verify --rebuild`: the recorded inputs give every file again, and what they do not give is
//! found, checksums made anew or not.

mod pipeline;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::{Value, json};

use pipeline::{
    HELSINKI, assert_same_files, assert_says, copy_of, fixture, holescout, import, plant,
    rasterise, read_json, run, sha256, shard, temporary_dir, tree, verify, write,
};

fn osm() -> PathBuf {
    fixture("helsinki/helsinki.osm.pbf")
}

fn maps() -> PathBuf {
    fixture("helsinki/rsrp")
}

/// `verify --rebuild` with the fixtures' extract.
fn rebuild(directory: &Path) -> Command {
    let mut command = verify(directory);
    command.arg("--rebuild").arg("--osm").arg(osm());
    command
}

/// The same of a dataset, with the fixtures' maps.
fn rebuild_dataset(directory: &Path) -> Command {
    let mut command = rebuild(directory);
    command.arg("--maps").arg(maps());
    command
}

/// Checksums that fit what is there.
fn sum_again(root: &Path) {
    let mut files = tree(root);
    files.remove("SHA256SUMS");
    let sums = files.iter().map(|(name, bytes)| format!("{}  {name}\n", sha256(bytes)));
    write(&root.join("SHA256SUMS"), sums.collect::<String>());
}

/// Changes a dataset's manifest, and the checksums with it.
fn forge(root: &Path, change: impl FnOnce(&mut Value)) {
    let path = root.join("manifest.json");
    let mut manifest = read_json(&path);
    change(&mut manifest);
    write(&path, format!("{manifest:#}\n"));
    sum_again(root);
}

#[test]
fn every_stage_gives_the_same_files_again() {
    let said = run(&mut rebuild_dataset(&HELSINKI.dataset)).succeeds();
    assert_says(&said, &["sound", "all 7 files have the same SHA-256"]);
    run(&mut rebuild(&HELSINKI.tiles)).succeeds();
    let mut of_maps = verify(&HELSINKI.rsrp);
    of_maps.arg("--rebuild").arg("--maps").arg(maps()).arg("--tiles").arg(&HELSINKI.tiles);
    run(&mut of_maps).succeeds();
    let summary = run(rebuild_dataset(&HELSINKI.dataset).arg("--json")).succeeds();
    let summary: Value =
        serde_json::from_str(summary.lines().last().expect("a line")).expect("JSON");
    assert_eq!(summary["rebuilt"], 7);
}

/// Everything that a manifest must record for that: an area, scenes that told transmitters, maps
/// that were rejected, files beside them, cells that rays were counted for.
#[test]
fn an_unusual_dataset_gives_the_same_files_again() {
    let dir = temporary_dir();
    let at = |name: &str| dir.path().join(name);
    let area = ["--bbox", "24.94,60.169,24.951,60.176"];
    run(rasterise(&at("tiles")).args(area)).succeeds();
    let sites = at("sites.csv");
    write(&sites, "lon,lat,name\n24.9425,60.1715,one\n24.9440,60.1700,\n");
    let mut scenes = holescout("scenes");
    scenes.arg("--osm").arg(osm()).arg("--tiles").arg(at("tiles")).arg("--sites").arg(&sites);
    run(scenes.arg("--out").arg(at("scenes"))).succeeds();
    let mut of_scenes = rebuild(&at("scenes"));
    of_scenes.arg("--tiles").arg(at("tiles")).arg("--sites").arg(&sites);
    run(&mut of_scenes).succeeds();

    plant(&at("maps"), &tree(&maps()));
    write(&at("maps").join("README"), "what this is");
    write(&at("maps").join("broken.npz"), "no map");
    let mut imported = import(&at("maps"), &at("tiles"), &at("rsrp"));
    write(&at("coarse.toml"), coarse());
    imported.arg("--scenes").arg(at("scenes")).arg("--config").arg(at("coarse.toml"));
    let mut imported = without_first_config(&imported);
    run(&mut imported).succeeds();
    run(&mut shard(&at("tiles"), &at("rsrp"), &at("dataset"))).succeeds();

    // Another name of the extract, and a map more, change nothing that is recorded.
    fs::copy(osm(), at("renamed.pbf")).expect("copied");
    write(&at("maps").join("more.npz"), "no map either");
    let mut again = verify(&at("dataset"));
    again.arg("--rebuild").arg("--osm").arg(at("renamed.pbf")).arg("--maps").arg(at("maps"));
    assert_says(&run(&mut again).refused(), &["scenes", "--scenes"]);
    run(again.arg("--scenes").arg(at("scenes"))).succeeds();
    let recorded = read_json(&at("dataset/manifest.json"));
    assert!(recorded["area"].is_array() && recorded["import"]["record_cell_m"] == 2.0);

    let release = at("release");
    let mut released = pipeline::release(&at("dataset"), "2.0.0-rc.1", &release);
    released.args(["--date", "2026-07-01", "--creator", "Ann O'Neill", "--name", "centre"]);
    run(&mut released).succeeds();
    let mut again = rebuild_dataset(&release);
    again.arg("--scenes").arg(at("scenes"));
    assert_says(&run(&mut again).refused(), &["maps", "broken.npz"]);
    again = rebuild(&release);
    again.arg("--maps").arg(at("maps")).arg("--scenes").arg(at("scenes"));
    run(&mut again).succeeds();
    // A version of which nothing changed is a small step, also with an area.
    run(&mut pipeline::release(&at("dataset"), "1.0.0", &at("first"))).succeeds();
    let mut next = pipeline::release(&at("dataset"), "1.0.1", &at("next"));
    run(next.arg("--previous").arg(at("first"))).succeeds();
    forge(&release, |manifest| manifest["release"]["version"] = json!("2.0.0-rc.2"));
    assert_says(&run(&mut again).refused(), &["README.md"]);

    // What the card's first command does with the area.
    let mut tiles = holescout("rasterise");
    tiles.arg("--osm").arg(osm()).arg("--config").arg(release.join("config.toml"));
    tiles.arg("--area").arg(release.join("area.geojson")).arg("--out").arg(at("tiles-again"));
    run(&mut tiles).succeeds();
    assert_same_files(&tree(&at("tiles-again")), &tree(&at("tiles")));
    let card = fs::read_to_string(release.join("README.md")).expect("read");
    assert_says(
        &card,
        &["--area area.geojson", "`area.geojson`", "--tiles tiles --scenes scenes --out rsrp"],
    );
}

/// The fixtures' configuration with smaller records than those of the shards.
fn coarse() -> String {
    let text = fs::read_to_string(pipeline::helsinki_config()).expect("read");
    format!("{text}\n[shard]\ndownsample = 2\n")
}

/// A command with the last of two configurations.
fn without_first_config(command: &Command) -> Command {
    let args: Vec<_> = command.get_args().map(ToOwned::to_owned).collect();
    let first = args.iter().position(|arg| arg == "--config").expect("a configuration");
    let mut again = Command::new(command.get_program());
    again.args(&args[..first]).args(&args[first + 2..]);
    again
}

#[test]
fn a_changed_byte_is_found_though_all_checksums_fit() {
    let (_dir, root, files) = copy_of(&HELSINKI.dataset);
    let card = String::from_utf8(files["README.md"].clone()).expect("text");
    write(&root.join("README.md"), card.replacen("Holescout", "Holescoot", 1) + "\n");
    sum_again(&root);
    run(&mut verify(&root)).succeeds();
    let message = run(&mut rebuild_dataset(&root)).refused();
    assert_says(&message, &["README.md: is ", "but rebuilt", "SHA256SUMS: is ", "2 failures"]);
}

#[test]
fn files_too_few_and_too_many_are_found() {
    let (_dir, root, _) = copy_of(&HELSINKI.dataset);
    write(&root.join("more.txt"), "more");
    fs::remove_file(root.join("NOTICE")).expect("removed");
    sum_again(&root);
    let message = run(&mut rebuild_dataset(&root)).refused();
    assert_says(&message, &["more.txt: is not among", "NOTICE: was rebuilt, but is missing"]);
}

/// A recorded configuration that is not the one the data were made with.
#[test]
fn a_forged_configuration_is_found() {
    let (_dir, root, _) = copy_of(&HELSINKI.dataset);
    forge(&root, |manifest| manifest["config"]["shard"]["zstd_level"] = json!(1));
    run(&mut verify(&root)).succeeds();
    let message = run(&mut rebuild_dataset(&root)).refused();
    assert_says(
        &message,
        &["train/shard-00000.msgpack.zst: is ", "manifest.json: is ", "it differs in"],
    );
    assert_says(&message, &["all 15 records are the same in every value"]);
}

/// Whether it is the records that differ, and in what, is told beside the files.
#[test]
fn records_that_differ_are_counted_by_field() {
    let (_dir, root, _) = copy_of(&HELSINKI.dataset);
    forge(&root, |manifest| {
        manifest["config"]["buildings"]["level_height_m"] = json!(4.5);
    });
    let message = run(&mut rebuild_dataset(&root)).refused();
    // Some maps no longer fit buildings of other heights, and are rejected.
    let words =
        ["records that are in both", "differ (height_m in ", "provenance in ", "were not rebuilt"];
    assert_says(&message, &words);
}

/// Another version is named first: it may be the reason for all else.
#[test]
fn another_version_is_named_first() {
    let (_dir, root, _) = copy_of(&HELSINKI.dataset);
    forge(&root, |manifest| manifest["software"]["version"] = json!("0.0.7"));
    let message = run(&mut rebuild_dataset(&root)).refused();
    let first = message.lines().next().expect("a line");
    assert_says(first, &["manifest.json", "0.0.7", env!("CARGO_PKG_VERSION"), "same version"]);
    assert_says(&message, &["all 15 records are the same in every value"]);
}

#[test]
fn inputs_that_are_not_those_recorded_are_named() {
    let other = fixture("helsinki/holescout.toml");
    let mut wrong = verify(&HELSINKI.dataset);
    wrong.arg("--rebuild").arg("--osm").arg(&other).arg("--maps").arg(maps());
    let recorded = sha256(&pipeline::read(&osm()));
    assert_says(&run(&mut wrong).refused(), &["helsinki.osm.pbf", &recorded, "holescout.toml"]);

    assert_says(&run(&mut rebuild(&HELSINKI.dataset)).refused(), &["24 radio maps", "--maps"]);
    let mut none = verify(&HELSINKI.dataset);
    none.arg("--rebuild").arg("--maps").arg(maps());
    assert_says(&run(&mut none).refused(), &["helsinki.osm.pbf", "--osm"]);

    let dir = temporary_dir();
    let mut changed = tree(&maps());
    let names: Vec<String> = changed.keys().cloned().collect();
    changed.insert(names[3].clone(), b"changed".to_vec());
    changed.remove(&names[5]);
    plant(dir.path(), &changed);
    let message = run(rebuild(&HELSINKI.dataset).arg("--maps").arg(dir.path())).refused();
    assert_says(&message, &["24 maps", "2 are missing or have changed", &names[3]]);

    let mut other_tiles = verify(&HELSINKI.rsrp);
    other_tiles.arg("--rebuild").arg("--maps").arg(maps()).arg("--tiles").arg(&HELSINKI.dataset);
    assert_says(&run(&mut other_tiles).refused(), &["tiles whose manifest has SHA-256"]);
    let usage = run(verify(&HELSINKI.dataset).arg("--osm").arg(osm()));
    assert_eq!(usage.code, Some(2), "inputs are for --rebuild: {usage:?}");
}

/// What a forger does to a manifest.
type Change = fn(&mut Value);

/// A manifest is a file from outside: names in it must not lead anywhere.
#[test]
fn forged_names_and_cells_are_refused() {
    let changes: [(Change, &str); 3] = [
        (|manifest| manifest["inputs"][0]["file"] = json!("../helsinki.osm.pbf"), "no file name"),
        (|manifest| manifest["import"]["ignored"] = json!(["../../thesis.tex"]), "no file name"),
        (|manifest| manifest["import"]["record_cell_m"] = json!(2.5), "contradicts itself"),
    ];
    for (change, word) in changes {
        let (_dir, root, _) = copy_of(&HELSINKI.dataset);
        forge(&root, change);
        assert_says(&run(&mut rebuild_dataset(&root)).refused(), &[word]);
    }
}
