//! `holescout scenes`: the meshes are closed and have the volume of the hand-made buildings, base
//! stations stand where the rules say, and scenes are written like every other output.
#![allow(
    clippy::panic,
    clippy::case_sensitive_file_extension_comparisons,
    reason = "helpers of tests fail by panicking; names of files are compared as they are"
)]

#[path = "common/pbf.rs"]
#[allow(dead_code, reason = "only one of its functions is used here")]
mod pbf;
mod pipeline;

use std::collections::HashMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use holescout::grid::TileId;
use holescout::store::{NpzReader, read_npy};
use ndarray::Array2;
use serde_json::Value;

use pipeline::{
    HELSINKI, assert_same_files, assert_says, copy_of, fixture, helsinki_config, holescout, read,
    read_json, run, sha256, shared_dir, temporary_dir, tree, verify, write,
};

fn helsinki() -> PathBuf {
    fixture("helsinki/helsinki.osm.pbf")
}

/// `scenes` of the Helsinki fixtures, with more arguments.
fn scenes<A: AsRef<OsStr>>(out: &Path, args: &[A]) -> Command {
    let mut command = holescout("scenes");
    command.arg("--osm").arg(helsinki()).arg("--config").arg(helsinki_config());
    command.arg("--tiles").arg(&HELSINKI.tiles).arg("--out").arg(out).args(args);
    command
}

const NONE: [&str; 0] = [];

/// The scenes of the fixtures, by the defaults and one thread.
static SCENES: LazyLock<PathBuf> = LazyLock::new(|| {
    let out = shared_dir("scenes-helsinki").join("scenes");
    run(&mut scenes(&out, &["--threads", "1"])).succeeds();
    out
});

// Meshes ---------------------------------------------------------------------------------

struct Mesh {
    vertices: Vec<[f64; 3]>,
    faces: Vec<[usize; 3]>,
}

/// Reads a PLY file by its header's words, not by the library.
fn ply(bytes: &[u8]) -> Mesh {
    let end = b"end_header\n";
    let start = bytes.windows(end.len()).position(|window| window == end).expect("a header");
    let header = std::str::from_utf8(&bytes[..start]).expect("text");
    let lines: Vec<&str> = header.lines().collect();
    assert_eq!(lines[..2], ["ply", "format binary_little_endian 1.0"]);
    let properties: Vec<&str> =
        lines.iter().filter_map(|line| line.strip_prefix("property ")).collect();
    assert_eq!(properties, ["float x", "float y", "float z", "list uchar int vertex_indices"]);
    let count = |element: &str| -> usize {
        let mut counts = lines.iter().filter_map(|line| line.strip_prefix(element));
        counts.next().expect("an element").trim().parse().expect("a number")
    };
    let (vertices, faces) = (count("element vertex"), count("element face"));
    let body = &bytes[start + end.len()..];
    assert_eq!(body.len(), 12 * vertices + 13 * faces);
    let word = |at: usize| <[u8; 4]>::try_from(&body[at..at + 4]).expect("four bytes");
    Mesh {
        vertices: (0..vertices)
            .map(|vertex| [0, 4, 8].map(|at| f32::from_le_bytes(word(12 * vertex + at)).into()))
            .collect(),
        faces: (0..faces)
            .map(|face| {
                let at = 12 * vertices + 13 * face;
                assert_eq!(body[at], 3, "triangles");
                [1, 5, 9].map(|offset| i32::from_le_bytes(word(at + offset)) as usize)
            })
            .collect(),
    }
}

impl Mesh {
    /// Demands that every edge is shared by two faces in opposite directions, and returns the
    /// volume.
    fn closed_volume(&self) -> f64 {
        let mut edges: HashMap<[usize; 2], u32> = HashMap::new();
        let mut volume = 0.0;
        for &[a, b, c] in &self.faces {
            for edge in [[a, b], [b, c], [c, a]] {
                *edges.entry(edge).or_default() += 1;
            }
            let [p, q, r] = [a, b, c].map(|at| self.vertices[at]);
            volume += p[0] * (q[1] * r[2] - q[2] * r[1])
                + p[1] * (q[2] * r[0] - q[0] * r[2])
                + p[2] * (q[0] * r[1] - q[1] * r[0]);
        }
        for (&[a, b], &count) in &edges {
            assert_eq!((count, edges.get(&[b, a])), (1, Some(&1)), "edge {a}-{b}");
        }
        volume / 6.0
    }
}

