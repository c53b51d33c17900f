//! The configuration: `holescout config` prints what a run would use, in a form that can be
//! used again; flags override the file; the defaults are the paper's.
#![allow(
    clippy::panic,
    clippy::float_cmp,
    reason = "helpers of tests fail by panicking; defaults are exact numbers"
)]

mod common;

use std::ffi::OsString;
use std::path::Path;

use holescout::config::{
    Config, HeightDownsampling, Loss, Method, Placement, RsrpDownsampling, TrainConfig,
};
use holescout::units::Dbm;

use common::{files, fixture, read, run, scratch, write};

/// A file that sets something in every section, all of it unlike the defaults.
const FILE: &str = r#"
[grid]
side_m = 600
spacing_m = 300
cell_m = 0.5
crop_m = 400
epsg = 32634

[buildings]
parts = false
flight_height_m = 10.0
level_height_m = 3.5
default_heights_m = { garage = 2.0, "tower block" = 40.0 }
attribution = "© OpenStreetMap contributors, \"quoted\""

[filter]
min_buildings = 1
min_built = 0.25

[scenes]
placement = "roof"
base_stations = 3
map_size_m = 408
building_material = "brick"

[rsrp]
floor_dbm = -150.0

[shard]
downsample = 8
height = "mean"
rsrp = "mean_db"
order_seed = 9007199254740993

[split]
block_m = 2048
strict = true

[rl]
hole_threshold_dbm = -95.0
reach_cells = 10

[train]
updates = 10
loss = "squared"
widths = [1, 2, 3, 4, 5, 6, 7]

[evaluate]
methods = ["rsp", "bnp-12", "g-bnp-12-continuous"]
steps = [0, 3]
gradient_smoothing_cells = 1.5

[[split.areas]]
name = "harbour"
split = "test"
bbox = [24.9, 60.1, 25.0, 60.2]
"#;

/// What `holescout config` prints with these arguments.
fn printed<A: AsRef<std::ffi::OsStr>>(args: &[A]) -> String {
    let args = args.iter().map(AsRef::as_ref);
    run([OsString::from("config").as_os_str()].into_iter().chain(args)).succeeded().stdout
}

fn parsed(text: &str) -> Config {
    toml::from_str(text).unwrap_or_else(|error| panic!("{error} in:\n{text}"))
}

#[test]
fn the_defaults_are_those_of_the_paper() {
    let config = parsed(&printed::<&str>(&[]));
    assert_eq!(config, Config::default());
    // Section "Simulation setup": 1,080 m maps every 512 m, the central 484 m of them
    // downsampled by 4 to 121 x 121 cells of 4 m, the UAV and the receivers at 2 m.
    let grid = &config.grid;
    assert_eq!((grid.side_m, grid.spacing_m, grid.crop_m), (1080, 512, 484));
    assert_eq!((grid.cell_m, grid.epsg), (1.0, None));
    assert_eq!(config.shard.downsample, 4);
    assert_eq!(config.shard.record_cells(grid), 121);
    assert_eq!(config.shard.cell_m(grid), 4.0);
    assert_eq!(config.buildings.flight_height_m, 2.0);
    // Threshold, l and c of the same section; rate and d_B of "Baseline Non-ML Approaches".
    assert_eq!((config.rl.hole_threshold_dbm, config.rl.flight_height_m), (Dbm(-100.0), 2.0));
    assert_eq!((config.rl.reach_cells, config.rl.encoding_decay), (15, 0.1));
    assert_eq!(config.evaluate.gradient_rate, 1.0);
    for method in ["rsp", "bnp-8", "bnp-16", "bnp-32", "g-rsp", "g-bnp-8"] {
        let method = method.parse().expect("a method");
        assert!(config.evaluate.methods.contains(&method), "{method}");
    }
    let paper = TrainConfig::paper();
    assert_eq!((paper.gamma, paper.squared_reward, paper.loss), (0.99, 1.0, Loss::Squared));
    // Where the paper is silent.
    assert!(config.buildings.parts);
    assert_eq!(config.buildings.level_height_m, 3.0);
    assert_eq!(config.buildings.max_height_m, 1000.0);
    assert_eq!(config.shard.height, HeightDownsampling::Max);
    assert_eq!(config.shard.rsrp, RsrpDownsampling::LinearMean);
    assert_eq!(config.rsrp.floor_dbm, Dbm(-160.0));
    assert_eq!((config.split.block_m, config.split.strict), (4096, false));
}

#[test]
fn what_is_printed_can_be_fed_back() {
    let scratch = scratch();
    let path = scratch.path().join("run.toml");
    for text in ["", FILE] {
        write(&path, text);
        let first = printed(&args!["--config", &path]);
        assert_eq!(parsed(&first), parsed(text));
        write(&path, &first);
        let second = printed(&args!["--config", &path]);
        assert_eq!(first, second, "printed, read and printed again");
    }
}

