//! Maps of several repeats, from their arrays to records with errors and everything that reads these;
//! what was recomputed here cell by cell, what is rejected, and that maps without repeats are as ever.

#![expect(clippy::float_cmp, reason = "values that must be exact are compared exactly")]

mod pipeline;

use std::collections::BTreeMap;
use std::path::Path;

use holescout::dataset::{Dataset, Grids, Record};
use holescout::grid::TileId;
use ndarray::{Array2, Axis, Zip, stack};
use serde_json::{Value, json};

use pipeline::importing::Import;
use pipeline::maps::{POWER_PER_RE, SITE, Window, metadata, write_good, write_npz};
use pipeline::numpy::{Float, Layout, matrix, npy, npz_members};
use pipeline::repeats::{
    REPEATED, REPEATS, Repeated, SAMPLES, Traces, f4, metadata_of_repeats, write_arrays,
    write_repeats,
};
use pipeline::{
    assert_same_files, assert_says, fixture, holescout, import, read, read_json, release, run,
    shard, temporary_dir, tree, verify, write,
};

/// 10 / ln 10: decibels of a relative error.
const DECIBELS: f64 = 4.342_944_819_032_518;
/// `scipy.stats.t.ppf(0.95, 7)`.
const QUANTILE: f64 = 1.894_578_605_090_006;

fn north_up(mut values: Array2<f64>) -> Array2<f64> {
    values.invert_axis(Axis(0));
    values
}

/// Levels, errors and shares of a tile's traces, row 0 north; zeros where no path arrives.
fn expected(tile: &str) -> (Array2<f64>, Array2<f64>, Array2<f64>) {
    let traces = Traces::of(tile);
    let (mean, error) = (north_up(traces.mean()), north_up(traces.std_error()));
    let half = north_up(traces.first_half());
    let of_mean = |values: &Array2<f64>, scale: f64| {
        let pairs = Zip::from(values).and(&mean);
        pairs.map_collect(|value, &mean| if mean > 0.0 { scale * value / mean } else { 0.0 })
    };
    let level = mean.mapv(|gain| POWER_PER_RE + 10.0 * gain.log10());
    (level, of_mean(&error, DECIBELS), of_mean(&half, 0.5))
}

fn close(a: f64, b: f64, by: f64) -> bool {
    (a - b).abs() <= by
}

#[test]
fn imported_maps_carry_errors_of_their_levels() {
    let manifest = read_json(&REPEATED.rsrp.join("manifest.json"));
    assert_eq!((&manifest["rejected"], &manifest["solvers"][0]["maps"]), (&json!({}), &json!(10)));
    for (tile, entry) in SITE.ids.iter().zip(manifest["maps"].as_array().expect("maps")) {
        let arrays = npz_members(&REPEATED.rsrp.join(format!("{tile}.npz")));
        let [mask, level, error, share] = ["mask", "rsrp_dbm", "std_error_db", "first_half_share"]
            .map(|name| matrix(&arrays[name]));
        let (levels, errors, shares) = expected(tile);
        let (mut outdoors, mut unsure) = (0, 0);
        for (at, &kind) in mask.indexed_iter() {
            outdoors += usize::from(kind != 1.0);
            if kind == 0.0 {
                assert!(close(level[at], levels[at], 1e-4) && close(error[at], errors[at], 1e-5));
                assert!(close(share[at], shares[at], 1e-6));
                let sure = QUANTILE * error[at] <= (level[at] + 100.0).abs();
                unsure += usize::from(!sure);
            } else {
                assert_eq!((error[at], share[at]), (0.0, 0.0));
            }
        }
        assert!(unsure > 50, "{unsure}");
        let reliability = &entry["quality"]["reliability"];
        assert_eq!(reliability["repeats"], REPEATS);
        let found = reliability["unsure"].as_f64().expect("a share");
        assert!(close(found, unsure as f64 / outdoors as f64, 1e-4), "{found}");
        // All rays count: those of one repeat would be too few.
        assert!(entry["quality"]["expected_rays"].as_f64().expect("rays") > 10.0);
        assert_eq!(entry["warnings"], json!([]));
    }
    let table = String::from_utf8(read(&REPEATED.rsrp.join("import.csv"))).expect("text");
    assert_says(
        table.lines().next().expect("a header"),
        &["warnings,repeats,median_std_error_db,unsure"],
    );
    run(&mut verify(&REPEATED.rsrp)).succeeds();
}

