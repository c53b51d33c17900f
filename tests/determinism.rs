//! The same inputs and configuration give the same bytes: with any number of threads, in any
//! directory, from any path, whatever area a tile was built with, and after any number of
//! killed runs.
#![allow(
    clippy::panic,
    clippy::case_sensitive_file_extension_comparisons,
    reason = "helpers of tests fail by panicking; names of files are compared as they are"
)]

mod common;

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::Path;
use std::time::{Duration, Instant};

use holescout::store::{MANIFEST, SUMS, parse_sums, sha256_bytes};

use common::{Random, differences, files, helsinki, holescout, read, run, scratch};

/// Candidates every 128 m: some hundred tiles, a second or two.
const SPACING: &str = "128";
const KILLS: usize = 8;

type Files = BTreeMap<String, Vec<u8>>;

/// Small windows keep the test quick; the number of tiles is what matters.
fn arguments(osm: &Path, out: &Path) -> Vec<OsString> {
    let lattice = ["--spacing", SPACING, "--side", "400", "--crop", "240"];
    let run = args!["rasterise", "--osm", osm, "--out", out, "--json"];
    run.into_iter().chain(lattice.map(OsString::from)).collect()
}

/// The output of an undisturbed run, and what it wrote to standard output.
fn undisturbed(osm: &Path, out: &Path, flags: &[OsString]) -> (Files, String) {
    let run = run(arguments(osm, out).iter().chain(flags)).succeeded();
    (files(out), run.stdout)
}

fn assert_same(found: &Files, wanted: &Files, what: &str) {
    let differing = differences(found, wanted);
    assert!(differing.is_empty(), "{what}: {differing:#?}");
}

fn tiles(files: &Files) -> impl Iterator<Item = (&String, &Vec<u8>)> {
    files.iter().filter(|(name, _)| name.ends_with(".npz"))
}

/// `SHA256SUMS` lists every file but itself, with its digest.
fn assert_sums_hold(files: &Files) {
    let text = String::from_utf8(files[SUMS].clone()).expect("a text file");
    let listed = parse_sums(&text).expect("the format of sha256sum");
    let mut names: Vec<_> = listed.iter().map(|(_, name)| *name).collect();
    for (digest, name) in &listed {
        assert_eq!(*digest, sha256_bytes(&files[*name]).sha256, "{name}");
    }
    names.push(SUMS);
    names.sort_unstable();
    assert_eq!(names, files.keys().collect::<Vec<_>>(), "files and sums");
}

#[test]
fn threads_directories_and_paths_change_nothing() {
    let scratch = scratch();
    let at = |name: &str| scratch.path().join(name);
    let threads = |number: &str| args!["--threads", number];
    let reference = undisturbed(&helsinki(), &at("one"), &threads("1"));
    assert!(tiles(&reference.0).count() > 50, "a run of some size");
    assert_sums_hold(&reference.0);

    let same = |out: &Path, osm: &Path, flags: &[OsString], what: &str| {
        let (files, stdout) = undisturbed(osm, out, flags);
        assert_same(&files, &reference.0, what);
        assert_eq!(stdout, reference.1, "{what}: the summary");
    };
    same(&at("two"), &helsinki(), &threads("2"), "2 threads");
    same(&at("eight"), &helsinki(), &threads("8"), "8 threads");
    same(&at("deeper/down/there"), &helsinki(), &[], "another directory");
    let copy = at("copy/helsinki.osm.pbf");
    std::fs::create_dir(at("copy")).expect("a new directory");
    std::fs::write(&copy, read(&helsinki())).expect("a copy");
    same(&at("from-copy"), &copy, &[], "another path of the extract");
    same(&at("one"), &helsinki(), &[], "again in the same directory");

    let places = [scratch.path(), Path::new(env!("CARGO_MANIFEST_DIR"))];
    for (name, bytes) in reference.0.iter().filter(|(name, _)| !name.ends_with(".npz")) {
        let text = String::from_utf8_lossy(bytes);
        let absolute = places.map(|place| text.contains(&*place.to_string_lossy()));
        assert_eq!(absolute, [false; 2], "an absolute path in {name}");
    }
}

/// A tile's bytes are those of its place, whatever area it was built with.
#[test]
fn tiles_of_a_part_are_those_of_the_whole() {
    let scratch = scratch();
    let at = |name: &str| scratch.path().join(name);
    let (whole, _) = undisturbed(&helsinki(), &at("whole"), &[]);
    let bbox = args!["--bbox", "24.940,60.167,24.947,60.173"];
    let (part, _) = undisturbed(&helsinki(), &at("part"), &bbox);
    let count = tiles(&part).count();
    assert!(count > 5 && count < tiles(&whole).count(), "{count} tiles");
    for (name, bytes) in tiles(&part) {
        assert!(whole.get(name) == Some(bytes), "{name} differs");
    }
}

