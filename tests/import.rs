//! `import-rsrp` takes a map in whatever way it was written: one physical map, known in
//! every cell, gives the same RSRP and the same mask for every kind of value, row order,
//! container, element type, byte order, memory order, floor and way of giving the power.
//!
//! Also what ends a whole import: unusable tiles, no maps, an occupied directory.

#![expect(clippy::float_cmp, reason = "values that must be exact are compared exactly")]

mod pipeline;

use std::fs;
use std::path::Path;

use ndarray::{Array2, Axis, Zip, s};
use proptest::prelude::*;
use proptest::sample::select;
use serde_json::{Value, json};
use tempfile::TempDir;

use pipeline::maps::{
    CROP, DROPPED_TILE, FLOOR, POWER_PER_RE, SITE, SUBCARRIERS, Window, good_values, metadata,
    physical, write_good, write_npz,
};
use pipeline::numpy::{Float, Layout, matrix, npy, npy_raw, npz, npz_members};
use pipeline::{
    assert_says, import, read, read_json, run, sha256, temporary_dir, tree, verify, write,
};

/// Names of arrays and the kinds of value that they tell.
const TELLING: [(&str, &str); 9] = [
    ("path_gain", "path_gain_linear"),
    ("path_gain_linear", "path_gain_linear"),
    ("path_gain_db", "path_gain_db"),
    ("path_loss_db", "path_loss_db"),
    ("rss_w", "rss_w"),
    ("rss_data", "rss_w"),
    ("rss_dbm", "rss_dbm"),
    ("rx_power_dbm", "rss_dbm"),
    ("rsrp_dbm", "rsrp_dbm"),
];
/// Names that leave it open: `value_kind` in the metadata tells it.
const AMBIGUOUS: [(&str, &str); 6] = [
    ("rss", "rss_w"),
    ("rss", "rss_dbm"),
    ("rm", "path_gain_linear"),
    ("rm", "path_loss_db"),
    ("arr_0", "path_gain_db"),
    ("arr_0", "rsrp_dbm"),
];

/// One way of writing a physical map down.
#[derive(Debug, Clone)]
struct Producer {
    array: &'static str,
    kind: &'static str,
    /// `.npy` with `.json` beside it, instead of `.npz`.
    sidecar: bool,
    south_first: bool,
    layout: Layout,
    /// Index into [`no_path_values`].
    no_path: usize,
    /// The transmit power is the carrier's total.
    total_power: bool,
    window: Window,
}

fn is_linear(kind: &str) -> bool {
    ["path_gain_linear", "rss_w"].contains(&kind)
}

/// What cells without a path may hold, in the metadata and in the array.
fn no_path_values(kind: &str) -> Vec<(Value, f64)> {
    let nan = (json!("nan"), f64::NAN);
    if is_linear(kind) {
        return vec![(json!(0), 0.0), (json!(0.0), 0.0), nan, (json!(1e-30), 1e-30)];
    }
    let is_loss = kind == "path_loss_db";
    let far = if is_loss { 1.0 } else { -1.0 };
    let infinity = (json!(if is_loss { "inf" } else { "-inf" }), far * f64::INFINITY);
    // 160.1 is no number of any binary type: it is compared as the file rounds it.
    let floors = [160.0, 300.0, 999.0, 160.1].map(|floor| (json!(far * floor), far * floor));
    floors.into_iter().chain([nan, infinity]).collect()
}

fn layouts(kind: &str) -> Vec<Layout> {
    let mut layouts = vec![];
    for float in [Float::F4, Float::F8, Float::F2] {
        for bits in 0..8 {
            layouts.push(Layout {
                float,
                big_endian: bits & 1 != 0,
                fortran: bits & 2 != 0,
                leading_axis: bits & 4 != 0,
            });
        }
    }
    layouts.retain(|layout| layout.float != Float::F2 || !is_linear(kind));
    layouts
}

