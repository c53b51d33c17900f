//! Bad inputs, bad places for the output and bad flags: each is refused with the exit code
//! that a batch system acts on, with a message that names what is wrong, and without
//! partial output. Damaged files never make the command panic, hang or eat the memory.
#![allow(clippy::panic, reason = "helpers of tests fail by panicking")]

mod common;

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use common::pbf::{self, Packing};
use common::{
    FAILED_WHILE_RUNNING, INVALID_INPUT, Random, Run, WRONG_USAGE, bounded_holescout, differences,
    files, fixture, helsinki, holescout, holescout_after, read, run, run_command, scratch, write,
};

/// A case that one building of which comes out, uncompressed: every byte matters.
fn small_extract() -> PathBuf {
    fixture("geometry/closed_way.osm.pbf")
}

/// Arguments for a quick run, which any extract of Helsinki passes.
fn rasterise(osm: &Path, out: &Path) -> Vec<OsString> {
    args![
        "rasterise",
        "--osm",
        osm,
        "--out",
        out,
        "--side",
        "200",
        "--spacing",
        "200",
        "--crop",
        "100",
        "--min-buildings",
        "1",
        "--min-built",
        "0",
    ]
    .into()
}

/// The run was refused as invalid input, and the message holds all these words.
fn assert_refused(run: &Run, words: &[&str]) {
    assert_eq!(run.code, Some(INVALID_INPUT), "{words:?}: {run:?}");
    let message: Vec<_> = run.stderr.lines().filter(|line| line.starts_with("error: ")).collect();
    assert_eq!(message.len(), 1, "one error and no panic: {run:?}");
    for word in words {
        assert!(run.stderr.contains(word), "{word:?} in {}", run.stderr);
    }
}

/// A damaged extract is refused by name, with these words, and nothing is written.
fn assert_damage_is_refused(name: &str, bytes: &[u8], words: &[&str]) {
    let scratch = scratch();
    let (osm, out) = (scratch.path().join(name), scratch.path().join("tiles"));
    write(&osm, bytes);
    let run = run_command(bounded_holescout(), rasterise(&osm, &out));
    let named = osm.to_string_lossy();
    assert_refused(&run, &[&[named.as_ref()], words].concat());
    assert!(!out.exists(), "{name} left {:?}", files(&out).keys());
}

/// Flags or files besides the extract are refused with these words, and nothing is written.
fn assert_flags_are_refused(flags: &[OsString], words: &[&str]) {
    let scratch = scratch();
    let out = scratch.path().join("tiles");
    let run = run(rasterise(&helsinki(), &out).iter().chain(flags));
    assert_refused(&run, words);
    assert!(!out.exists(), "{flags:?} left {:?}", files(&out).keys());
}

#[test]
fn truncated_extracts() {
    let file = read(&helsinki());
    let frames = pbf::frames(&file);
    let last = frames.last().expect("the file has blobs");
    let cuts = [
        ("in-a-blob", last.blob.start + last.blob.len() / 2),
        ("before-a-blob", last.blob.start),
        ("in-a-blob-header", last.header.start + 3),
        ("before-a-blob-header", last.header.start),
        ("in-the-length", last.length.start + 2),
        ("in-the-first-blob", frames[0].blob.start + 5),
    ];
    for (name, cut) in cuts {
        let name = format!("{name}.osm.pbf");
        assert_damage_is_refused(&name, &file[..cut], &["truncated"]);
    }
}

#[test]
fn corrupt_blobs() {
    let file = read(&helsinki());
    let frames = pbf::frames(&file);
    let middle = &frames[frames.len() / 2];
    let mut flipped = file.clone();
    let at = middle.blob.start + middle.blob.len() / 2;
    flipped[at..at + 8].iter_mut().for_each(|byte| *byte ^= 0xFF);
    assert_damage_is_refused("flipped.osm.pbf", &flipped, &["corrupt"]);

    let nonsense = pbf::with_content(&file, 1, &[0xFF; 1000], Packing::Zlib);
    assert_damage_is_refused("nonsense.osm.pbf", &nonsense, &["corrupt"]);

    let mut lying = file.clone();
    lying[middle.header.clone()].fill(0xFF);
    assert_damage_is_refused("header.osm.pbf", &lying, &["corrupt"]);
}

