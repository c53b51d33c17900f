//! The hand-made cases of `fixtures/geometry` come out as `expected.json` says: objects kept,
//! defects by code (none more, none fewer), heights at probe points, cells and areas.
//!
//! Everything but the areas goes through the command and its files. Areas are measured on
//! a grid of 1/8 m, fine enough for the tolerance, with the library.
#![allow(clippy::panic, reason = "helpers of tests fail by panicking")]

mod common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use holescout::config::{BuildingsConfig, GridConfig};
use holescout::crs::Utm;
use holescout::grid::{Area, TileId, Window};
use holescout::osm::read_buildings;
use holescout::progress::Silent;
use holescout::rasterise::{HeightGrid, rasterise_tile};
use ndarray::Array2;
use serde::Deserialize;
use serde_json::Value;

use common::{INVALID_INPUT, Run, fixture, pbf, read, run, scratch, tile_grids};

/// The tile of the paper's lattice (spacing 512 m) that holds the whole site, and a box
/// around its centre that holds the centre of no other.
const TILE: &str = "utm35n_e385536_n6672384";
const BBOX: &str = "24.935,60.171,24.939,60.174";
const SIDE_M: u32 = 1080;
/// The site reaches from 20 m to 280 m east and from 12 m to 160 m north of this place.
const SITE_LON_LAT: [f64; 2] = [24.94, 60.17];
const SITE_SIDE_M: u32 = 320;
const FINE_CELL_M: f64 = 0.125;
/// Heights are stored as float32.
const HEIGHT_TOLERANCE_M: f64 = 1e-4;

#[derive(Deserialize)]
struct Expected {
    codes: BTreeMap<String, String>,
    cases: BTreeMap<String, Case>,
}

#[derive(Deserialize)]
struct Case {
    file: String,
    buildings: u64,
    parts: u64,
    raised: u64,
    defects: BTreeMap<String, u64>,
    height_sources: Option<HeightSources>,
    area_m2: f64,
    area_tolerance_m2: f64,
    cells_1m: u64,
    cells_1m_tolerance: u64,
    by_height: Vec<Region>,
    probes: Vec<Probe>,
}

#[derive(Deserialize)]
struct HeightSources {
    height: u64,
    levels: u64,
    type_default: u64,
    default: u64,
}

#[derive(Deserialize)]
struct Region {
    height_m: f64,
    area_m2: f64,
    cells_1m: u64,
    cells_1m_tolerance: u64,
}

#[derive(Deserialize)]
struct Probe {
    lon: f64,
    lat: f64,
    height_m: f64,
    why: String,
}

fn expected() -> Expected {
    let text = read(&fixture("geometry/expected.json"));
    serde_json::from_slice(&text).expect("expected.json has the form that is described here")
}

impl Case {
    fn path(&self) -> PathBuf {
        fixture("geometry").join(&self.file)
    }

    fn is_empty(&self) -> bool {
        self.buildings == 0
    }
}

/// Collects what is wrong with a case instead of stopping at the first.
struct Check<'a> {
    case: &'a str,
    failures: &'a mut Vec<String>,
}

impl Check<'_> {
    fn that(&mut self, holds: bool, what: impl FnOnce() -> String) {
        if !holds {
            self.failures.push(format!("{}: {}", self.case, what()));
        }
    }

    fn equal<T: PartialEq + std::fmt::Debug>(&mut self, what: &str, found: &T, wanted: &T) {
        self.that(found == wanted, || format!("{what}: found {found:?}, expected {wanted:?}"));
    }

    fn near(&mut self, what: &str, found: f64, wanted: f64, tolerance: f64) {
        self.that((found - wanted).abs() <= tolerance, || {
            format!("{what}: found {found}, expected {wanted} ± {tolerance}")
        });
    }
}

fn rasterise(osm: &Path, out: &Path) -> Run {
    run(args![
        "rasterise",
        "--osm",
        osm,
        "--out",
        out,
        "--json",
        "--quiet",
        "--bbox",
        BBOX,
        "--side",
        SIDE_M.to_string(),
        "--crop",
        SIDE_M.to_string(),
        "--min-buildings",
        "0",
        "--min-built",
        "0",
    ])
}

/// Counts by code, whatever was done about them.
fn defects(summary: &Value) -> BTreeMap<String, u64> {
    let actions = summary["problems"].as_object().expect("a map of actions");
    let codes = actions.values().flat_map(|codes| codes.as_object().expect("a map of codes"));
    let mut counts = BTreeMap::new();
    for (code, count) in codes {
        *counts.entry(code.clone()).or_default() += count.as_u64().expect("a count");
    }
    counts
}