impl Producer {
    /// The value that an RSRP becomes.
    fn value(&self, rsrp: f64) -> f64 {
        if rsrp.is_nan() {
            return no_path_values(self.kind)[self.no_path].1;
        }
        let linear = |decibels: f64| 10.0_f64.powf(decibels / 10.0);
        let received = rsrp + self.subcarriers_db();
        match self.kind {
            "path_gain_linear" => linear(rsrp - POWER_PER_RE),
            "path_gain_db" => rsrp - POWER_PER_RE,
            "path_loss_db" => POWER_PER_RE - rsrp,
            "rss_w" => linear(received - 30.0),
            "rss_dbm" => received,
            _ => rsrp,
        }
    }

    /// The carrier's total power over that of one resource element.
    fn subcarriers_db(&self) -> f64 {
        if self.total_power { 10.0 * f64::from(SUBCARRIERS).log10() } else { 0.0 }
    }

    fn metadata(&self, tile: &str) -> Value {
        let mut metadata = metadata(tile, self.window);
        if !self.south_first {
            metadata["row_order"] = json!("north_first");
        }
        if self.total_power {
            metadata["tx_power_is"] = json!("total");
            metadata["n_subcarriers"] = json!(SUBCARRIERS);
            metadata["tx_power_dbm"] = json!(POWER_PER_RE + self.subcarriers_db());
        }
        metadata["no_path_value"] = no_path_values(self.kind)[self.no_path].0.clone();
        let told = TELLING.iter().any(|(array, _)| *array == self.array);
        if self.sidecar || !told {
            metadata["value_kind"] = json!(self.kind);
        }
        metadata
    }

    /// Writes a physical map (over [`Producer::window`]) as a map of a tile.
    fn write(&self, rsrp: &Array2<f64>, directory: &Path, tile: &str) {
        let mut values = rsrp.mapv(|rsrp| self.value(rsrp));
        if self.south_first {
            values.invert_axis(Axis(0));
        }
        let (bytes, metadata) = (npy(&values, self.layout), self.metadata(tile));
        if self.sidecar {
            write(&directory.join(format!("map of {tile}.npy")), bytes);
            let path = directory.join(format!("map of {tile}.json"));
            write(&path, metadata.to_string());
        } else {
            let path = directory.join(format!("map of {tile}.npz"));
            write_npz(&path, self.array, bytes, &metadata);
        }
    }

    /// How far a value may be from the true RSRP after rounding, in dB.
    fn tolerance(&self) -> f64 {
        match self.layout.float {
            Float::F8 => 1e-5, // RSRP is float32 in the end
            Float::F4 => 3e-5,
            Float::F2 => 0.0626, // half a step from 128 to 256
        }
    }
}

/// Writes maps of up to as many tiles as there are, imports them in one go and compares.
fn check_imports(cases: &[(Producer, u64)]) {
    let dir = temporary_dir();
    let (maps, out) = (dir.path().join("maps"), dir.path().join("rsrp"));
    let truths: Vec<_> = cases
        .iter()
        .zip(&SITE.ids)
        .map(|((producer, seed), tile)| {
            let truth = physical(*seed, tile, producer.window);
            producer.write(&truth, &maps, tile);
            truth
        })
        .collect();
    run(&mut import(&maps, &SITE.tiles, &out)).succeeds();
    let manifest = read_json(&out.join("manifest.json"));
    assert_eq!(manifest["rejected"], json!({}));
    assert_eq!(manifest["inputs"]["ignored"], json!([]), "a sidecar is no file of its own");
    for (((producer, _), tile), truth) in cases.iter().zip(&SITE.ids).zip(&truths) {
        let entry = manifest["maps"].as_array().expect("a list").iter();
        let entry = entry.clone().find(|map| map["id"] == json!(tile)).expect("imported");
        assert_eq!(entry["source"]["value_kind"], producer.kind);
        check_import(producer, tile, truth, &out, &entry["cells"]);
    }
}