#[test]
fn blocks_whose_indices_lead_nowhere() {
    let file = read(&small_extract());
    let past_the_strings = pbf::edited(&file, |block| {
        let ways = block.primitivegroup.iter_mut().flat_map(|g| &mut g.ways);
        ways.for_each(|way| way.keys.iter_mut().for_each(|key| *key = 1_000_000));
    });
    assert_damage_is_refused("keys.osm.pbf", &past_the_strings, &["corrupt", "way 101"]);

    let one_value_less = pbf::edited(&file, |block| {
        let ways = block.primitivegroup.iter_mut().flat_map(|g| &mut g.ways);
        ways.for_each(|way| way.vals.truncate(0));
    });
    assert_damage_is_refused("values.osm.pbf", &one_value_less, &["corrupt", "way 101"]);

    let one_latitude_less = pbf::edited(&file, |block| {
        let groups = block.primitivegroup.iter_mut();
        for group in groups.filter(|group| !group.dense.id.is_empty()) {
            group.dense.mut_or_insert_default().lat.truncate(1);
        }
    });
    assert_damage_is_refused("dense.osm.pbf", &one_latitude_less, &["corrupt", "dense"]);

    let relation = read(&fixture("geometry/courtyard.osm.pbf"));
    let negative_role = pbf::edited(&relation, |block| {
        let relations = block.primitivegroup.iter_mut().flat_map(|g| &mut g.relations);
        relations.for_each(|relation| relation.roles_sid.iter_mut().for_each(|role| *role = -1));
    });
    assert_damage_is_refused("roles.osm.pbf", &negative_role, &["corrupt", "relation 900"]);
}

#[test]
fn blobs_that_unpack_to_more_than_they_declare() {
    let file = read(&small_extract());
    let bomb = pbf::with_content(&file, 0, &vec![0; 40 << 20], Packing::Zlib);
    assert_damage_is_refused("bomb.osm.pbf", &bomb, &["corrupt"]);
}

/// A footprint of continental size must not make the number of candidate tiles, and with it
/// time and memory, grow with its area.
#[test]
fn a_building_as_large_as_a_continent() {
    const DEGREE: i64 = 10_000_000;
    let huge = pbf::edited(&read(&small_extract()), |block| {
        let groups = block.primitivegroup.iter_mut();
        for group in groups.filter(|group| !group.dense.id.is_empty()) {
            let dense = group.dense.mut_or_insert_default();
            // Places are stored as differences: only the first two nodes move.
            dense.lat[0] -= 50 * DEGREE;
            dense.lat[1] += 50 * DEGREE;
            dense.lon[1] += 10 * DEGREE;
            dense.lon[2] -= 10 * DEGREE;
        }
    });
    let scratch = scratch();
    let osm = scratch.path().join("huge.osm.pbf");
    write(&osm, huge);
    let run = run_command(bounded_holescout(), rasterise(&osm, &scratch.path().join("tiles")));
    assert!(matches!(run.code, Some(0 | INVALID_INPUT)), "memory or time ran out: {run:?}");
}

/// A ring of very many sides must not take the square of their number: OSM allows 2000
/// nodes in a way, a hostile file any number.
#[test]
fn a_building_with_very_many_sides() {
    let zigzag = pbf::edited(&read(&small_extract()), |block| {
        let ways = block.primitivegroup.iter_mut().flat_map(|g| &mut g.ways);
        for way in ways.filter(|way| way.id() == 101) {
            // 1011, 1012, 1011, ..., and at last over 1013 back to 1011, as differences.
            let zigzag = [1011].into_iter().chain([1, -1].repeat(100_000));
            way.refs = zigzag.chain([2, -2]).collect();
        }
    });
    let scratch = scratch();
    let osm = scratch.path().join("zigzag.osm.pbf");
    write(&osm, zigzag);
    let run = run_command(bounded_holescout(), rasterise(&osm, &scratch.path().join("tiles")));
    assert_eq!(run.code, Some(0), "the witness comes out: {run:?}");
}