/// Rasterises one hand-made case and makes its scene; `None` if it holds no building.
fn scene_of_case(osm: &Path, root: &Path) -> Option<PathBuf> {
    let (tiles, out) = (root.join("tiles"), root.join("scenes"));
    let mut rasterise = holescout("rasterise");
    rasterise.arg("--osm").arg(osm).arg("--out").arg(&tiles);
    let area = ["--bbox", "24.935,60.171,24.939,60.174", "--side", "1080", "--crop", "1080"];
    let all = ["--min-buildings", "0", "--min-built", "0"];
    let rasterised = run(rasterise.args(area).args(all));
    if rasterised.code != Some(0) {
        assert_says(&rasterised.refused(), &["no buildings"]);
        return None;
    }
    let mut scenes = holescout("scenes");
    scenes.arg("--osm").arg(osm).arg("--tiles").arg(&tiles).arg("--out").arg(&out);
    run(&mut scenes).succeeds();
    run(&mut verify(&out)).succeeds();
    Some(out.join("utm35n_e385536_n6672384"))
}

/// The volume of the case of floating things, in m³; elsewhere heights on top tell the volume. By
/// hand: length x width x (top - bottom), on a site whose metre is a bit longer than one.
fn volume_of_raised(witness_m2: f64) -> f64 {
    let skyway = 40.0 * 20.0 * (9.0 - 5.0);
    let canopy = 40.0 * 30.0 * 0.3;
    let outline = (80.0 * 40.0 - 30.0 * 20.0 - 20.0 * 20.0) * 12.0;
    // Within the outline they stand on the ground.
    let upper_parts = 30.0 * 20.0 * 40.0 + 20.0 * 20.0 * 8.0;
    let part_from_2_m = 40.0 * 30.0 * (7.0 - 2.0);
    let witness = 30.0 * 20.0 * 10.0;
    let square_metre = witness_m2 / (30.0 * 20.0);
    (skyway + canopy + outline + upper_parts + part_from_2_m + witness) * square_metre
}

#[test]
fn hand_made_buildings_become_closed_meshes_of_their_volume() {
    let expected = read_json(&fixture("geometry/expected.json"));
    let cases = expected["cases"].as_object().expect("cases");
    let (mut made, mut failures) = (0, Vec::new());
    for (name, case) in cases {
        let dir = temporary_dir();
        let osm = fixture("geometry").join(case["file"].as_str().expect("a name"));
        let Some(scene) = scene_of_case(&osm, dir.path()) else { continue };
        made += 1;
        let volume = ply(&read(&scene.join("buildings.ply"))).closed_volume();
        let regions = case["by_height"].as_array().expect("regions");
        let number = |value: &Value| value.as_f64().expect("a number");
        let tops: f64 = regions
            .iter()
            .map(|region| number(&region["height_m"]) * number(&region["area_m2"]))
            .sum();
        let highest = regions.iter().map(|region| number(&region["height_m"])).fold(0.0, f64::max);
        let wanted = if name == "raised" { volume_of_raised(600.89) } else { tops };
        let tolerance = highest * number(&case["area_tolerance_m2"]) + 0.1;
        let is_near = (volume - wanted).abs() <= tolerance;
        if !is_near {
            failures.push(format!("{name}: {volume} m³, expected {wanted} ± {tolerance}"));
        }
    }
    assert!(failures.is_empty(), "\n{}", failures.join("\n"));
    assert!(made > 20, "only {made} cases hold buildings");
}