/// Compares one imported map with the physical one, cell by cell.
fn check_import(producer: &Producer, tile: &str, truth: &Array2<f64>, out: &Path, counts: &Value) {
    let Producer { window, .. } = *producer;
    let (offset, cells) = (window.offset(), CROP / window.cell());
    let truth = truth.slice(s![offset..offset + cells, offset..offset + cells]);
    let arrays = npz_members(&out.join(format!("{tile}.npz")));
    let (rsrp, mask) = (matrix(&arrays["rsrp_dbm"]), matrix(&arrays["mask"]));
    let buildings = SITE.buildings(tile, window.cell());
    assert_eq!((rsrp.dim(), mask.dim()), (truth.dim(), truth.dim()));
    let tolerance = producer.tolerance();
    let (mut wrong, mut found) = (0, [0_u64; 3]);
    Zip::from(&rsrp).and(&mask).and(truth).and(&buildings).for_each(
        |&rsrp, &mask, &truth, &building| {
            let (kind, level) = if building {
                (1, FLOOR)
            } else if truth.is_nan() {
                (2, FLOOR)
            } else {
                (0, truth)
            };
            found[kind] += 1;
            let right = mask == kind as f64 && (rsrp - level).abs() <= tolerance;
            wrong += usize::from(!right);
        },
    );
    assert_eq!(wrong, 0, "cells differ: {producer:?}");
    let [reached, building, unreached] = found;
    let expected = json!({"reached": reached, "building": building, "unreached": unreached});
    assert_eq!(*counts, expected);
}

/// Every name of an array, in every row order and container; element types, floors and
/// powers take turns, so that each of them meets each kind.
#[test]
fn every_way_of_writing_a_map_gives_the_same_rsrp() {
    let mut cases = vec![];
    for (number, (array, kind)) in TELLING.into_iter().chain(AMBIGUOUS).enumerate() {
        for turn in 0..8 {
            let layouts = layouts(kind);
            let turns = 8 * number + turn;
            let producer = Producer {
                array,
                kind,
                sidecar: turn & 1 != 0,
                south_first: turn & 2 != 0,
                // 5 has no common factor with the 16 or 24 layouts.
                layout: layouts[5 * turns % layouts.len()],
                no_path: turns % no_path_values(kind).len(),
                total_power: turn & 4 != 0,
                window: Window::ALL[if turn == 0 { number % 3 } else { 2 }],
            };
            cases.push((producer, turns as u64));
        }
    }
    for batch in cases.chunks(SITE.ids.len()) {
        check_imports(batch);
    }
}