#[test]
fn records_hold_levels_and_errors_as_integers() {
    let dataset = Dataset::open(&REPEATED.dataset).expect("opened");
    let ids = dataset.ids();
    assert!(ids.len() >= 4, "{}", ids.len());
    for (id, _) in ids {
        let (record, grids) = dataset.record_with_grids(id).expect("read");
        assert_eq!((record.schema.as_str(), record.repeats), ("record.v2", Some(REPEATS)));
        assert_eq!(record.radio.samples_per_tx, SAMPLES);
        assert_eq!(record.clone().with_grids(&grids), record, "the same bytes again");
        let (levels, errors, shares) = expected(&id.to_string());
        let Grids { rsrp_dbm, mask, errors: Some(found), .. } = &grids else {
            unreachable!("errors");
        };
        let found_shares = found.first_half_share.as_ref().expect("shares");
        for (at, &kind) in mask.indexed_iter().filter(|(_, kind)| **kind == 0) {
            assert!(close(rsrp_dbm[at].into(), levels[at], 0.006), "{at:?} {kind}");
            assert!(close(found.std_error_db[at].into(), errors[at], 0.01), "{at:?}");
            assert!(errors[at] == 0.0 || found.std_error_db[at] > 0.0);
            assert!(close(found_shares[at].into(), shares[at], 0.0041), "{at:?}");
            let hundredths = f64::from(rsrp_dbm[at]) * 100.0;
            assert!(close(hundredths, hundredths.round(), 1e-2));
        }
    }
}

#[test]
fn statistics_count_what_is_unsure() {
    let dataset = Dataset::open(&REPEATED.dataset).expect("opened");
    let mut unsure: BTreeMap<String, u64> = BTreeMap::new();
    for (id, split) in dataset.ids() {
        let (_, grids) = dataset.record_with_grids(id).expect("read");
        let errors = grids.errors.expect("errors").std_error_db;
        let cells = grids.mask.iter().zip(&grids.rsrp_dbm).zip(&errors);
        let count = cells
            .filter(|((kind, rsrp), error)| {
                let lacking = QUANTILE * f64::from(**error) - (f64::from(**rsrp) + 100.0).abs();
                **kind == 0 && lacking > 0.0
            })
            .count();
        *unsure.entry(split.to_string()).or_default() += count as u64;
    }
    let manifest = read_json(&REPEATED.dataset.join("manifest.json"));
    let mut outdoors = 0;
    for (split, count) in &unsure {
        let statistics = &manifest["statistics"][split];
        let reliability = &statistics["reliability"];
        assert_eq!(
            (&reliability["unsure"], &reliability["records"]),
            (&json!(count), &statistics["records"])
        );
        let shifts = reliability["threshold_shift"]["counts"].as_array().expect("counts").iter();
        assert_eq!(shifts.map(|count| count.as_u64().expect("a count")).sum::<u64>(), *count);
        outdoors += reliability["outdoor"].as_u64().expect("cells");
    }
    let share = 100.0 * unsure.values().sum::<u64>() as f64 / outdoors as f64;
    let card = String::from_utf8(read(&REPEATED.dataset.join("README.md"))).expect("text");
    let told = format!("{share:.1} % of their outdoor cells are unsure");
    assert_says(&card, &[&told, "record.v2", "level / 100", "scipy.stats.t.cdf", "nine tenths"]);
    let croissant = read_json(&REPEATED.dataset.join("croissant.json"));
    assert_says(croissant["description"].as_str().expect("text"), &[&told]);
    assert_eq!(croissant["geocr:bandConfiguration"]["geocr:totalBands"], 5);
}