/// A scene of the ground alone: the only buildings end where they begin.
#[test]
fn a_tile_without_any_solid_has_a_scene_all_the_same() {
    let dir = temporary_dir();
    let osm = dir.path().join("floating.osm.pbf");
    let edited = pbf::edited(&read(&fixture("geometry/closed_way.osm.pbf")), |block| {
        let strings = &mut block.stringtable.mut_or_insert_default().s;
        let key = u32::try_from(strings.len()).expect("a short table");
        let height = strings.iter().position(|text| text == b"height");
        strings.push(b"min_height".to_vec());
        for way in block.primitivegroup.iter_mut().flat_map(|group| &mut group.ways) {
            let mut keys = way.keys.iter();
            if let Some(at) = keys.position(|&key| Some(key as usize) == height) {
                way.keys.push(key);
                way.vals.push(way.vals[at]);
            }
        }
    });
    write(&osm, edited);
    let scene = scene_of_case(&osm, dir.path()).expect("tiles");
    let buildings = ply(&read(&scene.join("buildings.ply")));
    assert_eq!((buildings.vertices.len(), buildings.faces.len()), (0, 0));
    let xml = String::from_utf8(read(&scene.join("scene.xml"))).expect("text");
    assert!(xml.contains("ground.ply") && !xml.contains("buildings"), "{xml}");
    let manifest = read_json(&dir.path().join("scenes/manifest.json"));
    assert_eq!(manifest["left_out"]["no_height"], 2);
    let station = &read_json(&scene.join("scene.json"))["base_stations"][0];
    assert_eq!((&station["on_building"], &station["position_m"][2]), (&false.into(), &10.0.into()));
}

/// Where a mesh must reach, and how its faces look at the world.
#[test]
fn the_ground_lies_under_everything_and_looks_up() {
    let files = tree(&SCENES);
    let of = |name: &'static str| files.iter().filter(move |(file, _)| file.ends_with(name));
    assert_eq!(of("buildings.ply").count(), of("ground.ply").count());
    assert!(of("ground.ply").count() > 50);
    for ((_, buildings), (name, ground)) in of("buildings.ply").zip(of("ground.ply")) {
        let (buildings, ground) = (ply(buildings), ply(ground));
        assert!(buildings.closed_volume() > 0.0, "{name}");
        assert_eq!((ground.vertices.len(), ground.faces.len()), (4, 2), "{name}");
        let reach = |mesh: &Mesh, axis: usize| {
            let values = || mesh.vertices.iter().map(|vertex| vertex[axis]);
            [values().fold(-540.0, f64::min), values().fold(540.0, f64::max)]
        };
        for axis in [0, 1] {
            assert_eq!(reach(&ground, axis), reach(&buildings, axis), "{name}");
        }
        for &[a, b, c] in &ground.faces {
            let [a, b, c] = [a, b, c].map(|at| ground.vertices[at]);
            assert_eq!([a[2], b[2], c[2]], [0.0; 3], "{name}");
            let up = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
            assert!(up > 0.0, "{name}");
        }
    }
}

// Files ----------------------------------------------------------------------------------

#[test]
fn threads_directories_and_order_change_nothing() {
    let dir = temporary_dir();
    let reference = tree(&SCENES);
    for (name, threads) in [("two", "2"), ("eight/deeper", "8")] {
        let out = dir.path().join(name);
        run(&mut scenes(&out, &["--threads", threads])).succeeds();
        assert_same_files(&tree(&out), &reference);
    }
    let manifest = read_json(&SCENES.join("manifest.json"));
    let listed = manifest["scenes"].as_array().expect("scenes");
    assert_eq!(
        listed.len(),
        tree(&HELSINKI.tiles).keys().filter(|name| name.starts_with("utm")).count()
    );
    for scene in listed {
        for file in scene["files"].as_array().expect("files") {
            let bytes = &reference[file["file"].as_str().expect("a name")];
            assert_eq!(file["digest"]["sha256"], sha256(bytes));
        }
    }
    run(&mut verify(&SCENES)).succeeds();
}

