//! `import-rsrp` takes no map that breaks the contract: each is listed with the named
//! reason, what was expected, what was found and the mend, and the other maps of the
//! directory are imported all the same.

#![expect(clippy::float_cmp, reason = "values that must be exact are compared exactly")]

mod pipeline;

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use ndarray::{Array2, Axis, s};
use serde_json::{Value, json};
use zip::CompressionMethod;

use pipeline::importing::{Import, Rejected, good_tile};
use pipeline::maps::{DROPPED_TILE, SITE, Window, metadata, write_good, write_npz};
use pipeline::numpy::{Float, Layout, npy, npy_raw, npy_text, npz};
use pipeline::{assert_says, read_json, run, shard, tree, write};

// One file for every code ----------------------------------------------------------------

/// A map of the first tile that is sound until a case spoils it.
struct Draft {
    file: &'static str,
    array: &'static str,
    values: Vec<u8>,
    metadata: Value,
}

impl Draft {
    fn new() -> Self {
        Self {
            file: "bad.npz",
            array: "path_gain",
            values: f4(&good_values()),
            metadata: metadata(&SITE.ids[0], Window::Coarse),
        }
    }

    fn write(&self, import: &Import) {
        write_npz(&import.map(self.file), self.array, self.values.clone(), &self.metadata);
    }

    /// A key of the metadata.
    fn set(&mut self, key: &str, value: Value) {
        self.metadata[key] = value;
    }

    /// Decibels instead of gains, with a value for cells without a path.
    fn in_decibels(&mut self, no_path: f64) {
        self.array = "path_gain_db";
        self.values = f4(&decibels(no_path));
    }
}

/// A sound map of the first tile, row 0 south.
fn good_values() -> Array2<f64> {
    pipeline::maps::good_values(&SITE.ids[0])
}

fn f4(values: &Array2<f64>) -> Vec<u8> {
    npy(values, Layout::plain(Float::F4))
}

fn decibels(no_path: f64) -> Array2<f64> {
    good_values().mapv(|gain| if gain == 0.0 { no_path } else { 10.0 * gain.log10() })
}

fn cube(shape: &str) -> Vec<u8> {
    let gains: Vec<u8> = good_values().iter().flat_map(|&g| (g as f32).to_le_bytes()).collect();
    npy_raw("'<f4'", false, shape, &gains.repeat(3))
}

/// A place whose building has a tagged height, as east and north of the centre, and that height.
fn tagged_roof(tile: &str) -> (f64, f64, f64) {
    let sources = SITE.crop(tile, "height_source");
    let heights = SITE.crop(tile, "height_m");
    let half = sources.nrows() as f64 / 2.0;
    let tagged = sources.indexed_iter().find(|(_, source)| **source == 1.0);
    let ((row, column), _) = tagged.expect("a building with a height tag");
    let (east, north) = (column as f64 + 0.5 - half, half - row as f64 - 0.5);
    (east, north, heights[[row, column]])
}

type Spoil = fn(&Import, Draft);

/// Spoils a draft and writes it.
macro_rules! spoiled {
    ($draft:ident => $change:expr) => {
        |import, mut $draft| {
            $change;
            $draft.write(import);
        }
    };
}

/// A map as if its first rows and columns had been lost and what follows had moved up.
fn moved(values: &Array2<f64>, rows: usize, columns: usize) -> Array2<f64> {
    let (height, width) = values.dim();
    Array2::from_shape_fn((height, width), |(row, column)| {
        values[[(row + rows) % height, (column + columns) % width]]
    })
}