#[test]
fn everything_that_reads_datasets_reads_them() {
    let Repeated { maps, dataset, .. } = &*REPEATED;
    assert_says(&run(&mut verify(dataset)).succeeds(), &["sound"]);
    let mut rebuild = verify(dataset);
    rebuild.args(["--rebuild", "--osm"]).arg(fixture("helsinki/helsinki.osm.pbf"));
    assert_says(&run(rebuild.arg("--maps").arg(maps)).succeeds(), &["have the same SHA-256"]);
    let said = run(holescout("inspect").arg(dataset)).succeeds();
    assert_says(&said, &["holes with a chance of 5 to 95 %"]);

    let manifest = read_json(&dataset.join("manifest.json"));
    let id = manifest["records"][0]["id"].as_str().expect("a name");
    let dir = temporary_dir();
    let mut inspect = holescout("inspect");
    inspect.arg(dataset).args(["--id", id, "--png"]).arg(dir.path().join("record.png"));
    assert_says(&run(&mut inspect).succeeds(), &["holes with a chance of 5 to 95 %"]);
    let json = run(holescout("inspect").arg(dataset).args(["--json", "--id", id])).succeeds();
    let record: Value = serde_json::from_str(json.trim_end()).expect("JSON");
    for name in ["std_error_db", "first_half_share"] {
        assert_eq!(record[name].as_array().map(Vec::len), Some(121), "{name}");
    }
    let table = dir.path().join("records.csv");
    run(holescout("inspect").arg(dataset).arg("--csv").arg(&table)).succeeds();
    let table = String::from_utf8(read(&table)).expect("text");
    assert_says(&table, &["frame,repeats,unsure_share\n", ",8,0."]);

    let out = dir.path().join("release");
    run(&mut release(dataset, "1.0.0", &out)).succeeds();
    run(&mut verify(&out)).succeeds();
    for schema in ["record.v1.json", "record.v2.json"] {
        let committed = Path::new(env!("CARGO_MANIFEST_DIR")).join("schemas").join(schema);
        assert!(read(&out.join(schema)) == read(&committed), "{schema}");
    }
    let said = run(holescout("diff").arg(dataset).arg(&out)).succeeds();
    assert_says(&said, &["step: minor"]);
}

#[test]
fn errors_that_differ_are_other_values() {
    let dir = temporary_dir();
    let (maps, rsrp, other) =
        (dir.path().join("maps"), dir.path().join("rsrp"), dir.path().join("dataset"));
    for tile in &SITE.ids {
        let traces = Traces::of(tile);
        let arrays = [
            ("path_gain", f4(&traces.mean())),
            ("path_gain_std_error", f4(&(0.5 * traces.std_error()))),
        ];
        write_arrays(&maps.join(format!("{tile}.npz")), &arrays, &metadata_of_repeats(tile));
    }
    run(&mut import(&maps, &SITE.tiles, &rsrp)).succeeds();
    run(&mut shard(&SITE.tiles, &rsrp, &other)).succeeds();
    run(&mut verify(&other)).succeeds();
    let said = run(holescout("diff").arg(&REPEATED.dataset).arg(&other).arg("--json")).succeeds();
    let diff: Value = serde_json::from_str(said.trim_end()).expect("JSON");
    assert_eq!(diff["step"], "major");
    let fields = &diff["records"]["changed"][0]["fields"];
    assert_eq!(*fields, json!(["std_error_db", "first_half_share", "provenance"]));
}

#[test]
fn the_same_bytes_with_any_number_of_threads() {
    for threads in ["1", "2", "8"] {
        let dir = temporary_dir();
        let (rsrp, dataset) = (dir.path().join("rsrp"), dir.path().join("dataset"));
        let threads = ["--threads", threads];
        run(import(&REPEATED.maps, &SITE.tiles, &rsrp).args(threads)).succeeds();
        run(shard(&SITE.tiles, &rsrp, &dataset).args(threads)).succeeds();
        assert_same_files(&tree(&rsrp), &tree(&REPEATED.rsrp));
        assert_same_files(&tree(&dataset), &tree(&REPEATED.dataset));
    }
}

/// Maps of both kinds make one dataset; those without repeats become the records that they always
/// were.
#[test]
fn a_map_without_repeats_stays_as_it_was() {
    let build = |with_repeats: bool| {
        let dir = temporary_dir();
        let (maps, rsrp, dataset) =
            (dir.path().join("maps"), dir.path().join("rsrp"), dir.path().join("dataset"));
        for (at, tile) in SITE.ids.iter().enumerate() {
            let path = maps.join(format!("{tile}.npz"));
            if with_repeats && at % 2 == 0 {
                write_repeats(&path, tile);
            } else {
                write_good(&path, tile);
            }
        }
        run(&mut import(&maps, &SITE.tiles, &rsrp)).succeeds();
        run(&mut shard(&SITE.tiles, &rsrp, &dataset)).succeeds();
        run(&mut verify(&dataset)).succeeds();
        (dir, dataset)
    };
    let ((_mixed_dir, mixed), (_dir, plain)) = (build(true), build(false));
    let card = String::from_utf8(read(&mixed.join("README.md"))).expect("text");
    assert_says(&card, &["records were traced once: how sure their holes are is unknown"]);
    let [mixed, plain] = [mixed, plain].map(|root| Dataset::open(&root).expect("opened"));
    let mut schemas = BTreeMap::new();
    for (id, _) in mixed.ids() {
        let record: Record = mixed.record(id).expect("read");
        *schemas.entry(record.schema.clone()).or_insert(0) += 1;
        if record.schema == "record.v1" {
            assert_eq!(record.encode(), plain.record(id).expect("read").encode());
        }
    }
    assert_eq!(schemas.keys().collect::<Vec<_>>(), ["record.v1", "record.v2"], "{schemas:?}");
}