#[test]
fn a_killed_run_resumes_and_ends_in_the_same_bytes() {
    let dir = temporary_dir();
    let out = dir.path().join("scenes");
    let mut child = scenes(&out, &["--threads", "1"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("started");
    let written = || std::fs::read_dir(&out).map_or(0, Iterator::count);
    let deadline = Instant::now() + Duration::from_secs(120);
    while written() < 20 && Instant::now() < deadline {
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().expect("killed");
    child.wait().expect("ended");
    assert!(!out.join("manifest.json").exists(), "killed midway");
    assert!(written() >= 20, "killed after some scenes");
    let before = tree(&out).keys().filter(|name| name.ends_with("scene.json")).count();
    assert!(before >= 10, "{before} scenes to go on from");
    assert_says(&run(&mut verify(&out)).refused(), &["manifest.json"]);
    run(&mut scenes(&out, &NONE)).succeeds();
    assert_same_files(&tree(&out), &tree(&SCENES));
}

#[test]
fn other_settings_are_refused_and_replace_everything_if_asked_to() {
    let (_dir, out, files) = copy_of(&SCENES);
    let first = files.keys().find_map(|name| name.strip_suffix("/scene.xml")).expect("a scene");
    let message = run(&mut scenes(&out, &["--scene-seed", "7"])).refused();
    assert_says(&message, &["--overwrite"]);
    assert_same_files(&tree(&out), &files);
    // A tile that holds nothing any more leaves no directory behind.
    let sites = out.with_file_name("sites.csv");
    write(&sites, "lon,lat\n24.9425,60.1715\n");
    let arguments = [OsStr::new("--overwrite"), OsStr::new("--sites"), sites.as_os_str()];
    run(&mut scenes(&out, &arguments)).succeeds();
    assert!(!out.join(first).exists(), "{first}");
    run(&mut verify(&out)).succeeds();
}

#[test]
fn extracts_must_be_those_of_the_tiles() {
    let dir = temporary_dir();
    let out = dir.path().join("scenes");
    let other = fixture("geometry/courtyard.osm.pbf");
    let with = |osm: &[&Path]| {
        let mut command = holescout("scenes");
        command.arg("--osm").args(osm).arg("--tiles").arg(&HELSINKI.tiles).arg("--out").arg(&out);
        run(&mut command).refused()
    };
    assert_says(&with(&[&other]), &["courtyard.osm.pbf", "none of the extracts", "rasterise"]);
    assert_says(&with(&[&helsinki(), &other]), &["courtyard.osm.pbf", "helsinki.osm.pbf"]);
    assert!(!out.exists(), "nothing was written");

    // Tiles of two extracts need both, in any order.
    let tiles = dir.path().join("tiles");
    let both = [fixture("geometry/parts.osm.pbf"), fixture("geometry/heights.osm.pbf")];
    let mut rasterise = holescout("rasterise");
    rasterise.arg("--osm").args(&both).arg("--out").arg(&tiles);
    run(rasterise.args(["--min-buildings", "0", "--min-built", "0"])).succeeds();
    let of_two = |osm: &[&PathBuf], out: &Path| {
        let mut command = holescout("scenes");
        command.arg("--osm").args(osm).arg("--tiles").arg(&tiles).arg("--out").arg(out);
        run(&mut command)
    };
    let [one, two] = ["one", "two"].map(|name| dir.path().join(name));
    assert_says(&of_two(&[&both[0]], &one).refused(), &["heights.osm.pbf", "--osm"]);
    of_two(&[&both[0], &both[1]], &one).succeeds();
    of_two(&[&both[1], &both[0]], &two).succeeds();
    assert_same_files(&tree(&one), &tree(&two));
}

/// Checksums can be made anew; the mesh must make sense all the same.
#[test]
fn verify_finds_a_mesh_that_is_not_closed() {
    let (_dir, out, files) = copy_of(&SCENES);
    let name = files.keys().find(|name| name.ends_with("buildings.ply")).expect("a mesh");
    let mut bytes = files[name].clone();
    // The last face, turned around.
    let at = bytes.len() - 12;
    let (one, other) = (at..at + 4, at + 4..at + 8);
    let first: Vec<u8> = bytes[one.clone()].to_vec();
    bytes.copy_within(other.clone(), one.start);
    bytes[other].copy_from_slice(&first);
    let forged = |text: &[u8], from: &str, to: &str| {
        String::from_utf8(text.to_vec()).expect("text").replace(from, to)
    };
    let (old, new) = (sha256(&files[name]), sha256(&bytes));
    write(&out.join(name), &bytes);
    let manifest = forged(&files["manifest.json"], &old, &new);
    let sums = forged(&files["SHA256SUMS"], &old, &new);
    let sums = sums.replace(&sha256(&files["manifest.json"]), &sha256(manifest.as_bytes()));
    write(&out.join("manifest.json"), manifest);
    write(&out.join("SHA256SUMS"), sums);
    let tile = name.split('/').next().expect("a directory");
    assert_says(&run(&mut verify(&out)).refused(), &[tile, "not closed"]);
}

// Base stations --------------------------------------------------------------------------

/// Base stations of all scenes of a directory, with the height of the tile's grid under each.
fn stations(out: &Path) -> Vec<(TileId, [f64; 3], bool, f64)> {
    let manifest = read_json(&out.join("manifest.json"));
    let mut found = Vec::new();
    for scene in manifest["scenes"].as_array().expect("scenes") {
        let name = scene["id"].as_str().expect("a name");
        let heights = grid(name);
        let meta = read_json(&out.join(name).join("scene.json"));
        for station in meta["base_stations"].as_array().expect("base stations") {
            let number = |axis: usize| station["position_m"][axis].as_f64().expect("a number");
            let [x, y, z] = [0, 1, 2].map(number);
            let on_building = station["on_building"].as_bool().expect("a truth value");
            let cell = [(540.0 - y).floor() as usize, (540.0 + x).floor() as usize];
            let id = name.parse().expect("an id");
            found.push((id, [x, y, z], on_building, f64::from(heights[cell])));
        }
    }
    found
}

fn grid(tile: &str) -> Array2<f32> {
    let path = HELSINKI.tiles.join(format!("{tile}.npz"));
    let mut archive = NpzReader::open(&path, 1 << 24).expect("a tile");
    let heights = archive.member("height_m").expect("heights");
    read_npy(&heights).and_then(|npy| npy.to_array2()).expect("float32")
}

#[test]
fn base_stations_stand_in_the_square_and_above_the_tiles_own_roofs() {
    let dir = temporary_dir();
    let mut on_roofs = Vec::new();
    for placement in ["any", "roof"] {
        let out = dir.path().join(placement);
        run(&mut scenes(&out, &["--placement", placement, "--base-stations", "3"])).succeeds();
        let stations = stations(&out);
        assert!(stations.len() > 150 && stations.len().is_multiple_of(3), "{}", stations.len());
        for (tile, [x, y, z], on_building, height) in &stations {
            assert!(x.abs() < 242.0 && y.abs() < 242.0, "{tile}: {x}, {y}");
            // Above a grounded building by the 2 m, or by more where something floats above it.
            let stands_clear =
                if *height > 0.0 { *on_building && *z >= height + 2.0 } else { *z >= 10.0 };
            assert!(stands_clear, "{tile}: {z} m over {height} m");
            assert!(placement == "any" || *height > 0.0, "{tile}: no roof");
        }
        on_roofs.push(stations.iter().filter(|(_, _, on, _)| *on).count());
    }
    let [any, roof] = on_roofs[..] else { panic!("two placements") };
    assert!(any > 0 && any < roof, "{any} of any place, {roof} of roofs stand on buildings");
}

#[test]
fn more_base_stations_keep_the_first_and_a_seed_moves_them() {
    let dir = temporary_dir();
    let places = |name: &str, args: &[&str]| -> Vec<[f64; 3]> {
        let out = dir.path().join(name);
        run(&mut scenes(&out, args)).succeeds();
        stations(&out).into_iter().map(|(_, place, ..)| place).collect()
    };
    let one: Vec<[f64; 3]> = stations(&SCENES).into_iter().map(|(_, place, ..)| place).collect();
    let two = places("two", &["--base-stations", "2"]);
    assert_eq!(two.into_iter().step_by(2).collect::<Vec<_>>(), one);
    let moved = places("moved", &["--scene-seed", "1"]);
    assert!(moved.iter().zip(&one).filter(|(a, b)| a == b).count() < one.len() / 10);
}

#[test]
fn sites_of_a_file_become_base_stations_of_the_tiles_around_them() {
    let dir = temporary_dir();
    let of = |name: &str, text: &str| {
        let (out, sites) = (dir.path().join(name), dir.path().join(format!("{name}.csv")));
        write(&sites, text);
        (run(scenes(&out, &NONE).arg("--sites").arg(&sites).arg("--json")), out)
    };
    let header = "radio,mcc,net,area,cell,unit,lon,lat,range,samples,changeable,created,updated,averageSignal\n";
    let line =
        |lon: f64| format!("LTE,244,91,1,2,0,{lon},60.1715,1000,7,1,1459743588,1459743588,0\n");
    let lines = [line(24.9425), line(24.9425), line(25.9)].concat();
    let (ran, with_header) = of("with", &[header, &lines].concat());
    let summary: Value =
        serde_json::from_str(ran.succeeds().lines().last().expect("a line")).expect("JSON");
    assert_eq!((&summary["sites"]["sites"], &summary["sites"]["outside"]), (&3.into(), &1.into()));
    let stations_found = stations(&with_header);
    assert!(stations_found.len() > 3, "windows of 484 m every 128 m hold it");
    // Two cells of one mast are one base station, in each tile.
    assert_eq!(summary["sites"]["repeated"], stations_found.len());
    let utm = stations_found[0].0.utm;
    let place = utm.forward(24.9425, 60.1715).expect("in reach");
    for (tile, [x, y, _], ..) in &stations_found {
        let [easting, northing] = tile.center();
        assert!((easting + x - place[0]).abs() < 1e-6 && (northing + y - place[1]).abs() < 1e-6);
    }
    let (ran, without_header) = of("without", &lines);
    ran.succeeds();
    assert_eq!(stations(&without_header), stations_found);
    let manifest = read_json(&with_header.join("manifest.json"));
    let without = manifest["without_base_station"].as_array().expect("tiles").len();
    let tiles = read_json(&HELSINKI.tiles.join("manifest.json"));
    let tiles = tiles["tiles"].as_array().expect("tiles").len();
    assert_eq!(without + manifest["scenes"].as_array().expect("scenes").len(), tiles);
    run(&mut verify(&with_header)).succeeds();
}

#[test]
fn bad_sites_and_contradictions_are_refused_before_anything_is_written() {
    let dir = temporary_dir();
    let out = dir.path().join("scenes");
    for (text, says) in [
        ("longitude,latitude\n24.9425,60.1715\n", "columns lon and lat"),
        ("lon,lat\n24.9425,60.1715\n24.9425,north\n", "line 3: lat is \"north\""),
        ("lon,lat,height\n24.9425,60.1715,-3\n", "line 2: height is \"-3\""),
    ] {
        let sites = dir.path().join("bad.csv");
        write(&sites, text);
        let message = run(scenes(&out, &NONE).arg("--sites").arg(&sites)).refused();
        assert_says(&message, &["bad.csv", says]);
        assert!(!out.exists(), "{text}");
    }
    let sites = dir.path().join("elsewhere.csv");
    write(&sites, "lon,lat\n0,0\n");
    let message = run(scenes(&out, &NONE).arg("--sites").arg(&sites)).refused();
    assert_says(&message, &["elsewhere.csv", "none of the 1 sites"]);
    let message = run(&mut scenes(&out, &["--placement", "file"])).refused();
    assert_says(&message, &["--sites"]);
    let message = run(scenes(&out, &["--placement", "roof"]).arg("--sites").arg(&sites)).refused();
    assert_says(&message, &["--placement file"]);
    let message = run(&mut scenes(&out, &["--map-size", "1080"])).refused();
    assert_says(&message, &["scenes.map_size_m", "4 m"]);
    let message = run(&mut scenes(&out, &["--base-stations", "0"])).refused();
    assert_says(&message, &["scenes.base_stations"]);
}