/// The same counts out of `problems.csv`.
fn listed_defects(out: &Path) -> BTreeMap<String, u64> {
    let mut counts = BTreeMap::new();
    let mut csv = csv::Reader::from_path(out.join("problems.csv")).expect("problems.csv is there");
    for row in csv.records() {
        let code = row.expect("problems.csv is a CSV file")[1].to_owned();
        *counts.entry(code).or_default() += 1;
    }
    counts
}

/// The cell at a place.
fn cell_at(window: &Window, [easting, northing]: [f64; 2]) -> [usize; 2] {
    let inside = |offset: f64| {
        let cell = (offset / window.cell).floor();
        assert!((0.0..window.cells as f64).contains(&cell), "the site lies inside of the tile");
        cell as usize
    };
    [inside(window.north - northing), inside(easting - window.west)]
}

fn is_height(found: f32, wanted: f64) -> bool {
    (f64::from(found) - wanted).abs() < HEIGHT_TOLERANCE_M
}

fn count_cells(heights: &Array2<f32>, wanted: impl Fn(f32) -> bool) -> u64 {
    heights.iter().filter(|&&height| wanted(height)).count() as u64
}

fn check_counts(case: &Case, summary: &Value, out: &Path, check: &mut Check<'_>) {
    let count = |key: &str| summary["buildings"][key].as_u64().expect("a count");
    check.equal("buildings", &count("outlines"), &case.buildings);
    check.equal("parts", &count("parts"), &case.parts);
    check.equal("defects", &defects(summary), &case.defects);
    check.equal("problems.csv", &listed_defects(out), &case.defects);
    check.equal("raised", &count("raised"), &case.raised);
    // Nothing vanishes without a row.
    let rows = |action: &str| {
        let codes = summary["problems"][action].as_object().into_iter().flatten();
        codes.map(|(_, count)| count.as_u64().expect("a count")).sum::<u64>()
    };
    let listed = case.buildings + case.parts + case.raised + rows("skipped") + rows("left_out");
    check.equal("objects with building tags", &count("tagged"), &listed);
    if let Some(sources) = &case.height_sources {
        // The manifest does not tell the two kinds of guesses apart.
        let guessed = sources.type_default + sources.default;
        check.equal("from height", &count("from_height"), &sources.height);
        check.equal("from levels", &count("from_levels"), &sources.levels);
        check.equal("guessed", &count("from_default"), &guessed);
    }
}

fn check_cells(case: &Case, out: &Path, check: &mut Check<'_>) {
    let (heights, sources) = tile_grids(&out.join(format!("{TILE}.npz")));
    let tile: TileId = TILE.parse().expect("an id");
    let window = Window::around(tile, 1.0, SIDE_M as usize);
    for probe in &case.probes {
        let place = tile.utm.forward(probe.lon, probe.lat).expect("in reach");
        let cell = cell_at(&window, place);
        check.near(&probe.why, heights[cell].into(), probe.height_m, HEIGHT_TOLERANCE_M);
        check.equal(
            &format!("{}: has a source", probe.why),
            &(sources[cell] > 0),
            &(probe.height_m > 0.0),
        );
    }
    let built = count_cells(&heights, |height| height > 0.0);
    check.near("cells", built as f64, case.cells_1m as f64, case.cells_1m_tolerance as f64);
    for region in &case.by_height {
        let cells = count_cells(&heights, |height| is_height(height, region.height_m));
        check.near(
            &format!("cells of {} m", region.height_m),
            cells as f64,
            region.cells_1m as f64,
            region.cells_1m_tolerance as f64,
        );
    }
    let known = |height: f32| {
        let mut regions = case.by_height.iter();
        height == 0.0 || regions.any(|region| is_height(height, region.height_m))
    };
    let unexpected = count_cells(&heights, |height| !known(height));
    check.equal("cells of another height", &unexpected, &0);
}

/// The site on a grid of [`FINE_CELL_M`].
fn fine_grid(case: &Case) -> HeightGrid {
    let config = BuildingsConfig::default();
    let extract = read_buildings(&[case.path()], &config, None, &Area::Whole, &Silent)
        .expect("the case holds buildings");
    let [lon, lat] = SITE_LON_LAT;
    let [easting, northing] = extract.utm.forward(lon, lat).expect("in reach");
    let tile =
        TileId { utm: extract.utm, easting: easting as i64 + 150, northing: northing as i64 + 90 };
    let grid = GridConfig {
        side_m: SITE_SIDE_M,
        crop_m: SITE_SIDE_M,
        cell_m: FINE_CELL_M,
        ..GridConfig::default()
    };
    let all: Vec<usize> = (0..extract.city.buildings().len()).collect();
    rasterise_tile(tile, &grid, &extract.city, &all)
}

