//! What people really put into extracts (`fixtures/osm`): the command gives the chosen cells the
//! right heights, lists what it should, or refuses with the right words.
#![allow(clippy::panic, reason = "helpers of tests fail by panicking")]

mod common;

use std::collections::BTreeSet;
use std::path::Path;

use holescout::grid::{TileId, Window};
use ndarray::Array2;
use serde::Deserialize;
use serde_json::Value;

use common::{Run, fixture, read, run, scratch, tile_grids};

/// Heights are stored as float32.
const TOLERANCE_M: f64 = 0.005;

#[derive(Deserialize)]
struct Case {
    name: String,
    files: Vec<String>,
    args: Vec<String>,
    #[serde(flatten)]
    outcome: Outcome,
    /// Further outcomes that are as right.
    #[serde(default)]
    or: Vec<Outcome>,
}

#[derive(Deserialize)]
struct Outcome {
    #[serde(default)]
    probes: Vec<Probe>,
    expect: Expect,
}

#[derive(Deserialize)]
struct Probe {
    e: f64,
    n: f64,
    height_m: f64,
    source: Option<u8>,
}

#[derive(Deserialize)]
struct Expect {
    exit: i32,
    epsg: Option<u32>,
    #[serde(default)]
    problems: Vec<(String, Option<String>)>,
    #[serde(default)]
    stderr_contains: Vec<String>,
}

struct Tile {
    window: Window,
    height_m: Array2<f32>,
    height_source: Array2<u8>,
}

fn tiles(out: &Path, manifest: &Value) -> Vec<Tile> {
    let entries = manifest["tiles"].as_array().expect("tiles");
    let tile = |entry: &Value| {
        let id: TileId = entry["id"].as_str().expect("an id").parse().expect("an id");
        let [lon, lat] = id.lon_lat();
        assert!(lon.abs() <= 180.0 && lat.abs() <= 90.0, "{id}: {lon} {lat}");
        let path = out.join(entry["file"].as_str().expect("a name"));
        let (height_m, height_source) = tile_grids(&path);
        Tile { window: Window::around(id, 1.0, 1080), height_m, height_source }
    };
    entries.iter().map(tile).collect()
}

/// What differs from one right outcome.
fn differences(outcome: &Outcome, run: &Run, out: &Path) -> Vec<String> {
    let Expect { exit, epsg, problems, stderr_contains } = &outcome.expect;
    let mut wrong = Vec::new();
    if run.code != Some(*exit) {
        return vec![format!("exit {:?}, expected {exit}: {}", run.code, run.stderr)];
    }
    let missing = stderr_contains.iter().filter(|text| !run.stderr.contains(*text));
    wrong.extend(missing.map(|text| format!("{text:?} is not in {:?}", run.stderr)));
    if *exit != 0 {
        assert!(!out.join("manifest.json").exists(), "refused, but a manifest is there");
        return wrong;
    }
    let manifest: Value = serde_json::from_slice(&read(&out.join("manifest.json"))).expect("JSON");
    if epsg.is_some_and(|epsg| manifest["epsg"] != epsg) {
        wrong.push(format!("EPSG:{}, expected {epsg:?}", manifest["epsg"]));
    }
    let tiles = tiles(out, &manifest);
    for probe in &outcome.probes {
        let mut found = BTreeSet::new();
        for Tile { window, height_m, height_source } in &tiles {
            let inside = (window.west..window.east()).contains(&probe.e)
                && (window.south()..window.north).contains(&probe.n);
            if inside {
                let cell = [(window.north - probe.n) as usize, (probe.e - window.west) as usize];
                found.insert((height_m[cell].to_bits(), height_source[cell]));
            }
        }
        let is_right = |(height, source): &(u32, u8)| {
            (f64::from(f32::from_bits(*height)) - probe.height_m).abs() <= TOLERANCE_M
                && probe.source.is_none_or(|wanted| wanted == *source)
        };
        if found.len() != 1 || !found.iter().all(is_right) {
            let found: Vec<_> = found.iter().map(|(h, s)| (f32::from_bits(*h), s)).collect();
            let Probe { e, n, height_m, source } = probe;
            wrong.push(format!("{e} {n}: {found:?}, expected {height_m} of {source:?}"));
        }
    }
    let rows = String::from_utf8(read(&out.join("problems.csv"))).expect("text");
    for (object, code) in problems {
        let begin = format!("{object},{}", code.as_deref().unwrap_or_default());
        if !rows.lines().any(|row| row.starts_with(&begin)) {
            wrong.push(format!("problems.csv has no row {begin}"));
        }
    }
    wrong
}

#[test]
fn every_case_comes_out_right() {
    let cases: Vec<Case> =
        serde_json::from_slice(&read(&fixture("osm/cases.json"))).expect("a list of cases");
    assert!(cases.len() >= 37, "only {} cases", cases.len());
    let mut failures = Vec::new();
    for case in &cases {
        let scratch = scratch();
        let out = scratch.path().join("tiles");
        let mut args = args!["rasterise", "--min-buildings", "0", "--min-built", "0"].to_vec();
        args.extend(args!["--quiet", "--out", &out]);
        for file in &case.files {
            args.extend(args!["--osm", fixture("osm").join(file)]);
        }
        args.extend(case.args.iter().map(Into::into));
        let run = run(args);
        let outcomes = std::iter::once(&case.outcome).chain(&case.or);
        let fits = |outcome: &&Outcome| run.code == Some(outcome.expect.exit);
        let differ = outcomes.filter(fits).map(|outcome| differences(outcome, &run, &out));
        match differ.min_by_key(Vec::len) {
            Some(wrong) if wrong.is_empty() => {}
            wrong => failures.push(format!("{}: {wrong:?} {run:?}", case.name)),
        }
    }
    assert!(failures.is_empty(), "\n{}", failures.join("\n"));
}