// Every way of writing them ----------------------------------------------------------------

/// Imports one map of the first tile; returns its levels, errors and shares.
fn imported(
    path: &str,
    arrays: &[(&str, Vec<u8>)],
    metadata: &Value,
    flags: &[&str],
) -> [Array2<f64>; 3] {
    let dir = temporary_dir();
    let (maps, out) = (dir.path().join("maps"), dir.path().join("rsrp"));
    write_arrays(&maps.join(path), arrays, metadata);
    run(import(&maps, &SITE.tiles, &out).args(flags)).succeeds();
    let rejected = String::from_utf8(read(&out.join("rejected.csv"))).expect("text");
    assert_eq!(rejected.lines().count(), 1, "{rejected}");
    let arrays = npz_members(&out.join(format!("{}.npz", SITE.ids[0])));
    ["rsrp_dbm", "std_error_db", "first_half_share"].map(|name| matrix(&arrays[name]))
}

#[test]
fn any_kind_of_values_gives_the_same_errors() {
    let tile = &SITE.ids[0];
    let traces = Traces::of(tile);
    let [mean, error, half] = [traces.mean(), traces.std_error(), traces.first_half()];
    let known = metadata_of_repeats(tile);
    let arrays = [
        ("path_gain", f4(&mean)),
        ("path_gain_std_error", f4(&error)),
        ("path_gain_first_half", f4(&half)),
    ];
    let reference = imported("map.npz", &arrays, &known, &[]);
    let same = |found: &[Array2<f64>; 3], what: &str| {
        for (found, reference) in found.iter().zip(&reference) {
            let most =
                Zip::from(found).and(reference).fold(0.0_f64, |most, a, b| most.max((a - b).abs()));
            assert!(most < 1e-3, "{what}: {most}");
        }
    };

    // Watts, for 15 dBm.
    let watts =
        |values: &Array2<f64>| npy(&(values * 10.0_f64.powf(-1.5)), Layout::plain(Float::F8));
    let arrays =
        [("rss", watts(&mean)), ("rss_std_error", watts(&error)), ("rss_first_half", watts(&half))];
    let mut metadata = known.clone();
    metadata["value_kind"] = json!("rss_w");
    same(&imported("map.npz", &arrays, &metadata, &[]), "rss_w");

    // Decibels; the error is that of the linear mean, relative to it.
    let relative = Zip::from(&error)
        .and(&mean)
        .map_collect(|error, &mean| if mean > 0.0 { DECIBELS * error / mean } else { f64::NAN });
    for (array, sign, north_first) in [("path_gain_db", 1.0, false), ("path_loss_db", -1.0, true)] {
        let decibels = |values: &Array2<f64>| values.mapv(|gain| sign * 10.0 * gain.log10());
        let mut metadata = known.clone();
        metadata["no_path_value"] = json!(if sign > 0.0 { "-inf" } else { "inf" });
        let turned = |values: Array2<f64>| if north_first { north_up(values) } else { values };
        if north_first {
            metadata["row_order"] = json!("north_first");
        }
        let names = [array.to_owned(), format!("{array}_std_error"), format!("{array}_first_half")];
        let values = [decibels(&mean), relative.clone(), decibels(&half)];
        let arrays: Vec<(&str, Vec<u8>)> = names
            .iter()
            .map(String::as_str)
            .zip(values.map(|values| f4(&turned(values))))
            .collect();
        same(&imported("map.npz", &arrays, &metadata, &[]), array);
    }

    // One of several transmitters, each with its errors.
    let layered = |values: &Array2<f64>| {
        let layers = [values.mapv(|value| 0.5 * value), values.clone()];
        let stacked = stack(Axis(0), &[layers[0].view(), layers[1].view()]).expect("equal shapes");
        let bytes: Vec<u8> =
            stacked.iter().flat_map(|&value| (value as f32).to_le_bytes()).collect();
        pipeline::numpy::npy_raw("'<f4'", false, "(2, 121, 121)", &bytes)
    };
    let arrays = [
        ("path_gain", layered(&mean)),
        ("path_gain_std_error", layered(&error)),
        ("path_gain_first_half", layered(&half)),
    ];
    let mut metadata = known.clone();
    let position = metadata["tx_position_m"].clone();
    metadata["tx_position_m"] = json!([position, position]);
    same(&imported("map.npz", &arrays, &metadata, &["--tx", "1"]), "two transmitters");
}