fn check_areas(case: &Case, check: &mut Check<'_>) {
    let HeightGrid { height_m, .. } = fine_grid(case);
    let area =
        |wanted: &dyn Fn(f32) -> bool| count_cells(&height_m, wanted) as f64 * FINE_CELL_M.powi(2);
    let tolerance = case.area_tolerance_m2;
    check.near("area", area(&|height| height > 0.0), case.area_m2, tolerance);
    for region in &case.by_height {
        let found = area(&|height| is_height(height, region.height_m));
        let what = format!("area of {} m", region.height_m);
        check.near(&what, found, region.area_m2, tolerance);
    }
}

#[test]
fn every_case_comes_out_as_expected() {
    let cases = expected().cases;
    let mut failures = Vec::new();
    for (name, case) in cases.iter().filter(|(_, case)| !case.is_empty()) {
        let scratch = scratch();
        let out = scratch.path().join("tiles");
        let run = rasterise(&case.path(), &out);
        let mut check = Check { case: name, failures: &mut failures };
        if run.code != Some(0) {
            check.that(false, || format!("{run:?}"));
            continue;
        }
        check_counts(case, &run.summary(), &out, &mut check);
        check_cells(case, &out, &mut check);
        check_areas(case, &mut check);
    }
    assert!(failures.is_empty(), "\n{}", failures.join("\n"));
    assert!(cases.len() > 20, "only {} cases were found", cases.len());
}

#[test]
fn extracts_without_buildings_are_refused_and_leave_nothing() {
    let cases = expected().cases;
    let empty: Vec<_> = cases.iter().filter(|(_, case)| case.is_empty()).collect();
    assert_eq!(empty.len(), 2, "no_buildings and empty_extract");
    for (name, case) in empty {
        let scratch = scratch();
        let out = scratch.path().join("tiles");
        let run = rasterise(&case.path(), &out);
        assert_eq!(run.code, Some(INVALID_INPUT), "{name}: {run:?}");
        assert!(run.stderr.contains(&case.file), "{name}: {}", run.stderr);
        assert!(run.stderr.contains("no buildings"), "{name}: {}", run.stderr);
        assert!(!out.exists(), "{name} left an output directory");
    }
}

/// A case whose relations have all their roles replaced still comes out as before: where a
/// ring lies decides what it is. Defects are not compared, contradicting roles are one.
fn check_with_roles(name: &str, role: &str) -> Vec<String> {
    let case = &expected().cases[name];
    let changed = pbf::edited(&read(&case.path()), |block| {
        let strings = &mut block.stringtable.mut_or_insert_default().s;
        strings.push(role.into());
        let index = i32::try_from(strings.len() - 1).expect("a short table");
        let groups = block.primitivegroup.iter_mut();
        let relations = groups.flat_map(|group| &mut group.relations);
        relations.for_each(|relation| relation.roles_sid.fill(index));
    });
    let scratch = scratch();
    let (osm, out) = (scratch.path().join("changed.osm.pbf"), scratch.path().join("tiles"));
    std::fs::write(&osm, changed).expect("written");
    rasterise(&osm, &out).succeeded();
    let mut failures = Vec::new();
    let mut check =
        Check { case: &format!("{name} with all roles {role:?}"), failures: &mut failures };
    check_cells(case, &out, &mut check);
    failures
}

#[test]
fn roles_do_not_decide_which_way_stands_for_a_building() {
    let mut failures = Vec::new();
    for name in ["courtyard", "island_in_hole", "outline_also_tagged", "inner_also_building"] {
        for role in ["", "outer"] {
            failures.extend(check_with_roles(name, role));
        }
    }
    assert!(failures.is_empty(), "\n{}", failures.join("\n"));
}

#[test]
fn every_case_is_committed_and_names_known_codes() {
    let expected = expected();
    for (name, case) in &expected.cases {
        assert!(case.path().exists(), "{name}: {} is missing", case.file);
        for code in case.defects.keys() {
            assert!(expected.codes.contains_key(code), "{name}: {code}");
        }
    }
    let site = Utm::of_place(SITE_LON_LAT[0], SITE_LON_LAT[1]).expect("in UTM's latitudes");
    assert_eq!(site.epsg(), 32635, "the CRS of expected.json");
}