prop_compose! {
    fn producers()(
        (array, kind) in select(TELLING.into_iter().chain(AMBIGUOUS).collect::<Vec<_>>()),
    )(
        layout in select(layouts(kind)),
        no_path in 0..no_path_values(kind).len(),
        window in select(Window::ALL.to_vec()),
        [sidecar, south_first, total_power] in any::<[bool; 3]>(),
        (array, kind) in Just((array, kind)),
    ) -> Producer {
        Producer { array, kind, sidecar, south_first, layout, no_path, total_power, window }
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 60,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn any_way_of_writing_any_map_gives_the_same_rsrp(producer in producers(), seed: u64) {
        check_imports(&[(producer, seed)]);
    }
}

// Producers without metadata -------------------------------------------------------------

/// What the people who traced a map know of it, whatever they wrote it with.
fn known() -> Vec<String> {
    let known = metadata(&SITE.ids[0], Window::Coarse);
    let keys = [
        "rx_height_m",
        "tx_power_dbm",
        "tx_power_is",
        "frequency_hz",
        "tx_pattern",
        "sionna_version",
        "samples_per_tx",
        "max_depth",
        "refraction",
        "diffraction",
        "cell_size_m",
    ];
    keys.iter().flat_map(|key| ["--assume".to_owned(), format!("{key}={}", known[*key])]).collect()
}

fn raw(values: &Array2<f64>) -> Vec<u8> {
    values.iter().flat_map(|&value| (value as f32).to_le_bytes()).collect()
}

/// Imports one file by a preset; returns the manifest's entry, and compares with the sound map.
fn by_preset(preset: &str, file: &str, bytes: &[u8], more: &[&str]) -> Value {
    let dir = temporary_dir();
    let (maps, out) = (dir.path().join("maps"), dir.path().join("rsrp"));
    write(&maps.join(file), bytes);
    let flags = ["--preset", preset];
    run(import(&maps, &SITE.tiles, &out).args(flags).args(known()).args(more)).succeeds();
    let manifest = read_json(&out.join("manifest.json"));
    assert_eq!(
        (&manifest["rejected"], &manifest["config"]["preset"]),
        (&json!({}), &json!(preset))
    );
    let (sound, expected) = (dir.path().join("sound"), dir.path().join("expected"));
    write_good(&sound.join("good.npz"), &SITE.ids[0]);
    run(&mut import(&sound, &SITE.tiles, &expected)).succeeds();
    let map = format!("{}.npz", SITE.ids[0]);
    let arrays = |out: &Path| {
        let mut members = npz_members(&out.join(&map));
        (members.remove("rsrp_dbm"), members.remove("mask"))
    };
    assert_eq!(arrays(&out), arrays(&expected));
    manifest["maps"][0].clone()
}

#[test]
fn a_plain_script_around_sionna_needs_no_metadata_of_ours() {
    let values = npy_raw("'<f4'", false, "(1, 121, 121)", &raw(&good_values(&SITE.ids[0])));
    let bytes = npz(&[("path_gain", values)], zip::CompressionMethod::Stored);
    let position = "tx_position_m=[10, -20, 80]";
    let file = format!("{}.npz", SITE.ids[0]);
    let entry = by_preset("sionna", &file, &bytes, &["--assume", position]);
    let assumed: Vec<&str> =
        entry["assumed"].as_array().expect("keys").iter().filter_map(Value::as_str).collect();
    assert!(
        ["crs", "location_id", "row_order", "tx_power_dbm"].iter().all(|key| assumed.contains(key))
    );
}

/// North first, with values that mean "no path" in turns; the name goes on behind the tile's.
#[test]
fn maps_of_geo2sigmap_are_read() {
    let mut values = good_values(&SITE.ids[0]);
    values.invert_axis(Axis(0));
    let nothing = [0.0, f64::NAN, f64::NEG_INFINITY];
    let mut turn = 0..;
    values
        .mapv_inplace(|gain| if gain > 0.0 { gain } else { nothing[turn.next().unwrap_or(0) % 3] });
    let bytes = npy_raw("'<f4'", false, "(121, 121)", &raw(&values));
    let file = format!("{}_10_-20_80_271.npy", SITE.ids[0]);
    by_preset("geo2sigmap", &file, &bytes, &["--assume", "tx_position_m=[10, -20, 80]"]);
}

/// Transmitters are told from the south-west corner, coordinates first; refused if several give
/// one map together, or one value for each face of a mesh.
#[test]
fn maps_of_sionna_large_radio_maps_are_read() {
    let file = format!("{}.npz", SITE.ids[0]);
    let archive = |shape: &str, positions: &[f32]| {
        let values = npy_raw("'<f4'", false, shape, &raw(&good_values(&SITE.ids[0])));
        let bytes: Vec<u8> = positions.iter().flat_map(|value| value.to_le_bytes()).collect();
        let positions = npy_raw("'<f4'", false, &format!("(3, {})", positions.len() / 3), &bytes);
        npz(&[("rm", values), ("tx_positions", positions)], zip::CompressionMethod::Stored)
    };
    by_preset("large-radio-maps", &file, &archive("(121, 121)", &[252.0, 222.0, 80.0]), &[]);

    let several = archive("(121, 121)", &[252.0, 9.0, 222.0, 9.0, 80.0, 9.0]);
    let faces = archive("(14641,)", &[252.0, 222.0, 80.0]);
    for (bytes, code, word) in
        [(several, "several_transmitters", "together"), (faces, "wrong_shape", "mesh")]
    {
        let dir = temporary_dir();
        let (maps, out) = (dir.path().join("maps"), dir.path().join("rsrp"));
        write(&maps.join(&file), bytes);
        let map_size = ["--assume", "map_size_m=484", "--preset", "large-radio-maps"];
        run(import(&maps, &SITE.tiles, &out).args(map_size).args(known())).succeeds();
        let rejected = String::from_utf8(read(&out.join("rejected.csv"))).expect("text");
        assert_says(&rejected, &[code, word]);
    }
}

#[test]
fn what_nobody_told_is_still_missing() {
    let dir = temporary_dir();
    let (maps, out) = (dir.path().join("maps"), dir.path().join("rsrp"));
    let bytes = npy_raw("'<f4'", false, "(121, 121)", &raw(&good_values(&SITE.ids[0])));
    write(&maps.join(format!("{}.npy", SITE.ids[0])), bytes);
    run(import(&maps, &SITE.tiles, &out).args(["--preset", "geo2sigmap"])).succeeds();
    let rejected = String::from_utf8(read(&out.join("rejected.csv"))).expect("text");
    assert_says(&rejected, &["missing_metadata", "tx_position_m", "frequency_hz", "rsrp.assume"]);
    let message = run(import(&maps, &SITE.tiles, &out).args(["--assume", "power=15"])).refused();
    assert_says(&message, &["rsrp.assume", "power", "tx_power_dbm"]);
}

// What ends a whole import ---------------------------------------------------------------

/// A directory with one good map.
fn one_map(dir: &TempDir) -> std::path::PathBuf {
    let maps = dir.path().join("maps");
    write_good(&maps.join("good.npz"), &SITE.ids[0]);
    maps
}

/// A copy of the site's tiles.
fn copied_tiles(dir: &TempDir) -> std::path::PathBuf {
    let tiles = dir.path().join("tiles");
    pipeline::plant(&tiles, &tree(&SITE.tiles));
    tiles
}

#[test]
fn tiles_must_be_finished_and_undamaged() {
    let dir = temporary_dir();
    let (maps, out) = (one_map(&dir), dir.path().join("rsrp"));
    let attempt = |tiles: &Path| {
        let message = run(&mut import(&maps, tiles, &out)).refused();
        assert!(!out.join("manifest.json").exists());
        message
    };
    let unfinished = dir.path().join("nothing");
    fs::create_dir(&unfinished).expect("created");
    assert_says(&attempt(&unfinished), &["nothing", "manifest.json", "holescout rasterise"]);
    assert_says(&attempt(&dir.path().join("absent")), &["absent", "holescout rasterise"]);

    let tiles = copied_tiles(&dir);
    let name = format!("{}.npz", SITE.ids[0]);
    let whole = read(&tiles.join(&name));
    write(&tiles.join(&name), &whole[..whole.len() / 2]);
    assert_says(&attempt(&tiles), &[&name, "expected", "found", "again"]);
    fs::remove_file(tiles.join(&name)).expect("removed");
    assert_says(&attempt(&tiles), &[&name]);
    write(&tiles.join(&name), &whole);

    write(&tiles.join("manifest.json"), "{\"schema\": \"tiles.v0\"}");
    assert_says(&attempt(&tiles), &["manifest.json", "tiles.v0", "tiles.v2"]);
    write(&tiles.join("manifest.json"), "{");
    assert_says(&attempt(&tiles), &["manifest.json", "JSON"]);
}

#[test]
fn without_any_map_there_is_nothing_to_import() {
    let dir = temporary_dir();
    let maps = dir.path().join("maps");
    write(&maps.join("README.md"), "soon");
    let out = dir.path().join("rsrp");
    let message = run(&mut import(&maps, &SITE.tiles, &out)).refused();
    assert_says(&message, &["maps", ".npz", ".npy"]);
    let absent = dir.path().join("absent");
    let message = run(&mut import(&absent, &SITE.tiles, &out)).refused();
    assert_says(&message, &["absent"]);
    assert!(!out.exists(), "nothing was begun");
}

#[test]
fn an_occupied_directory_is_left_alone() {
    let dir = temporary_dir();
    let (maps, out) = (one_map(&dir), dir.path().join("rsrp"));
    write(&out.join("thesis.tex"), "ten years of work");
    for flags in [&[][..], &["--overwrite"]] {
        let message = run(import(&maps, &SITE.tiles, &out).args(flags)).refused();
        assert_says(&message, &["rsrp", "thesis.tex", "another directory"]);
        assert!(!message.contains("--overwrite"), "that would not help: {message}");
        assert_eq!(tree(&out).len(), 1);
    }
    // Tiles are of another stage: not even --overwrite replaces them.
    let tiles = copied_tiles(&dir);
    let before = tree(&tiles);
    let message = run(import(&maps, &SITE.tiles, &tiles).arg("--overwrite")).refused();
    assert_says(&message, &["tiles"]);
    pipeline::assert_same_files(&tree(&tiles), &before);
}

#[test]
fn maps_of_other_inputs_are_replaced_only_on_request() {
    let dir = temporary_dir();
    let (maps, out) = (one_map(&dir), dir.path().join("rsrp"));
    run(&mut import(&maps, &SITE.tiles, &out)).succeeds();
    let first = tree(&out);
    write_good(&maps.join("another.npz"), &SITE.ids[1]);
    fs::remove_file(maps.join("good.npz")).expect("removed");
    let message = run(&mut import(&maps, &SITE.tiles, &out)).refused();
    assert_says(&message, &["--overwrite", "rsrp"]);
    pipeline::assert_same_files(&tree(&out), &first);
    run(import(&maps, &SITE.tiles, &out).arg("--overwrite")).succeeds();
    let names: Vec<String> = tree(&out).into_keys().collect();
    let map = format!("{}.npz", SITE.ids[1]);
    assert_eq!(names, ["SHA256SUMS", "import.csv", "manifest.json", "rejected.csv", &map]);
    run(&mut verify(&out)).succeeds();
}

/// Metadata beside an `.npy` are as much an input as the array.
#[test]
fn a_changed_sidecar_is_another_input() {
    let dir = temporary_dir();
    let (maps, out) = (dir.path().join("maps"), dir.path().join("rsrp"));
    let values = npy(&good_values(&SITE.ids[0]), Layout::plain(Float::F4));
    let mut metadata = metadata(&SITE.ids[0], Window::Coarse);
    metadata["value_kind"] = json!("path_gain_linear");
    write(&maps.join("map.npy"), &values);
    write(&maps.join("map.json"), metadata.to_string());
    run(&mut import(&maps, &SITE.tiles, &out)).succeeds();
    metadata["tx_power_dbm"] = json!(POWER_PER_RE + 1.0);
    write(&maps.join("map.json"), metadata.to_string());
    let message = run(&mut import(&maps, &SITE.tiles, &out)).refused();
    assert_says(&message, &["other inputs", "--overwrite"]);

    let manifest = read_json(&out.join("manifest.json"));
    let digest = json!({"bytes": values.len(), "sha256": sha256(&values)});
    assert_eq!(manifest["maps"][0]["source"]["digest"], digest, "that of the .npy, as documented");
}

#[test]
fn json_summary_counts_what_was_imported() {
    let dir = temporary_dir();
    let (maps, out) = (one_map(&dir), dir.path().join("rsrp"));
    write_good(&maps.join("dropped.npz"), DROPPED_TILE);
    let stdout = run(import(&maps, &SITE.tiles, &out).arg("--json")).succeeds();
    let last = stdout.lines().last().expect("a line");
    let summary: Value = serde_json::from_str(last).expect("JSON");
    assert_eq!(summary["imported"], 1);
    assert_eq!(summary["rejected"], 1);
    assert_eq!(summary["rejected_by_code"], json!({"tile_dropped": 1}));
}