/// Codes, files that cause them, and words that must be in expected, found or mend.
const CASES: &[(&str, Spoil, &[&str])] = &[
    (
        "unsupported_format",
        |import, _| write(&import.map("bad.h5"), "\x7fHDF"),
        &["h5py", "np.savez"],
    ),
    (
        "unsupported_format",
        |import, _| write(&import.map("bad.hdf5"), "\x7fHDF"),
        &["h5py", "np.savez"],
    ),
    (
        "unsupported_format",
        |import, _| write(&import.map("bad.mat"), "MATLAB 5.0"),
        &["scipy.io.loadmat", "np.savez"],
    ),
    (
        "unsupported_format",
        |import, _| write(&import.map("bad.png"), "\x7fPNG"),
        &["image", "np.savez"],
    ),
    (
        "unsupported_format",
        |import, _| write(&import.map("bad.csv"), "x,y,z\n"),
        &["np.loadtxt", "np.savez"],
    ),
    ("unsupported_format", |import, _| write(&import.map("bad.pkl"), "\x7f"), &["pkl", "np.savez"]),
    (
        "unsupported_format",
        |import, _| write(&import.map("bad.pickle"), "\x7f"),
        &["pickle", "np.savez"],
    ),
    ("damaged", |import, _| write(&import.map("bad.npz"), "PK\x03\x04"), &["npz", "again"]),
    (
        "damaged",
        spoiled!(bad => bad.values = npy_raw("'<f4'", false, "(121, 121)", &[0; 100])),
        &["121", "58564", "100"],
    ),
    (
        "pickled",
        spoiled!(bad => bad.values = npy_raw("'|O'", false, "()", b"\x80\x04.")),
        &["pickle", "np.savez"],
    ),
    (
        "too_large",
        spoiled!(bad => {
            bad.metadata = metadata(&SITE.ids[0], Window::Crop);
            bad.values = npy(&Array2::from_elem((484, 484), 1e-9), Layout::plain(Float::F8));
        }),
        &["max_array_mib", "path_gain"],
    ),
    ("no_value_array", spoiled!(bad => bad.array = "coverage"), &["coverage", "path_gain"]),
    (
        "several_value_arrays",
        |import, bad| {
            let meta = npy_text(bad.metadata.to_string().as_bytes());
            let members =
                [("path_gain", bad.values.clone()), ("rss", bad.values), ("meta_json", meta)];
            write(&import.map("bad.npz"), npz(&members, CompressionMethod::Stored));
        },
        &["path_gain", "rss", "one"],
    ),
    ("unknown_value_kind", spoiled!(bad => bad.array = "rss"), &["rss", "value_kind", "rss_dbm"]),
    (
        "contradicting_value_kind",
        spoiled!(bad => bad.set("value_kind", json!("rss_w"))),
        &["path_gain_linear", "rss_w"],
    ),
    (
        "unsupported_type",
        spoiled!(bad => bad.values = npy(&good_values(), Layout::plain(Float::F2))),
        &["float16", "float32"],
    ),
    (
        "unsupported_type",
        spoiled!(bad => bad.values = npy_raw("'|u1'", false, "(121, 121)", &[7; 14641])),
        &["uint8", "image"],
    ),
    (
        "unsupported_type",
        spoiled!(bad => bad.values = npy_raw("'<c8'", false, "(121, 121)", &[0; 8 * 14641])),
        &["c8", "float32"],
    ),
    (
        "missing_metadata",
        |import, bad| {
            write(
                &import.map("bad.npz"),
                npz(&[("path_gain", bad.values)], CompressionMethod::Stored),
            );
        },
        &["meta_json", "radio_map.v1"],
    ),
    ("missing_metadata", |import, bad| write(&import.map("bad.npy"), bad.values), &[".json"]),
    (
        "missing_metadata",
        spoiled!(bad => {
            let keys = bad.metadata.as_object_mut().expect("an object");
            keys.remove("row_order");
            keys["max_depth"] = Value::Null;
        }),
        &["row_order", "max_depth"],
    ),
    (
        "wrong_shape",
        spoiled!(bad => bad.values = npy_raw("'<f4'", false, "(14641,)", &[1; 4 * 14641])),
        &["14641", "[n, n]"],
    ),
    (
        "wrong_shape",
        spoiled!(bad => {
            bad.values = f4(&good_values().slice(s![.., ..120]).to_owned());
        }),
        &["121, 120", "square"],
    ),
    (
        "several_transmitters",
        spoiled!(bad => bad.values = cube("(3, 121, 121)")),
        &["3", "--tx", "one file a transmitter"],
    ),
    (
        "several_transmitters",
        spoiled!(bad => bad.values = cube("(121, 121, 3)")),
        &["3", "--tx", "one file a transmitter"],
    ),
    (
        "cell_size_contradicts_shape",
        spoiled!(bad => bad.set("cell_size_m", json!(1))),
        &["121", "484", "cell_size_m"],
    ),
    (
        "incompatible_cell_size",
        spoiled!(bad => {
            bad.set("cell_size_m", json!(3));
            bad.set("map_size_m", json!(363));
        }),
        &["3 m", "4 m", "1 m"],
    ),
    (
        "window_too_small",
        spoiled!(bad => {
            bad.values = f4(&good_values().slice(s![..100, ..100]).to_owned());
            bad.set("map_size_m", json!(400));
        }),
        &["484", "400"],
    ),
    (
        "misaligned_window",
        spoiled!(bad => {
            bad.values = f4(&Array2::from_shape_fn((270, 270), |(row, column)| 1e-9 + 1e-13 * (270 * row + column) as f64));
            bad.set("map_size_m", json!(1080));
        }),
        &["74.5", "270", "484"],
    ),
    ("wrong_crs", spoiled!(bad => bad.set("crs", json!("EPSG:32634"))), &["32635", "32634"]),
    (
        "center_off",
        spoiled!(bad => {
            let east = bad.metadata["map_center_m"][0].as_f64().expect("a number");
            bad.metadata["map_center_m"][0] = json!(east + 0.5);
        }),
        &["0.500 m", "map_center_m"],
    ),
    (
        "nan_undeclared",
        spoiled!(bad => { bad.in_decibels(f64::NAN); bad.set("no_path_value", json!(-300)); }),
        &["nan", "no_path_value", "-300"],
    ),
    (
        "infinity_undeclared",
        spoiled!(bad => { bad.in_decibels(f64::NEG_INFINITY); bad.set("no_path_value", json!(-300)); }),
        &["-inf", "no_path_value", "-300"],
    ),
    (
        "floor_undeclared",
        spoiled!(bad => bad.set("no_path_value", json!("nan"))),
        &["no_path_value", " 0"],
    ),
    (
        "floor_undeclared",
        spoiled!(bad => { bad.in_decibels(-255.0); bad.set("no_path_value", json!("-inf")); }),
        &["no_path_value = -255"],
    ),
    (
        "value_out_of_range",
        spoiled!(bad => bad.values = f4(&(good_values() * -1.0))),
        &["path_gain_linear from 0 to 1"],
    ),
    (
        "wrong_value_kind",
        spoiled!(bad => {
            bad.in_decibels(0.0);
            bad.array = "path_loss_db";
        }),
        &["path_loss_db", "the values fit path_gain_db"],
    ),
    (
        "wrong_value_kind",
        spoiled!(bad => {
            bad.in_decibels(0.0);
            bad.values = f4(&decibels(0.0).mapv(|gain| -gain));
        }),
        &["path_gain_db", "the values fit path_loss_db"],
    ),
    (
        "wrong_value_kind",
        spoiled!(bad => { bad.array = "rss_w"; bad.set("tx_power_dbm", json!(-80)); }),
        &["rss_w", "-80 dBm", "the values fit path_gain_linear"],
    ),
    (
        "wrong_value_kind",
        spoiled!(bad => { bad.in_decibels(-200.0); bad.array = "path_gain"; bad.set("no_path_value", json!(-200)); }),
        &["path_gain_linear", "the values fit path_gain_db"],
    ),
    (
        "wrong_value_kind",
        spoiled!(bad => {
            let dbw = decibels(-200.0).mapv(|gain| if gain > -200.0 { gain + 15.0 - 30.0 } else { gain });
            (bad.array, bad.values) = ("rss_dbm", f4(&dbw));
            bad.set("no_path_value", json!(-200));
        }),
        &["rss_dbm", "-30.", "dBW: add 30 dB"],
    ),
    (
        "wrong_value_kind",
        spoiled!(bad => {
            let milliwatts = good_values().mapv(|gain| gain * 10.0_f64.powf(1.5));
            (bad.array, bad.values) = ("rss_w", f4(&milliwatts));
        }),
        &["rss_w", "mW: divide by 1000"],
    ),
    (
        "wrong_value_kind",
        spoiled!(bad => {
            let carrier = decibels(-200.0).mapv(|gain| if gain > -200.0 { gain + 15.0 + 30.8 } else { gain });
            (bad.array, bad.values) = ("rsrp_dbm", f4(&carrier));
            bad.set("no_path_value", json!(-200));
            bad.set("tx_power_dbm", json!(45.8));
            bad.set("tx_power_is", json!("total"));
            bad.set("n_subcarriers", json!(1200));
        }),
        &["rsrp_dbm", "values of the whole carrier"],
    ),
    (
        "wrong_value_kind",
        spoiled!(bad => bad.values = f4(&(good_values() * 1e4))),
        &["path_gain_linear", "correct tx_power_dbm"],
    ),
    (
        "wrong_orientation",
        spoiled!(bad => bad.set("row_order", json!("north_first"))),
        &["flipped north to south (np.flipud)", "row_order"],
    ),
    (
        "wrong_orientation",
        spoiled!(bad => bad.values = f4(&good_values().reversed_axes())),
        &["once it is transposed (.T), it does"],
    ),
    (
        "wrong_orientation",
        spoiled!(bad => {
            bad.set("row_order", json!("north_first"));
            let mut north_first = good_values();
            north_first.invert_axis(Axis(0));
            bad.values = f4(&north_first.reversed_axes());
        }),
        &["once it is transposed (.T), it does"],
    ),
    (
        "wrong_orientation",
        spoiled!(bad => {
            let mut values = good_values();
            values.invert_axis(Axis(1));
            bad.values = f4(&values);
        }),
        &["flipped east to west (np.fliplr)", "west to east"],
    ),
    (
        "shifted",
        // Three rows of the south are lost: all else lies three cells too far south.
        spoiled!(bad => bad.values = f4(&moved(&good_values(), 3, 0))),
        &["3 cells south", "center the map"],
    ),
    (
        "shifted",
        spoiled!(bad => bad.values = f4(&moved(&good_values(), 0, 1))),
        &["1 cell west", "center the map"],
    ),
    (
        "wrong_tile",
        spoiled!(bad => bad.metadata = metadata(&SITE.ids[1], Window::Coarse)),
        &["it fits the buildings of utm35n_", "location_id"],
    ),
    (
        "buildings_disagree",
        // Far from where it belongs, and on no other tile's buildings either.
        spoiled!(bad => bad.values = f4(&moved(&good_values(), 40, 50))),
        &["agreement", "location_id"],
    ),
    (
        "undersampled",
        spoiled!(bad => bad.set("samples_per_tx", json!(400_000))),
        &["0.9", "min_rays", "more samples"],
    ),
    (
        "undersampled",
        spoiled!(bad => bad.set("tx_position_m", json!([10.0, -20.0, 2.0]))),
        &["receivers' plane", "raise it"],
    ),
    (
        "nothing_reached",
        spoiled!(bad => bad.values = f4(&Array2::zeros((121, 121)))),
        &["none reached"],
    ),
    (
        "transmitter_outside",
        spoiled!(bad => bad.set("tx_position_m", json!([242.5, 0, 30]))),
        &["242", "relative to the map's centre"],
    ),
    (
        "transmitter_outside",
        spoiled!(bad => bad.set("tx_position_m", json!([385_664, 6_672_640, 30]))),
        &["relative to the map's centre"],
    ),
    (
        "transmitter_inside_building",
        spoiled!(bad => {
            let tile = &SITE.ids[1];
            let (east, north, height) = tagged_roof(tile);
            bad.metadata = metadata(tile, Window::Coarse);
            bad.values = f4(&pipeline::maps::good_values(tile));
            bad.set("tx_position_m", json!([east, north, height - 1.5]));
        }),
        &["1.5 m below the roof", "tx_position_m"],
    ),
    (
        "unknown_location",
        spoiled!(bad => bad.set("location_id", json!("utm35n_e385664_n0"))),
        &["utm35n_e385664_n0", "10 tiles"],
    ),
    (
        "unknown_location",
        spoiled!(bad => bad.set("location_id", json!("helsinki-1"))),
        &["helsinki-1"],
    ),
    (
        "tile_dropped",
        spoiled!(bad => bad.metadata = metadata(DROPPED_TILE, Window::Coarse)),
        &["low_built", "--min-built"],
    ),
];