/// Of an object in several extracts the first is taken.
#[test]
fn an_extract_given_twice_changes_no_tile() {
    let scratch = scratch();
    let at = |name: &str| scratch.path().join(name);
    let (once, _) = undisturbed(&helsinki(), &at("once"), &[]);
    let copy = at("copy.osm.pbf");
    std::fs::write(&copy, read(&helsinki())).expect("a copy");
    let (twice, _) = undisturbed(&helsinki(), &at("twice"), &args!["--osm", copy]);
    assert!(tiles(&twice).eq(tiles(&once)));
}

/// Starts a run, kills it after a while (SIGKILL), and returns what it left.
fn killed_after(wait: Duration, out: &Path) -> Files {
    let mut command = holescout();
    let mut child = command.args(arguments(&helsinki(), out)).spawn().expect("the command starts");
    std::thread::sleep(wait);
    child.kill().expect("a child can be killed");
    child.wait().expect("a killed child ends");
    files(out)
}

/// A directory with a manifest is whole, whenever the run was killed.
fn assert_whole_or_without_manifest(left: &Files, wanted: &Files) {
    if left.contains_key(MANIFEST) {
        for (name, bytes) in wanted {
            assert!(left.get(name) == Some(bytes), "{name} beside a manifest");
        }
    }
}

#[test]
fn killed_runs_are_resumed_and_end_in_the_same_bytes() {
    let scratch = scratch();
    let start = Instant::now();
    let (wanted, stdout) = undisturbed(&helsinki(), &scratch.path().join("undisturbed"), &[]);
    let duration = start.elapsed();
    let mut random = Random(4);
    let mut interrupted = 0;
    for kill in 0..KILLS {
        let out = scratch.path().join(format!("killed-{kill}"));
        // Spread over the whole run, a little beyond its end, each a little off.
        let share = (kill as f64 + random.below(1000) as f64 / 1000.0) / (KILLS - 1) as f64;
        let left = killed_after(duration.mul_f64(share), &out);
        assert_whole_or_without_manifest(&left, &wanted);
        interrupted += usize::from(tiles(&left).count() > 0 && !left.contains_key(MANIFEST));
        let (resumed, summary) = undisturbed(&helsinki(), &out, &[]);
        assert_same(&resumed, &wanted, &format!("killed after {share:.3}"));
        assert_eq!(summary, stdout, "killed after {share:.3}: the summary");
    }
    assert!(interrupted > 0, "no run was killed among its tiles");
}

/// One output that is killed again and again makes progress every time.
#[test]
fn a_run_that_is_killed_repeatedly_still_ends() {
    let scratch = scratch();
    let start = Instant::now();
    let (wanted, _) = undisturbed(&helsinki(), &scratch.path().join("undisturbed"), &[]);
    let duration = start.elapsed();
    let out = scratch.path().join("killed");
    let mut random = Random(5);
    let mut finished = 0;
    for _ in 0..6 {
        let share = 0.3 + random.below(400) as f64 / 1000.0;
        let left = killed_after(duration.mul_f64(share), &out);
        assert_whole_or_without_manifest(&left, &wanted);
        if left.contains_key(MANIFEST) {
            break;
        }
        let tiles = tiles(&left).count();
        assert!(tiles >= finished, "{tiles} tiles, {finished} before");
        finished = tiles;
    }
    let (resumed, _) = undisturbed(&helsinki(), &out, &[]);
    assert_same(&resumed, &wanted, "killed several times");
}

/// A killed overwriting run leaves something that the next one can overwrite.
#[test]
fn a_killed_overwriting_run_can_be_repeated() {
    let scratch = scratch();
    let (wanted, _) = undisturbed(&helsinki(), &scratch.path().join("wanted"), &[]);
    let mut random = Random(6);
    for kill in 0..4 {
        let out = scratch.path().join(format!("out-{kill}"));
        let other = args!["--min-built", "0.2"];
        undisturbed(&helsinki(), &out, &other);
        let overwrite = args!["--overwrite"];
        let mut command = holescout();
        command.args(arguments(&helsinki(), &out)).args(&overwrite);
        let mut child = command.spawn().expect("the command starts");
        // Wait for the moment when it begins to remove the old output.
        while out.join(MANIFEST).exists() && child.try_wait().is_ok_and(|end| end.is_none()) {
            std::thread::sleep(Duration::from_micros(200));
        }
        std::thread::sleep(Duration::from_micros(random.below(3000) as u64));
        child.kill().expect("a child can be killed");
        child.wait().expect("a killed child ends");
        let (again, _) = undisturbed(&helsinki(), &out, &overwrite);
        assert_same(&again, &wanted, "overwritten");
    }
}