#[test]
fn other_files_with_the_name_of_an_extract() {
    let not_pbf = |name, bytes: &[u8]| {
        assert_damage_is_refused(name, bytes, &["not an OpenStreetMap PBF file"]);
    };
    not_pbf("text.osm.pbf", b"Dear reader, this is a letter and no map.");
    not_pbf("map.osm", &read(&fixture("geometry/closed_way.osm")));
    not_pbf("zeros.osm.pbf", &[0; 4096]);
    let archive = read(&fixture("helsinki/rsrp/utm35n_e385792_n6672128.npz"));
    not_pbf("map.npz", &archive);
    assert_damage_is_refused("empty.osm.pbf", b"", &["empty"]);
}

#[test]
fn missing_files_and_directories_in_their_place() {
    let scratch = scratch();
    let out = scratch.path().join("tiles");
    let missing = scratch.path().join("nowhere.osm.pbf");
    let refused = run(rasterise(&missing, &out));
    assert_refused(&refused, &[&missing.to_string_lossy(), "No such file"]);
    let directory = scratch.path().join("directory.osm.pbf");
    std::fs::create_dir(&directory).expect("a new directory");
    let refused = run(rasterise(&directory, &out));
    assert_refused(&refused, &[&directory.to_string_lossy(), "directory"]);
    assert!(!out.exists());
}

#[test]
fn one_bad_extract_among_good_ones() {
    let scratch = scratch();
    let (bad, out) = (scratch.path().join("bad.osm.pbf"), scratch.path().join("tiles"));
    write(&bad, b"no extract");
    let run = run(rasterise(&helsinki(), &out).into_iter().chain(args!["--osm", &bad]));
    assert_refused(&run, &[&bad.to_string_lossy()]);
    assert!(!out.exists());
}

#[test]
fn extracts_without_buildings() {
    let nothing = read(&fixture("geometry/no_buildings.osm.pbf"));
    assert_damage_is_refused("meadow.osm.pbf", &nothing, &["no buildings"]);
    // Objects with building tags, but none of them usable, is another mistake.
    let without_nodes = pbf::edited(&read(&small_extract()), |block| {
        block.primitivegroup.retain(|group| group.dense.id.is_empty());
    });
    assert_damage_is_refused("filtered.osm.pbf", &without_nodes, &["no buildings", "nodes"]);
}

#[test]
fn areas_without_buildings() {
    // Tallinn lies in the same UTM zone, San Jose on the other side of the globe.
    for bbox in ["24.6,59.3,24.9,59.5", "-122,37.2,-121.8,37.4"] {
        assert_flags_are_refused(&args!["--bbox", bbox], &["area", "24.9"]);
    }
}

#[test]
fn bounding_boxes_that_are_none() {
    for bbox in ["25,60,24,61", "24,61,25,60", "24,60,25,99", "nan,60,25,61"] {
        assert_flags_are_refused(&args!["--bbox", bbox], &["bounding box", "west < east"]);
    }
}