/// Sixteen cells of 1 m with independent errors make one of 4 m.
#[test]
fn errors_of_fine_maps_become_smaller_in_coarse_records() {
    let dir = temporary_dir();
    let (maps, rsrp, out) =
        (dir.path().join("maps"), dir.path().join("rsrp"), dir.path().join("dataset"));
    for tile in &SITE.ids {
        let mut metadata = metadata(tile, Window::Crop);
        (metadata["repeats"], metadata["direction_shift"]) = (json!(REPEATS), json!("random"));
        let mut rsrp = pipeline::maps::physical(3, tile, Window::Crop);
        rsrp.invert_axis(Axis(0));
        let gain = rsrp.mapv(|rsrp| {
            if rsrp.is_nan() { 0.0 } else { 10.0_f64.powf((rsrp - POWER_PER_RE) / 10.0) }
        });
        let arrays = [("path_gain", f4(&gain)), ("path_gain_std_error", f4(&(0.2 * &gain)))];
        write_arrays(&maps.join(format!("{tile}.npz")), &arrays, &metadata);
    }
    run(&mut import(&maps, &SITE.tiles, &rsrp)).succeeds();
    run(&mut shard(&SITE.tiles, &rsrp, &out)).succeeds();
    let dataset = Dataset::open(&out).expect("opened");
    let id: TileId = dataset.ids()[0].0;
    let fine = npz_members(&rsrp.join(format!("{id}.npz")));
    let [levels, kinds] = ["rsrp_dbm", "mask"].map(|name| matrix(&fine[name]));
    let (_, grids) = dataset.record_with_grids(id).expect("read");
    let errors = grids.errors.expect("errors");
    assert!(errors.first_half_share.is_none(), "nobody told halves");
    for (at, &error) in errors.std_error_db.indexed_iter() {
        let cells = (0..16).map(|cell| [4 * at.0 + cell / 4, 4 * at.1 + cell % 4]);
        let powers =
            cells.filter(|&cell| kinds[cell] == 0.0).map(|cell| 10.0_f64.powf(levels[cell] / 10.0));
        let (sum, squares) =
            powers.fold((0.0, 0.0), |(sum, squares), p| (sum + p, squares + p * p));
        let relative = if sum > 0.0 { 0.2 * squares.sqrt() / sum } else { 0.0 };
        assert!(close(error.into(), DECIBELS * relative, 0.0051), "{at:?}: {error} {relative}");
    }
}

// What is rejected --------------------------------------------------------------------------

/// Arrays and metadata of a map that a case spoils and then mends.
struct Draft {
    file: &'static str,
    arrays: Vec<(&'static str, Vec<u8>)>,
    metadata: Value,
}

impl Draft {
    fn new() -> Self {
        let traces = Traces::of(&SITE.ids[0]);
        let arrays = vec![
            ("path_gain", f4(&traces.mean())),
            ("path_gain_std_error", f4(&traces.std_error())),
            ("path_gain_first_half", f4(&traces.first_half())),
        ];
        Self { file: "bad.npz", arrays, metadata: metadata_of_repeats(&SITE.ids[0]) }
    }

    fn set(&mut self, key: &str, value: Value) {
        self.metadata[key] = value;
    }

    fn replace(&mut self, at: usize, change: impl Fn(f64) -> f64) {
        let values = matrix(&self.arrays[at].1);
        self.arrays[at].1 = f4(&values.mapv(change));
    }