#[test]
fn flags_override_the_file_and_leave_the_rest() {
    let scratch = scratch();
    let path = scratch.path().join("run.toml");
    write(&path, FILE);
    let flags = args![
        "--config",
        &path,
        "--side",
        "800",
        "--spacing",
        "200",
        "--cell",
        "1",
        "--crop",
        "480",
        "--epsg",
        "32635",
        "--parts",
        "true",
        "--default-height",
        "7",
        "--min-buildings",
        "0",
        "--min-built",
        "0.5",
    ];
    let mut expected = parsed(FILE);
    expected.grid.side_m = 800;
    expected.grid.spacing_m = 200;
    expected.grid.cell_m = 1.0;
    expected.grid.crop_m = 480;
    expected.grid.epsg = Some(32635);
    expected.buildings.parts = true;
    expected.buildings.default_height_m = 7.0;
    expected.filter.min_buildings = 0;
    expected.filter.min_built = 0.5;
    assert_eq!(parsed(&printed(&flags)), expected);
}

#[test]
fn flags_of_scenes_override_too() {
    let flags = args![
        "--placement",
        "roof",
        "--base-stations",
        "4",
        "--scene-seed",
        "9",
        "--height-above",
        "3.5",
        "--map-size",
        "492",
    ];
    let mut expected = Config::default();
    let scenes = &mut expected.scenes;
    (scenes.placement, scenes.base_stations, scenes.seed) = (Placement::Roof, 4, 9);
    (scenes.height_above_m, scenes.map_size_m) = (3.5, Some(492));
    assert_eq!(parsed(&printed(&flags)), expected);
}

#[test]
fn flags_of_the_evaluation_override_too() {
    let flags = args![
        "--threshold",
        "-90",
        "--flight-height",
        "5",
        "--reach",
        "7",
        "--methods",
        "oracle,bnp-4",
        "--starts",
        "9",
        "--steps",
        "1,3",
        "--seed",
        "4",
        "--bootstrap",
        "123",
        "--gradient-rate",
        "2",
        "--gradient-smoothing",
        "3",
        "--noise",
        "6",
        "--stale",
        "0.25",
    ];
    let mut expected = Config::default();
    expected.rl.hole_threshold_dbm = Dbm(-90.0);
    expected.rl.flight_height_m = 5.0;
    expected.rl.reach_cells = 7;
    let evaluate = &mut expected.evaluate;
    evaluate.methods = vec![Method::Oracle, Method::Neighbourhood(4)];
    (evaluate.starts, evaluate.steps, evaluate.seed) = (9, vec![1, 3], 4);
    (evaluate.bootstrap, evaluate.gradient_rate) = (123, 2.0);
    (evaluate.gradient_smoothing_cells, evaluate.noise_db) = (3.0, 6.0);
    evaluate.stale_share = 0.25;
    assert_eq!(parsed(&printed(&flags)), expected);
}

/// The configuration that a run has recorded in its manifest.
fn recorded(out: &Path) -> Config {
    let manifest: serde_json::Value =
        serde_json::from_slice(&read(&out.join("manifest.json"))).expect("JSON");
    serde_json::from_value(manifest["config"].clone()).expect("sections of a configuration")
}

#[test]
fn a_run_uses_file_and_flags_and_records_them() {
    let scratch = scratch();
    let (path, out) = (scratch.path().join("run.toml"), scratch.path().join("tiles"));
    write(&path, "[grid]\nspacing_m = 256\nside_m = 500\n[filter]\nmin_buildings = 1\n");
    let osm = fixture("geometry/closed_way.osm.pbf");
    let shared = args!["--config", &path, "--min-built", "0", "--side", "600"];
    let tiles = args!["rasterise", "--osm", osm, "--out", &out];
    run(tiles.iter().chain(&shared)).succeeded();
    let config = recorded(&out);
    assert_eq!((config.grid.spacing_m, config.grid.side_m), (256, 600));
    assert_eq!((config.filter.min_buildings, config.filter.min_built), (1, 0.0));
    assert_eq!(config, parsed(&printed(&shared)));
    assert!(files(&out).len() > 4, "tiles were written");
}

/// The last line of standard output is one JSON object.
#[test]
fn json_is_the_last_line_of_standard_output() {
    let scratch = scratch();
    let path = scratch.path().join("run.toml");
    write(&path, FILE);
    let config = run(args!["config", "--json", "--config", &path]).succeeded();
    let from_json: Config = serde_json::from_value(config.summary()).expect("a configuration");
    assert_eq!(from_json, parsed(FILE));

    let osm = fixture("geometry/closed_way.osm.pbf");
    let tiles = args![
        "rasterise",
        "--osm",
        osm,
        "--out",
        scratch.path().join("tiles"),
        "--json",
        "--min-buildings",
        "0",
        "--min-built",
        "0",
    ];
    let summary = run(tiles).succeeded().summary();
    assert_eq!(summary["stage"], "rasterise");
    assert_eq!(summary["epsg"], 32635);
    assert!(summary["tiles"].as_u64() > Some(0), "{summary}");
}

/// `--help` of every command names every flag's key, and the exit codes are documented.
#[test]
fn help_is_complete() {
    let help = run(["--help"]).succeeded().stdout;
    assert!(help.contains("Exit codes") && help.contains("3 invalid input"), "{help}");
    let help = run(["rasterise", "--help"]).succeeded().stdout;
    for key in ["grid.side_m", "grid.spacing_m", "filter.min_built", "--overwrite", "--json"] {
        assert!(help.contains(key), "{key} in {help}");
    }
}