#[test]
fn bad_geojson() {
    let cases = [
        ("roads, no JSON", "not GeoJSON"),
        (r#"{"type": "Banana"}"#, "not GeoJSON"),
        (r#"{"type": "Polygon", "coordinates": "x"}"#, "not GeoJSON"),
        (r#"{"type": "Point", "coordinates": [24.94, 60.17]}"#, "no Polygon"),
        (r#"{"type": "FeatureCollection", "features": []}"#, "no Polygon"),
        ("", "not GeoJSON"),
    ];
    let scratch = scratch();
    let path = scratch.path().join("area.geojson");
    for (text, reason) in cases {
        write(&path, text);
        let words = [&path.to_string_lossy(), reason];
        assert_flags_are_refused(&args!["--area", &path], &words);
    }
    let missing = scratch.path().join("missing.geojson");
    let words = [&missing.to_string_lossy(), "No such file"];
    assert_flags_are_refused(&args!["--area", &missing], &words);
}

#[test]
fn bad_configurations() {
    let cases: [(&str, &[&str]); 7] = [
        ("[grid]\nspacing = 512\n", &["spacing", "unknown field"]),
        ("[gird]\nspacing_m = 512\n", &["gird", "unknown field"]),
        ("[grid]\nspacing_m = \"wide\"\n", &["spacing_m", "invalid type"]),
        ("[grid]\nspacing_m = -1\n", &["spacing_m"]),
        ("[grid\n", &["1"]),
        ("[grid]\ncrop_m = 2000\n", &["grid.crop_m", "2000"]),
        ("[filter]\nmin_built = 1.5\n", &["filter.min_built", "1.5"]),
    ];
    for (text, words) in cases {
        let scratch = scratch();
        let path = scratch.path().join("run.toml");
        write(&path, text);
        let out = scratch.path().join("tiles");
        // Plain flags: those of other tests would override the values in question.
        let run = run(args!["rasterise", "--osm", helsinki(), "--out", &out, "--config", &path]);
        assert_refused(&run, words);
        assert!(run.stderr.contains("run.toml"), "the file is named: {}", run.stderr);
        assert!(!out.exists(), "{text:?} left {:?}", files(&out).keys());
    }
    let missing = args!["--config", "/nowhere/run.toml"];
    assert_flags_are_refused(&missing, &["/nowhere/run.toml", "No such file"]);
}

#[test]
fn values_of_flags_are_checked_like_those_of_the_file() {
    assert_flags_are_refused(&args!["--cell", "0"], &["grid.cell_m", "0"]);
    assert_flags_are_refused(&args!["--epsg", "4326"], &["4326", "UTM"]);
}

#[test]
fn directories_that_hold_other_files_are_left_alone() {
    for overwrite in [false, true] {
        let scratch = scratch();
        let out = scratch.path().join("thesis");
        std::fs::create_dir(&out).expect("a new directory");
        write(&out.join("chapter1.tex"), "Introduction");
        let before = files(&out);
        let flag = overwrite.then(|| OsString::from("--overwrite"));
        let run = run(rasterise(&helsinki(), &out).into_iter().chain(flag));
        assert_refused(&run, &[&out.to_string_lossy(), "chapter1.tex"]);
        assert_eq!(files(&out), before);
    }
    let scratch = scratch();
    let file = scratch.path().join("file");
    write(&file, "not a directory");
    assert_refused(&run(rasterise(&helsinki(), &file)), &[&file.to_string_lossy()]);
    assert_eq!(read(&file), b"not a directory");
}

/// Tiles of other thresholds, in a directory where somebody has put notes.
fn other_tiles_and_notes(out: &Path) -> BTreeMap<String, Vec<u8>> {
    let config = out.with_extension("toml");
    write(&config, "[filter]\nmin_built = 0.1\n");
    run(args!["rasterise", "--osm", helsinki(), "--out", out, "--config", config]).succeeded();
    write(&out.join("notes.txt"), "mine");
    std::fs::create_dir(out.join("plots")).expect("a new directory");
    write(&out.join("plots/figure.svg"), "mine too");
    files(out)
}

#[test]
fn tiles_of_another_configuration_are_replaced_only_on_demand() {
    let scratch = scratch();
    let (out, fresh) = (scratch.path().join("tiles"), scratch.path().join("fresh"));
    let before = other_tiles_and_notes(&out);
    let args = rasterise(&helsinki(), &out);
    let refused = run(&args);
    assert_refused(&refused, &[&out.to_string_lossy(), "--overwrite"]);
    assert_eq!(files(&out), before);

    run(args.into_iter().chain(args!["--overwrite"])).succeeded();
    run(rasterise(&helsinki(), &fresh)).succeeded();
    let mut after = files(&out);
    assert_eq!(after.remove("notes.txt").as_deref(), Some(&b"mine"[..]));
    let figure = after.remove("plots/figure.svg");
    assert_eq!(figure.as_deref(), Some(&b"mine too"[..]));
    let differing = differences(&after, &files(&fresh));
    assert!(differing.is_empty(), "{differing:?}");
}

/// An invalid run with `--overwrite` must not cost the tiles that are there.
#[test]
fn a_refused_run_does_not_destroy_what_it_would_replace() {
    let scratch = scratch();
    let (out, bad) = (scratch.path().join("tiles"), scratch.path().join("bad.osm.pbf"));
    let before = other_tiles_and_notes(&out);
    let file = read(&helsinki());
    write(&bad, &file[..file.len() - 1]);
    let run = run(rasterise(&bad, &out).into_iter().chain(args!["--overwrite"]));
    assert_refused(&run, &["truncated"]);
    assert_eq!(files(&out), before);
}

/// Neither a second run of the same inputs nor one that overwrites disturbs the first.
#[test]
fn a_directory_that_another_run_is_filling() {
    for flags in [&[][..], &args!["--overwrite", "--min-built", "0.1"]] {
        let scratch = scratch();
        let out = scratch.path().join("tiles");
        let args = args!["rasterise", "--osm", helsinki(), "--out", &out, "--spacing", "128"];
        let mut command = holescout();
        let mut first = command.args(&args).spawn().expect("the command starts");
        // Only counted: temporary files come and go.
        while std::fs::read_dir(&out).map_or(0, Iterator::count) < 5 {
            std::thread::sleep(Duration::from_millis(5));
        }
        let second = run(args.iter().chain(flags));
        let still_running = first.try_wait().expect("its state can be read").is_none();
        let first = Run::from(first.wait_with_output().expect("the command ends"));
        assert_eq!(second.code, Some(FAILED_WHILE_RUNNING), "waiting may help: {second:?}");
        let message = [out.to_string_lossy().into_owned(), "another run".to_owned()];
        assert!(message.iter().all(|word| second.stderr.contains(word)), "{second:?}");
        assert!(still_running, "the first run must outlast the second");
        first.succeeded();
    }
}

/// Without its manifest nothing tells whose a directory is, so nothing in it is removed.
#[test]
fn an_output_that_has_lost_its_manifest_is_not_touched() {
    let scratch = scratch();
    let out = scratch.path().join("tiles");
    let args = rasterise(&helsinki(), &out);
    run(&args).succeeded();
    std::fs::remove_file(out.join("manifest.json")).expect("it was there");
    let before = files(&out);
    let refused = run(args.into_iter().chain(args!["--overwrite"]));
    assert_eq!(refused.code, Some(INVALID_INPUT), "{refused:?}");
    assert!(refused.stderr.contains("empty this one yourself"), "{refused:?}");
    let differing = differences(&files(&out), &before);
    assert!(differing.is_empty(), "{differing:?}");
}

#[test]
fn wrong_usage_exits_with_2() {
    let scratch = scratch();
    let out = scratch.path().join("tiles");
    let cases: [&[OsString]; 8] = [
        &args![],
        &args!["conjure"],
        &args!["rasterise", "--osm", helsinki(), "--out", &out, "--colour", "blue"],
        &args!["rasterise", "--osm", helsinki()],
        &args!["rasterise", "--out", &out],
        &args!["rasterise", "--osm", helsinki(), "--out", &out, "--threads", "0"],
        &args!["rasterise", "--osm", helsinki(), "--out", &out, "--spacing", "wide"],
        &args!["rasterise", "--osm", helsinki(), "--out", &out, "--bbox", "1,2,3,4", "--area", "a"],
    ];
    for args in cases {
        let run = run(args);
        assert_eq!(run.code, Some(WRONG_USAGE), "{args:?}: {run:?}");
        assert!(run.stderr.contains("--help"), "{}", run.stderr);
        assert!(!out.exists(), "{args:?} left {:?}", files(&out).keys());
    }
}

/// A file system of 200 KiB, unmounted in the end.
struct SmallDisk(PathBuf);

impl SmallDisk {
    /// `None` where mounting is not allowed.
    fn mount(at: &Path) -> Option<Self> {
        std::fs::create_dir(at).expect("a new directory");
        let mut command = Command::new("mount");
        command.args(["-t", "tmpfs", "-o", "size=200k", "tmpfs"]);
        let output = command.arg(at).output().ok()?;
        output.status.success().then(|| Self(at.to_owned()))
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let unmounted = Command::new("umount").arg(&self.0).status();
        assert!(
            unmounted.is_ok_and(|status| status.success()) || std::thread::panicking(),
            "{} is still mounted",
            self.0.display()
        );
    }
}

/// A write failed: the machine's fault, a file of the output is named, no manifest.
fn assert_failed_to_write(run: &Run, out: &Path, reason: &str) {
    assert_eq!(run.code, Some(FAILED_WHILE_RUNNING), "{run:?}");
    for word in ["error: cannot write", &out.to_string_lossy(), reason] {
        assert!(run.stderr.contains(word), "{word:?} in {}", run.stderr);
    }
    let left = files(out);
    assert!(!left.contains_key("manifest.json"), "{:?}", left.keys());
    let temporary = left.keys().find(|name| name.contains("tmp"));
    assert_eq!(temporary, None, "a failed write leaves no temporary");
}

/// As root on a real small file system, else the limit below stands for it.
#[test]
fn a_full_disk() {
    let scratch = scratch();
    let mountpoint = scratch.path().join("small");
    let Some(disk) = SmallDisk::mount(&mountpoint) else {
        return writes_beyond_a_limit();
    };
    let out = disk.0.join("tiles");
    let run = run(args!["rasterise", "--osm", helsinki(), "--out", &out]);
    assert_failed_to_write(&run, &out, "No space left");
}

/// Writes fail beyond 4 KiB; once they do not, the same command finishes the output.
#[test]
fn writes_beyond_a_limit() {
    let scratch = scratch();
    let (out, fresh) = (scratch.path().join("tiles"), scratch.path().join("fresh"));
    let limited = holescout_after("ulimit -f 8; trap '' XFSZ");
    let failed = run_command(limited, rasterise(&helsinki(), &out));
    assert_failed_to_write(&failed, &out, "too large");

    run(rasterise(&helsinki(), &out)).succeeded();
    run(rasterise(&helsinki(), &fresh)).succeeded();
    let differing = differences(&files(&out), &files(&fresh));
    assert!(differing.is_empty(), "{differing:?}");
}

/// Whoever reads standard output may leave early (`holescout config | head -1`).
#[test]
fn a_reader_that_leaves_is_no_failure() {
    let mut command = holescout();
    let mut child = command.arg("config").spawn().expect("the command starts");
    drop(child.stdout.take());
    let status = child.wait().expect("the command ends");
    assert_eq!(status.code(), Some(0));
}

/// Runs the command on files with one flipped byte each. It may find the damage or not, but
/// must end by itself and without a panic; and what it refuses leaves nothing.
fn fuzz(name: &str, file: &[u8], times: usize, seed: u64) -> Vec<String> {
    let mut random = Random(seed);
    let mut failures = Vec::new();
    for _ in 0..times {
        let scratch = scratch();
        let (osm, out) = (scratch.path().join("fuzzed.osm.pbf"), scratch.path().join("tiles"));
        let (at, flip) = (random.below(file.len()), 1 + random.below(255) as u8);
        let mut damaged = file.to_vec();
        damaged[at] ^= flip;
        write(&osm, damaged);
        // Every tile is too empty: made, but not written, which takes most of the time.
        let mut args = rasterise(&osm, &out);
        *args.last_mut().expect("the value of --min-built") = "1".into();
        let run = run_command(bounded_holescout(), args);
        let sound = match run.code {
            Some(0) => out.join("manifest.json").exists(),
            Some(INVALID_INPUT) => !out.exists(),
            _ => false, // a panic (101), a signal, or the machine blamed for the file
        };
        if !sound {
            let tail: Vec<_> = run.stderr.lines().rev().take(4).collect();
            let (code, signal) = (run.code, run.signal);
            failures.push(format!(
                "{name}, byte {at} ^ {flip:#04x}: code {code:?}, signal {signal:?}, {tail:?}"
            ));
        }
    }
    failures
}

#[test]
fn flipped_bytes_in_a_small_extract() {
    let failures = fuzz("small", &read(&small_extract()), 300, 1);
    assert!(failures.is_empty(), "\n{}", failures.join("\n"));
}

/// In the file as it is, where checksums find nearly everything, and uncompressed.
#[test]
fn flipped_bytes_in_helsinki() {
    let file = read(&helsinki());
    let mut failures = fuzz("packed", &file, 30, 2);
    failures.extend(fuzz("unpacked", &pbf::unpacked(&file), 30, 3));
    assert!(failures.is_empty(), "\n{}", failures.join("\n"));
}