    fn write(&self, import: &Import) {
        write_arrays(&import.map(self.file), &self.arrays, &self.metadata);
    }
}

const ERROR: usize = 1;
const HALF: usize = 2;

fn sound() -> Traces {
    Traces::of(&SITE.ids[0])
}

/// Code, what spoils a map, words that are told, and what the mend asks for.
type Case = (&'static str, fn(&mut Draft), &'static [&'static str], fn(&mut Draft));

const CASES: &[Case] = &[
    (
        "error_missing",
        |bad| bad.arrays.truncate(1),
        &["path_gain_std_error", "repeats = 8", "samples_per_tx"],
        |bad| {
            bad.metadata.as_object_mut().expect("keys").remove("repeats");
            bad.set("samples_per_tx", json!(u64::from(REPEATS) * SAMPLES));
        },
    ),
    (
        "error_missing",
        |bad| bad.arrays.truncate(1),
        &["sample standard deviation / sqrt(repeats)"],
        |bad| bad.arrays.push(("path_gain_std_error", f4(&sound().std_error()))),
    ),
    (
        "error_without_repeats",
        |bad| {
            bad.metadata.as_object_mut().expect("keys").remove("repeats");
        },
        &["path_gain_std_error", "no repeats", "number of repeats"],
        |bad| bad.set("repeats", json!(8)),
    ),
    (
        "error_without_repeats",
        |bad| {
            bad.arrays.remove(ERROR);
            bad.set("repeats", json!(1));
        },
        &["path_gain_first_half", "repeats = 1", "leave the array out"],
        |bad| {
            bad.arrays.truncate(1);
            bad.set("samples_per_tx", json!(30_000_000));
        },
    ),
    (
        "error_shape",
        |bad| bad.arrays[ERROR].1 = f4(&Array2::zeros((120, 121))),
        &["path_gain_std_error", "[120, 121]", "[121, 121]"],
        |bad| bad.arrays[ERROR].1 = f4(&sound().std_error()),
    ),
    (
        "error_shape",
        |bad| bad.arrays[HALF].1 = f4(&Array2::zeros((60, 60))),
        &["path_gain_first_half", "[60, 60]"],
        |bad| bad.arrays.truncate(HALF),
    ),
    (
        "error_out_of_range",
        |bad| bad.replace(ERROR, |error| -error),
        &["-", "0 to the mean", "sqrt(repeats)"],
        |bad| bad.replace(ERROR, |error| -error),
    ),
    (
        "error_out_of_range",
        |bad| bad.replace(ERROR, |error| if error > 0.0 { f64::NAN } else { 0.0 }),
        &["NaN"],
        |bad| bad.arrays[ERROR].1 = f4(&sound().std_error()),
    ),
    (
        // The standard deviation of one repeat.
        "error_out_of_range",
        |bad| bad.replace(ERROR, |error| error * 8.0_f64.sqrt()),
        &["sample standard deviation / sqrt(repeats)"],
        |bad| bad.replace(ERROR, |error| error / 8.0_f64.sqrt()),
    ),
    (
        "error_out_of_range",
        |bad| bad.replace(ERROR, |error| error.max(1e-12)),
        &["beside 0", "0 where no path arrives"],
        |bad| bad.arrays[ERROR].1 = f4(&sound().std_error()),
    ),
    (
        "half_out_of_range",
        |bad| bad.replace(HALF, |half| -half),
        &["first half", "unit of the values"],
        |bad| bad.arrays[HALF].1 = f4(&sound().first_half()),
    ),
    (
        // Of other repeats than those whose mean and error are there.
        "half_out_of_range",
        |bad| bad.replace(HALF, |half| 1.3 * half),
        &["sqrt(repeats - 1)"],
        |bad| bad.arrays[HALF].1 = f4(&sound().first_half()),
    ),
    (
        "half_out_of_range",
        |bad| bad.set("repeats", json!(7)),
        &["even", "repeats = 7", "leave the array out"],
        |bad| bad.arrays.truncate(HALF),
    ),
    (
        "unsupported_type",
        |bad| bad.arrays[ERROR].1 = npy(&sound().std_error(), Layout::plain(Float::F2)),
        &["path_gain_std_error of float16", "float32"],
        |bad| bad.arrays[ERROR].1 = f4(&sound().std_error()),
    ),
    (
        "invalid_metadata",
        |bad| bad.set("repeats", json!(0)),
        &["repeats = 0"],
        |bad| bad.set("repeats", json!(8.0)),
    ),
    (
        "invalid_metadata",
        |bad| bad.set("direction_shift", json!("sometimes")),
        &["direction_shift", "sometimes"],
        |bad| bad.set("direction_shift", json!("random")),
    ),
];

#[test]
fn errors_that_do_not_fit_are_named_and_their_mends_work() {
    let mut wrong = vec![];
    for (number, (code, spoil, words, mend)) in CASES.iter().enumerate() {
        let import = Import::new();
        let mut draft = Draft::new();
        spoil(&mut draft);
        draft.write(&import);
        let rejected = import.only_rejection();
        let text = format!("{} | {} | {}", rejected.expected, rejected.found, rejected.mend);
        if rejected.code != *code || !words.iter().all(|word| text.contains(word)) {
            wrong.push(format!("case {number}: {code} and {words:?} expected of {rejected:?}"));
        }
        mend(&mut draft);
        draft.write(&import);
        run(import.command().arg("--overwrite")).succeeds();
        let left = import.listed();
        if !left.is_empty() {
            wrong.push(format!("case {number}: still rejected: {left:?}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// In decibels an error has a bound of its own.
#[test]
fn decibels_that_no_error_of_a_mean_can_be_are_named() {
    let import = Import::new();
    let traces = sound();
    let decibels = traces.mean().mapv(|gain| 10.0 * gain.log10());
    let mut metadata = metadata_of_repeats(&SITE.ids[0]);
    metadata["no_path_value"] = json!("-inf");
    let error = decibels.mapv(|gain| if gain.is_finite() { 6.0 } else { 0.0 });
    let arrays = [("path_gain_db", f4(&decibels)), ("path_gain_db_std_error", f4(&error))];
    write_arrays(&import.map("bad.npz"), &arrays, &metadata);
    let rejected = import.only_rejection();
    assert_eq!(rejected.code, "error_out_of_range");
    assert_says(&rejected.expected, &["4.343 dB"]);
    assert_says(&rejected.mend, &["10 / ln 10", "of the linear values"]);
}

#[test]
fn a_bare_array_cannot_have_several_repeats() {
    let import = Import::new();
    let mut metadata = metadata_of_repeats(&SITE.ids[0]);
    metadata["value_kind"] = json!("path_gain_linear");
    write(&import.map("bad.npy"), f4(&sound().mean()));
    write(&import.map("bad.json"), metadata.to_string());
    let rejected = import.only_rejection();
    assert_eq!(rejected.code, "error_missing");
    assert_says(&rejected.mend, &["save map and error as .npz", "leave repeats out"]);
}

/// Sionna's seed does not make repeats independent, so somebody has to say that something did.
#[test]
fn repeats_that_may_depend_on_each_other_are_warned_of() {
    let import = Import::new();
    let mut draft = Draft::new();
    draft.file = "map.npz";
    draft.metadata.as_object_mut().expect("keys").remove("direction_shift");
    draft.write(&import);
    assert_eq!(import.rejected(), []);
    let manifest = read_json(&import.out().join("manifest.json"));
    let warnings = manifest["maps"].as_array().expect("maps").iter();
    let warnings: Vec<&Value> =
        warnings.flat_map(|map| map["warnings"].as_array().expect("a list")).collect();
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert_eq!(warnings[0]["code"], "dependent_repeats");
    assert_says(warnings[0]["text"].as_str().expect("text"), &["direction_shift"]);
}

/// A single repeat is a trace as ever.
#[test]
fn one_repeat_has_no_error() {
    let dir = temporary_dir();
    let tile = &SITE.ids[0];
    let of = |name: &str, repeats: Option<u32>| {
        let maps = dir.path().join(name);
        let mut metadata = metadata(tile, Window::Coarse);
        if let Some(repeats) = repeats {
            metadata["repeats"] = json!(repeats);
        }
        let values = f4(&pipeline::maps::good_values(tile));
        write_npz(&maps.join("map.npz"), "path_gain", values, &metadata);
        let out = dir.path().join(format!("{name} imported"));
        run(&mut import(&maps, &SITE.tiles, &out)).succeeds();
        let mut files = tree(&out);
        let members = npz_members(&out.join(format!("{tile}.npz")));
        files.retain(|name, _| name == "import.csv");
        (files, members.keys().cloned().collect::<Vec<_>>())
    };
    assert_eq!(of("one", Some(1)), of("none", None));
}