#[test]
fn each_mistake_has_its_own_code_and_mend() {
    let mut wrong = vec![];
    for (code, spoil, words) in CASES {
        let import = Import::new();
        spoil(&import, Draft::new());
        let rejected = import.only_rejection();
        let text = format!("{} | {} | {}", rejected.expected, rejected.found, rejected.mend);
        let says = words.iter().all(|word| text.contains(word));
        if rejected.code != *code || !says {
            wrong.push(format!("{code} and {words:?} expected of {rejected:?}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// Two maps in one file, of which the second is sound.
fn two_maps(import: &Import, positions: &Value) {
    let mut bad = Draft::new();
    let both = ndarray::stack![Axis(0), good_values() / 2.0, good_values()];
    let gains: Vec<u8> = both.iter().flat_map(|&gain| (gain as f32).to_le_bytes()).collect();
    bad.values = npy_raw("'<f4'", false, "(2, 121, 121)", &gains);
    bad.set("tx_position_m", positions.clone());
    bad.write(import);
}

#[test]
fn one_of_several_transmitters_can_be_chosen() {
    let import = Import::new();
    two_maps(&import, &json!([[0, 0, 70], [10, -20, 80]]));
    let code = |tx: &str| {
        run(import.command().args(["--tx", tx, "--overwrite"])).succeeds();
        import.listed().first().map(|rejected| rejected.code.clone())
    };
    assert_eq!(code("2").as_deref(), Some("no_such_transmitter"));
    assert_eq!(code("1"), None);
    let manifest = read_json(&import.out().join("manifest.json"));
    assert_eq!(manifest["config"]["tx"], 1);
    two_maps(&import, &json!([10, -20, 80]));
    assert_eq!(code("1").as_deref(), Some("invalid_metadata"), "whose position is it?");
}

#[test]
fn strictly_a_warning_rejects_and_a_rejection_fails() {
    let import = Import::new();
    let mut bad = Draft::new();
    bad.set("samples_per_tx", json!(4_000_000));
    bad.write(&import);
    run(&mut import.command()).succeeds();
    let manifest = read_json(&import.out().join("manifest.json"));
    let warned = manifest["maps"].as_array().expect("maps").iter();
    let codes: Vec<&Value> =
        warned.flat_map(|map| map["warnings"].as_array().expect("a list")).collect();
    assert_eq!(codes.len(), 1, "{codes:?}");
    assert_eq!(codes[0]["code"], "few_rays");

    let message = run(import.command().args(["--strict", "--overwrite"])).refused();
    assert_says(&message, &["1 maps rejected"]);
    let rejected = import.listed();
    assert_eq!((rejected.len(), rejected[0].code.as_str()), (1, "warned"));
    assert_says(&rejected[0].found, &["few_rays", "9.1"]);
}

/// One file that the disk does not give must not cost all others.
#[test]
fn an_unreadable_file_is_rejected_like_any_other() {
    let import = Import::new();
    // Opens as a regular file for everybody, root included, and fails when it is read.
    let link = std::os::unix::fs::symlink("/proc/self/mem", import.map("bad.npz"));
    link.expect("linked");
    let rejected = import.only_rejection();
    assert_eq!(rejected.code, "unreadable");
    assert_says(&rejected.found, &["Input/output error"]);

    // What stands in a sidecar that cannot be read may be about another map.
    let import = Import::new();
    write_good(&import.map("bad.npz"), good_tile());
    std::os::unix::fs::symlink("/proc/self/mem", import.map("bad.json")).expect("linked");
    let rejected = import.only_rejection();
    assert_eq!((rejected.file.as_str(), rejected.code.as_str()), ("bad.npz", "unreadable"));
    assert_says(&rejected.found, &["bad.json"]);
}

#[test]
fn every_code_has_a_case() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/rsrp/rejection.rs");
    let text = fs::read_to_string(source).expect("read");
    let (_, variants) = text.split_once("pub enum RejectionCode {").expect("the enum");
    let (variants, _) = variants.split_once('}').expect("its end");
    let snake = |name: &str| {
        let words = name.chars().map(|letter| match letter {
            'A'..='Z' => format!("_{}", letter.to_ascii_lowercase()),
            _ => letter.to_string(),
        });
        words.collect::<String>().trim_start_matches('_').to_owned()
    };
    let declared: BTreeSet<String> =
        variants.lines().filter_map(|line| line.trim().strip_suffix(',')).map(snake).collect();
    let elsewhere =
        ["unreadable", "invalid_metadata", "duplicate_location", "no_such_transmitter", "warned"]
            .map(str::to_owned);
    // `tests/repeats.rs` has the cases of maps with several repeats.
    let of_repeats = [
        "error_missing",
        "error_without_repeats",
        "error_shape",
        "error_out_of_range",
        "half_out_of_range",
    ]
    .map(str::to_owned);
    let cases = CASES.iter().map(|(code, ..)| (*code).to_owned());
    let tested: BTreeSet<String> = cases.chain(elsewhere).chain(of_repeats).collect();
    assert_eq!(tested, declared);
}

/// Metadata that cannot be used are named by key, with what was found.
#[test]
fn invalid_metadata_are_named_by_key() {
    let wrong = [
        ("cell_size_m", json!(0)),
        ("cell_size_m", json!("4 m")),
        ("map_size_m", json!(-484)),
        ("frequency_hz", json!(0)),
        ("frequency_hz", json!(3.5)),
        ("tx_power_dbm", json!(1e300)),
        ("tx_position_m", json!([0, 0, 1e308])),
        ("tx_position_m", json!([0, 0, -5])),
        ("tx_position_m", json!([])),
        ("no_path_value", json!([])),
        ("samples_per_tx", json!(0)),
        ("rx_height_m", json!(-1)),
        ("crs", json!("UTM 35N")),
        ("schema", json!("radio_map.v2")),
        ("row_order", json!("up")),
        ("tx_power_is", json!("carrier")),
        ("no_path_value", json!("infinite")),
        ("map_center_m", json!([1])),
        ("tx_position_m", json!({"x": 1})),
        ("samples_per_tx", json!("many")),
        ("max_depth", json!(-1)),
        ("refraction", json!("no")),
        ("value_kind", json!("gain")),
    ];
    let mut unnamed = vec![];
    for (key, value) in wrong {
        let import = Import::new();
        let mut draft = Draft::new();
        draft.set(key, value);
        draft.write(&import);
        let Rejected { code, found, .. } = import.only_rejection();
        if code != "invalid_metadata" || !found.contains(key) {
            unnamed.push(format!("{key}: {code}: {found}"));
        }
    }
    assert!(unnamed.is_empty(), "{unnamed:#?}");
}

#[test]
fn a_total_power_needs_the_number_of_subcarriers() {
    for count in [Value::Null, json!(0)] {
        let import = Import::new();
        let mut draft = Draft::new();
        draft.set("tx_power_is", json!("total"));
        draft.set("n_subcarriers", count);
        draft.write(&import);
        let Rejected { code, found, .. } = import.only_rejection();
        assert_eq!(code, "invalid_metadata");
        assert_says(&found, &["n_subcarriers"]);
    }
}

/// Python writes 3e7 as 30000000.0, and JSON knows only one kind of number.
#[test]
fn whole_numbers_may_be_written_as_floats() {
    let import = Import::new();
    let mut draft = Draft::new();
    draft.set("samples_per_tx", json!(3e7));
    draft.set("max_depth", json!(5.0));
    draft.write(&import);
    assert_eq!(import.rejected(), []);
}

/// Beside an archive that has none they count, too large they are not read.
#[test]
fn metadata_may_lie_beside_an_archive() {
    let import = Import::new();
    let Draft { array, values, metadata, .. } = Draft::new();
    write(&import.map("bad.npz"), npz(&[(array, values)], CompressionMethod::Stored));
    write(&import.map("bad.json"), metadata.to_string());
    assert_eq!(import.rejected(), []);
    write(&import.map("bad.json"), " ".repeat(2 << 20));
    run(import.command().arg("--overwrite")).succeeds();
    let rejected = import.listed();
    assert_eq!(rejected.first().map(|line| line.code.as_str()), Some("too_large"));
    assert_says(&rejected[0].expected, &["metadata", "1048576"]);
}

/// A path loss without path is infinite; what it is must be said.
#[test]
fn an_infinite_loss_is_named_as_it_is() {
    let import = Import::new();
    let mut bad = Draft::new();
    bad.array = "path_loss_db";
    bad.values = f4(&decibels(f64::NEG_INFINITY).mapv(|gain| -gain));
    bad.set("no_path_value", json!(300));
    bad.write(&import);
    let rejected = import.only_rejection();
    assert_eq!(rejected.code, "infinity_undeclared");
    assert_says(&rejected.mend, &["no_path_value to \"inf\""]);
}

#[test]
fn metadata_that_are_no_json_are_refused() {
    let texts: [&[u8]; 5] = [b"", b"{", b"[1, 2]", b"{\"max_depth\": NaN}", b"\xff\xfe{}"];
    for text in texts {
        let import = Import::new();
        let members = [("path_gain", f4(&good_values())), ("meta_json", npy_text(text))];
        write(&import.map("bad.npz"), npz(&members, CompressionMethod::Stored));
        let rejected = import.only_rejection();
        let metadata = ["invalid_metadata", "missing_metadata"];
        assert!(metadata.contains(&rejected.code.as_str()), "{rejected:?}");
    }
    let import = Import::new();
    write(&import.map("bad.npy"), f4(&good_values()));
    write(&import.map("bad.json"), "[".repeat(100_000));
    assert_eq!(import.only_rejection().code, "invalid_metadata");
}

/// `np.savez(path, meta_json=json.dumps(meta))` saves the text as a numpy string.
#[test]
fn metadata_may_be_a_numpy_string() {
    let text = Draft::new().metadata.to_string();
    let utf32: Vec<u8> = text.chars().flat_map(|c| u32::from(c).to_le_bytes()).collect();
    let big: Vec<u8> = text.chars().flat_map(|c| u32::from(c).to_be_bytes()).collect();
    let length = text.len();
    let arrays = [
        npy_raw(&format!("'<U{length}'"), false, "()", &utf32),
        npy_raw(&format!("'>U{length}'"), false, "()", &big),
        npy_raw(&format!("'|S{length}'"), false, "()", text.as_bytes()),
    ];
    for array in arrays {
        let import = Import::new();
        let members = [("path_gain", f4(&good_values())), ("meta_json", array)];
        write(&import.map("map.npz"), npz(&members, CompressionMethod::Stored));
        assert_eq!(import.rejected(), []);
    }
}

#[test]
fn two_maps_of_one_tile_are_both_refused() {
    let import = Import::new();
    for file in ["bad.1.npz", "bad.2.npz"] {
        write_good(&import.map(file), &SITE.ids[0]);
    }
    let rejected = import.rejected();
    assert_eq!(rejected.len(), 2);
    for line in &rejected {
        assert_eq!(
            (line.code.as_str(), line.location.as_str()),
            ("duplicate_location", &*SITE.ids[0])
        );
        assert_says(&line.found, &["bad.1.npz", "bad.2.npz"]);
    }
}

/// A floor that is not declared and too rare to be suspected by its number.
#[test]
fn levels_below_every_real_one_are_refused() {
    let import = Import::new();
    let mut values = Array2::from_shape_fn((484, 484), |(row, column)| {
        -100.0 - 1e-4 * (484 * row + column) as f64
    });
    values.slice_mut(s![..4, ..4]).fill(-9999.0);
    let path = import.map("bad.npz");
    let mut metadata = metadata(&SITE.ids[0], Window::Crop);
    metadata["no_path_value"] = json!("-inf");
    write_npz(&path, "path_gain_db", f4(&values), &metadata);
    run(&mut import.command()).succeeds();
    // Else the whole dataset fails of it, blaming itself.
    let dataset = import.dir.path().join("dataset");
    run(&mut shard(&SITE.tiles, &import.out(), &dataset)).succeeds();
    let rejected = import.listed();
    assert_eq!(rejected.first().map(|line| line.code.as_str()), Some("value_out_of_range"));
}

// Other files ----------------------------------------------------------------------------

#[test]
fn files_that_are_no_maps_are_listed_and_left_alone() {
    let import = Import::new();
    let others = [".gitignore", "LICENSE", "README.md", "run.log", "settings.json"];
    for name in others {
        write(&import.map(name), "not a map");
    }
    write(&import.map("below/map.npz"), "not looked at");
    let before = tree(&import.maps());
    assert_eq!(import.rejected(), []);
    let manifest = read_json(&import.out().join("manifest.json"));
    assert_eq!(manifest["inputs"]["ignored"], json!(others));
    pipeline::assert_same_files(&tree(&import.maps()), &before);
}

/// A map on a disk that is not there is not a map less.
#[cfg(unix)]
#[test]
fn a_link_that_leads_nowhere_is_an_error() {
    let import = Import::new();
    write_good(&import.map("good.npz"), &SITE.ids[0]);
    let link = |name: &str| std::os::unix::fs::symlink("/nowhere/map.npz", import.map(name));
    link(".#notes.txt").expect("linked");
    assert_eq!(import.rejected(), [], "a link that no map has the name of is nobody's map");
    link("gone.npz").expect("linked");
    assert_says(&run(&mut import.command()).refused(), &["cannot open", "gone.npz"]);
}

#[test]
fn the_names_of_files_need_not_be_plain() {
    let import = Import::new();
    for (name, tile) in
        ["map, with \"quotes\".npz", "carte d'été.npz", " .npz"].iter().zip(&SITE.ids)
    {
        write_good(&import.map(name), tile);
    }
    write(&import.map("bad,\n\"map\".npz"), "PK");
    let rejected = import.rejected();
    assert_eq!(rejected.len(), 1);
    assert_eq!(rejected[0].file, "bad,\n\"map\".npz");
}
