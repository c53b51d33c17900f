//! From the fixtures to a dataset: `rasterise`, `import-rsrp`, `shard` and `verify`, and
//! then everything in the dataset against what its inputs say, recomputed here cell by cell.

#![expect(clippy::float_cmp, reason = "values that must be exact are compared exactly")]

mod pipeline;

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

use holescout::config::Split;
use holescout::dataset::Record;
use ndarray::{Array2, s};
use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_json::{Value, json};

use pipeline::numpy::{matrix, npz_members};
use pipeline::{
    DATASET_FILES, HELSINKI, Stages, Tree, assert_same_files, assert_says, fixture,
    helsinki_config, import, plant, rasterise, read, read_json, run, sha256, shard, temporary_dir,
    tree, verify, write,
};

const CELLS: usize = 121;
const FACTOR: usize = 4;
const FLOOR: f64 = -160.0;
/// Transmit power of the fixtures' maps per resource element, in dBm.
const POWER: f64 = 15.0;

// Reading a dataset without the product ---------------------------------------------------

/// Any value of `MessagePack`.
#[derive(Debug, Clone, PartialEq)]
enum Any {
    Bool,
    Number(f64),
    Text(String),
    Bytes(Vec<u8>),
    List(Vec<Any>),
    Map(BTreeMap<String, Any>),
}

impl<'de> Deserialize<'de> for Any {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Anything;
        impl<'de> Visitor<'de> for Anything {
            type Value = Any;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("anything")
            }
            fn visit_bool<E>(self, _: bool) -> Result<Any, E> {
                Ok(Any::Bool)
            }
            fn visit_u64<E>(self, value: u64) -> Result<Any, E> {
                Ok(Any::Number(value as f64))
            }
            fn visit_i64<E>(self, value: i64) -> Result<Any, E> {
                Ok(Any::Number(value as f64))
            }
            fn visit_f64<E>(self, value: f64) -> Result<Any, E> {
                Ok(Any::Number(value))
            }
            fn visit_str<E>(self, value: &str) -> Result<Any, E> {
                Ok(Any::Text(value.to_owned()))
            }
            fn visit_bytes<E>(self, value: &[u8]) -> Result<Any, E> {
                Ok(Any::Bytes(value.to_vec()))
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Any, A::Error> {
                let mut list = vec![];
                while let Some(item) = seq.next_element()? {
                    list.push(item);
                }
                Ok(Any::List(list))
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Any, A::Error> {
                let mut entries = BTreeMap::new();
                while let Some((key, value)) = map.next_entry()? {
                    entries.insert(key, value);
                }
                Ok(Any::Map(entries))
            }
        }
        deserializer.deserialize_any(Anything)
    }
}

impl Any {
    fn get(&self, key: &str) -> &Any {
        let Any::Map(entries) = self else {
            unreachable!("{key} of something that is no map");
        };
        &entries[key]
    }

    fn bytes(&self) -> &[u8] {
        let Any::Bytes(bytes) = self else {
            unreachable!("no byte string: {self:?}");
        };
        bytes
    }

    fn number(&self) -> f64 {
        let Any::Number(number) = self else {
            unreachable!("no number: {self:?}");
        };
        *number
    }

    fn text(&self) -> &str {
        let Any::Text(text) = self else {
            unreachable!("no text: {self:?}");
        };
        text
    }
}

fn text(value: &str) -> Any {
    Any::Text(value.to_owned())
}

/// The frames of a shard by its seek table: offset, compressed and decompressed size, checksum.
fn seek_table(shard: &[u8]) -> Vec<(usize, usize, usize, u32)> {
    let word = |at: usize| {
        let four = shard[at..at + 4].try_into().expect("four bytes");
        u32::from_le_bytes(four)
    };
    let end = shard.len();
    assert_eq!(word(end - 4), 0x8F92_EAB1, "the magic number of the format");
    assert_eq!(shard[end - 5], 0x80, "entries with checksums");
    let frames = word(end - 9) as usize;
    let table = end - 9 - 12 * frames;
    assert_eq!(word(table - 8), 0x184D_2A5E, "a skippable frame");
    assert_eq!(word(table - 4) as usize, end - table, "its size");
    let mut offset = 0;
    let entries = (0..frames).map(|frame| {
        let at = table + 12 * frame;
        let (compressed, decompressed) = (word(at) as usize, word(at + 4) as usize);
        let entry = (offset, compressed, decompressed, word(at + 8));
        offset += compressed;
        entry
    });
    let entries = entries.collect();
    assert_eq!(offset, table - 8, "frames fill the file up to the table");
    entries
}

/// The records of a shard as bytes, each from its own frame.
fn records(shard: &[u8]) -> Vec<Vec<u8>> {
    let table = seek_table(shard).into_iter();
    let frame = |(offset, compressed, decompressed, checksum): (usize, usize, usize, u32)| {
        let frame = &shard[offset..offset + compressed];
        let last = frame.last_chunk().expect("a checksum at the frame's end");
        assert_eq!(u32::from_le_bytes(*last), checksum, "the table repeats it");
        let record = zstd::bulk::decompress(frame, decompressed).expect("a whole frame");
        assert_eq!(record.len(), decompressed);
        record
    };
    table.map(frame).collect()
}

fn shard_files() -> [&'static str; 2] {
    [DATASET_FILES[4], DATASET_FILES[5]]
}

/// All records of the fixtures' dataset, with their splits.
fn all_records() -> Vec<(&'static str, Vec<u8>)> {
    ["train", "val"]
        .into_iter()
        .zip(shard_files())
        .flat_map(|(split, file)| {
            let shard = read(&HELSINKI.dataset.join(file));
            records(&shard).into_iter().map(move |record| (split, record))
        })
        .collect()
}

fn manifest() -> Value {
    read_json(&HELSINKI.dataset.join("manifest.json"))
}

// What is in it -----------------------------------------------------------------------------

#[test]
fn the_fixtures_become_eight_and_seven_records() {
    let names: Vec<String> = tree(&HELSINKI.dataset).into_keys().collect();
    let mut expected = DATASET_FILES;
    expected.sort_unstable();
    assert_eq!(names, expected);
    let manifest = manifest();
    assert_eq!(manifest["statistics"]["train"]["records"], 8);
    assert_eq!(manifest["statistics"]["val"]["records"], 7);
    assert_eq!(manifest["statistics"].as_object().map(serde_json::Map::len), Some(2));
    let dropped = &manifest["dropped"];
    assert_eq!(dropped["overlapping_another_split"].as_array().map(Vec::len), Some(9));
    assert_eq!(dropped["rejected_maps"], json!({}));
    let tiles = read_json(&HELSINKI.tiles.join("manifest.json"));
    let count = tiles["tiles"].as_array().expect("a list").len();
    assert_eq!(dropped["tiles_without_map"], count - 24);
    assert_eq!(dropped["osm_objects"], tiles["problems"]);
    assert_eq!((&manifest["cells"], &manifest["cell_m"]), (&json!(121), &json!(4.0)));
    let said = run(&mut verify(&HELSINKI.dataset)).succeeds();
    assert_says(&said, &["sound", "6 files", "15 items"]);
}

#[test]
fn summaries_are_one_line_of_json() {
    let dir = temporary_dir();
    let mut command = shard(&HELSINKI.tiles, &HELSINKI.rsrp, dir.path());
    let stdout = run(command.arg("--json")).succeeds();
    let summary: Value = serde_json::from_str(stdout.trim_end()).expect("one line of JSON");
    assert_eq!(summary["records"], 15);
    assert_eq!(summary["dropped"], manifest()["dropped"]);
    let stdout = run(verify(dir.path()).arg("--json")).succeeds();
    let summary: Value = serde_json::from_str(stdout.trim_end()).expect("one line of JSON");
    assert_eq!(summary["failures"], json!([]));
    assert_eq!(summary["items"], 15);
}

#[test]
fn checksums_and_digests_are_those_of_the_files() {
    for (stage, items) in
        [(&HELSINKI.tiles, "tiles"), (&HELSINKI.rsrp, "maps"), (&HELSINKI.dataset, "shards")]
    {
        let files = tree(stage);
        let sums = String::from_utf8(files["SHA256SUMS"].clone()).expect("text");
        let expected: Vec<String> = files
            .iter()
            .filter(|(name, _)| *name != "SHA256SUMS")
            .map(|(name, bytes)| format!("{}  {name}\n", sha256(bytes)))
            .collect();
        assert_eq!(sums, expected.concat(), "sha256sum's own format");
        let manifest = read_json(&stage.join("manifest.json"));
        for item in manifest[items].as_array().expect("a list") {
            let bytes = &files[item["file"].as_str().expect("a name")];
            let digest = json!({"bytes": bytes.len(), "sha256": sha256(bytes)});
            assert_eq!(item["digest"], digest);
        }
    }
}

/// A manifest names what it was made from by content.
#[test]
fn every_stage_names_its_inputs_by_digest() {
    let digest = |path: &Path| {
        let bytes = read(path);
        json!({"bytes": bytes.len(), "sha256": sha256(&bytes)})
    };
    let tiles_sha = sha256(&read(&HELSINKI.tiles.join("manifest.json")));
    let tiles = read_json(&HELSINKI.tiles.join("manifest.json"));
    assert_eq!(tiles["inputs"][0]["digest"], digest(&fixture("helsinki/helsinki.osm.pbf")));
    let rsrp = read_json(&HELSINKI.rsrp.join("manifest.json"));
    assert_eq!(rsrp["tiles_manifest_sha256"], tiles_sha);
    for map in rsrp["maps"].as_array().expect("a list") {
        let name = map["source"]["file"].as_str().expect("a name");
        let source = fixture("helsinki/rsrp").join(name);
        assert_eq!(map["source"]["digest"], digest(&source));
    }
    let dataset = manifest();
    assert_eq!(dataset["inputs"], tiles["inputs"]);
    assert_eq!(dataset["tiles_manifest_sha256"], tiles_sha);
    let rsrp_sha = sha256(&read(&HELSINKI.rsrp.join("manifest.json")));
    assert_eq!(dataset["rsrp_manifest_sha256"], rsrp_sha);
}

/// Card and notice are what a person reads first.
#[test]
fn card_and_notice_tell_licence_and_figures() {
    let file = |name: &str| String::from_utf8(read(&HELSINKI.dataset.join(name))).expect("text");
    let notice = file("NOTICE");
    let extract = sha256(&read(&fixture("helsinki/helsinki.osm.pbf")));
    assert_says(
        &notice,
        &["ODbL-1.0", "© OpenStreetMap contributors", "helsinki.osm.pbf", &extract],
    );
    assert_says(&file("README.md"), &["15 places", "121 × 121", "| train | 8 |", "| val | 7 |"]);
}

#[test]
fn a_shard_is_one_stream_of_records_and_each_frame_stands_alone() {
    for (file, count) in shard_files().into_iter().zip([8, 7]) {
        let shard = read(&HELSINKI.dataset.join(file));
        let records = records(&shard);
        assert_eq!(records.len(), count);
        let stream = zstd::stream::decode_all(&shard[..]).expect("a plain stream");
        assert!(stream == records.concat(), "{file}: another stream");
    }
}

#[test]
fn the_index_leads_to_every_record() {
    let manifest = manifest();
    let index = manifest["records"].as_array().expect("a list");
    assert_eq!(index.len(), 15);
    let ids: Vec<&str> = index.iter().map(|entry| entry["id"].as_str().expect("a name")).collect();
    assert!(ids.is_sorted(), "by name");
    for entry in index {
        let shard = read(&HELSINKI.dataset.join(entry["shard"].as_str().expect("a name")));
        let frame = entry["frame"].as_u64().expect("a number") as usize;
        let record: Any = rmp_serde::from_slice(&records(&shard)[frame]).expect("MessagePack");
        assert_eq!(*record.get("id"), text(entry["id"].as_str().expect("a name")));
    }
}

#[test]
fn records_have_the_documented_fields() {
    let mut ids = vec![];
    for (split, bytes) in all_records() {
        let record: Any = rmp_serde::from_slice(&bytes).expect("MessagePack");
        let Any::Map(fields) = &record else {
            unreachable!("a map of fields");
        };
        let names: Vec<&str> = fields.keys().map(String::as_str).collect();
        let documented = [
            "base_station",
            "cell_m",
            "center_lon_lat",
            "center_m",
            "epsg",
            "flight_height_m",
            "floor_dbm",
            "height_m",
            "id",
            "mask",
            "provenance",
            "radio",
            "row_order",
            "rsrp_dbm",
            "schema",
            "split",
        ];
        assert_eq!(names, documented);
        assert_eq!(*record.get("schema"), text("record.v1"));
        assert_eq!(*record.get("split"), text(split));
        assert_eq!(*record.get("row_order"), text("north_first"));
        assert_eq!(record.get("cell_m").number(), 4.0);
        assert_eq!(record.get("epsg").number(), 32635.0);
        let station = record.get("base_station");
        assert_eq!(station.get("power_per_re_dbm").number(), POWER);
        assert_eq!(record.get("radio").get("frequency_hz").number(), 3.5e9);
        for field in ["height_m", "rsrp_dbm", "mask"] {
            assert_eq!(matrix(record.get(field).bytes()).dim(), (CELLS, CELLS));
        }
        ids.push(record.get("id").text().to_owned());
    }
    ids.sort();
    ids.dedup();
    assert_eq!(ids.len(), 15, "no record twice");
}

#[test]
fn the_library_reads_the_same_records() {
    for (split, bytes) in all_records() {
        let any: Any = rmp_serde::from_slice(&bytes).expect("MessagePack");
        let record: Record = rmp_serde::from_slice(&bytes).expect("a record");
        assert_eq!(record.split, if split == "train" { Split::Train } else { Split::Val });
        assert_eq!(any.get("id").text(), record.id.to_string());
        assert_eq!(any.get("mask").bytes(), &record.mask[..]);
        assert_eq!(record.encode(), bytes, "one way of writing a record");
        let grids = record.sound_grids(CELLS).expect("sound");
        assert_eq!(grids.mask.mapv(f64::from), matrix(any.get("mask").bytes()));
    }
}

// The cells, recomputed --------------------------------------------------------------------

/// Heights of a tile's central window, at 1 m.
fn heights(id: &str) -> Array2<f64> {
    let members = npz_members(&HELSINKI.tiles.join(format!("{id}.npz")));
    let window = 298..298 + 484;
    matrix(&members["height_m"]).slice(s![window.clone(), window]).to_owned()
}

/// RSRP of a fixture at 1 m, north first; minus infinity where no path arrives.
fn traced_rsrp(id: &str) -> Array2<f64> {
    let path = fixture("helsinki/rsrp").join(format!("{id}.npz"));
    let gain = matrix(&npz_members(&path)["path_gain_db"]);
    // The fixtures are south first.
    gain.slice(s![..;-1, ..]).mapv(|gain| gain + POWER)
}

/// Height, RSRP and mask of one cell of a record, from its 16 cells of 1 m.
fn expected_cell(heights: &Array2<f64>, rsrp: &Array2<f64>, at: (usize, usize)) -> (f64, f64, f64) {
    let (mut highest, mut outdoor, mut reached, mut power) = (0.0_f64, 0, 0, 0.0);
    for row in at.0 * FACTOR..(at.0 + 1) * FACTOR {
        for column in at.1 * FACTOR..(at.1 + 1) * FACTOR {
            let height = heights[[row, column]];
            highest = highest.max(height);
            if height < 2.0 {
                outdoor += 1;
                let level = rsrp[[row, column]];
                if level > f64::NEG_INFINITY {
                    reached += 1;
                    power += 10.0_f64.powf(level / 10.0);
                }
            }
        }
    }
    let level = if reached == 0 { FLOOR } else { 10.0 * (power / f64::from(outdoor)).log10() };
    let kind = match (highest >= 2.0, reached) {
        (true, _) => 1.0,
        (false, 0) => 2.0,
        _ => 0.0,
    };
    (highest, level, kind)
}

#[test]
fn grids_are_what_the_inputs_say_cell_by_cell() {
    let mut kinds = [0; 3];
    for (_, bytes) in all_records() {
        let record: Any = rmp_serde::from_slice(&bytes).expect("MessagePack");
        let id = record.get("id").text();
        let (heights, traced) = (heights(id), traced_rsrp(id));
        let grid = |field: &str| matrix(record.get(field).bytes());
        let (height, rsrp, mask) = (grid("height_m"), grid("rsrp_dbm"), grid("mask"));
        for (at, &kind) in mask.indexed_iter() {
            let (expected_height, expected_rsrp, expected_kind) =
                expected_cell(&heights, &traced, at);
            assert_eq!(height[at], expected_height, "{id} {at:?}");
            assert_eq!(kind, expected_kind, "{id} {at:?}");
            // Values were stored as float32 at 1 m and again at 4 m.
            let error = (rsrp[at] - expected_rsrp).abs();
            assert!(error < 5e-5, "{id} {at:?}: {} is not {expected_rsrp}", rsrp[at]);
            kinds[kind as usize] += 1;
        }
    }
    assert!(kinds.iter().all(|&count| count > 10_000), "all kinds occur: {kinds:?}");
    let statistics = &manifest()["statistics"];
    for (kind, name) in ["reached", "building", "unreached"].into_iter().enumerate() {
        let of = |split: &str| statistics[split]["cells"][name].as_u64().expect("a count");
        assert_eq!(of("train") + of("val"), kinds[kind]);
    }
}

#[test]
fn no_cell_of_one_split_lies_in_the_other() {
    let mut places: BTreeMap<&str, Vec<(f64, f64)>> = BTreeMap::new();
    for (split, bytes) in all_records() {
        let record: Any = rmp_serde::from_slice(&bytes).expect("MessagePack");
        let Any::List(center) = record.get("center_m") else {
            unreachable!("two numbers");
        };
        let place = (center[0].number(), center[1].number());
        places.entry(split).or_default().push(place);
    }
    for a in &places["train"] {
        for b in &places["val"] {
            let apart = (a.0 - b.0).abs().max((a.1 - b.1).abs());
            assert!(apart >= 484.0, "{a:?} and {b:?} share cells");
        }
    }
}

// The same bytes everywhere ------------------------------------------------------------------

/// Runs all stages and returns their files.
fn all_stages(stages: &Stages, osm: &Path, maps: &Path, flags: &[&str]) -> [Tree; 3] {
    let Stages { tiles, rsrp, dataset } = stages;
    let mut first = pipeline::holescout("rasterise");
    first.arg("--osm").arg(osm).arg("--out").arg(tiles);
    first.arg("--config").arg(helsinki_config());
    for mut command in [first, import(maps, tiles, rsrp), shard(tiles, rsrp, dataset)] {
        let zone = ("TZ", "Pacific/Kiritimati");
        run(command.args(flags).env(zone.0, zone.1).env("LANG", "tr_TR.UTF-8")).succeeds();
    }
    [tree(tiles), tree(rsrp), tree(dataset)]
}

#[test]
fn the_same_bytes_with_any_number_of_threads_in_any_place() {
    let expected = [&HELSINKI.tiles, &HELSINKI.rsrp, &HELSINKI.dataset].map(|stage| tree(stage));
    for threads in ["1", "2", "8"] {
        let dir = temporary_dir();
        let root = dir.path().join(format!("somewhere else with {threads}"));
        let (osm, maps) = (root.join("helsinki.osm.pbf"), root.join("maps"));
        write(&osm, read(&fixture("helsinki/helsinki.osm.pbf")));
        plant(&maps, &tree(&fixture("helsinki/rsrp")));
        let stages =
            Stages { tiles: root.join("a"), rsrp: root.join("b"), dataset: root.join("c") };
        let found = all_stages(&stages, &osm, &maps, &["--threads", threads]);
        for (found, expected) in found.iter().zip(&expected) {
            assert_same_files(found, expected);
        }
    }
}

#[test]
fn paths_relative_to_the_working_directory_give_the_same_bytes() {
    let dir = temporary_dir();
    plant(&dir.path().join("tiles"), &tree(&HELSINKI.tiles));
    plant(&dir.path().join("rsrp"), &tree(&HELSINKI.rsrp));
    let (tiles, rsrp, out) = ("tiles", "./rsrp/", "new/dataset");
    let mut command = shard(Path::new(tiles), Path::new(rsrp), Path::new(out));
    run(command.current_dir(dir.path())).succeeds();
    assert_same_files(&tree(&dir.path().join(out)), &tree(&HELSINKI.dataset));
}

#[test]
fn a_finished_stage_may_be_run_again() {
    let dir = temporary_dir();
    let out = dir.path().join("dataset");
    for _ in 0..2 {
        run(&mut shard(&HELSINKI.tiles, &HELSINKI.rsrp, &out)).succeeds();
        assert_same_files(&tree(&out), &tree(&HELSINKI.dataset));
    }
}

// Other configurations -----------------------------------------------------------------------

#[test]
fn smaller_shards_hold_the_same_records_in_the_same_order() {
    let dir = temporary_dir();
    let mut command = shard(&HELSINKI.tiles, &HELSINKI.rsrp, dir.path());
    run(command.args(["--records-per-shard", "3", "--zstd-level", "1"])).succeeds();
    run(&mut verify(dir.path())).succeeds();
    let files = tree(dir.path());
    for (split, count, whole) in [("train", 3, shard_files()[0]), ("val", 3, shard_files()[1])] {
        let of_split = files.range(format!("{split}/")..format!("{split}0"));
        let shards: Vec<_> = of_split.map(|(_, bytes)| records(bytes)).collect();
        assert_eq!(shards.len(), count);
        let whole = records(&read(&HELSINKI.dataset.join(whole)));
        assert_eq!(shards.concat(), whole);
    }
}

#[test]
fn every_way_of_downsampling_gives_a_sound_dataset() {
    let defaults = fs::read_to_string(helsinki_config()).expect("read");
    for height in ["max", "mean", "nearest"] {
        for rsrp in ["linear_mean", "mean_db", "nearest"] {
            for factor in [1, 2, 4, 11] {
                let dir = temporary_dir();
                let config = dir.path().join("config.toml");
                let section = format!(
                    "[shard]\nheight = \"{height}\"\nrsrp = \"{rsrp}\"\ndownsample = {factor}\nzstd_level = 1\n"
                );
                write(&config, format!("{defaults}\n{section}"));
                let out = dir.path().join("dataset");
                if (factor == 1 || factor == 2) && (height, rsrp) != ("mean", "nearest") {
                    continue; // large records: one pair will do
                }
                let mut command = pipeline::holescout("shard");
                command.arg("--tiles").arg(&HELSINKI.tiles);
                command.arg("--rsrp").arg(&HELSINKI.rsrp);
                command.arg("--config").arg(&config).arg("--out").arg(&out);
                run(&mut command).succeeds();
                run(&mut verify(&out)).succeeds();
                let manifest = read_json(&out.join("manifest.json"));
                assert_eq!(manifest["cells"], 484 / factor);
            }
        }
    }
}

#[test]
fn maps_of_other_tiles_are_refused() {
    let dir = temporary_dir();
    let (tiles, out) = (dir.path().join("tiles"), dir.path().join("dataset"));
    run(rasterise(&tiles).args(["--bbox", "24.94,60.169,24.951,60.172"])).succeeds();
    let message = run(&mut shard(&tiles, &HELSINKI.rsrp, &out)).refused();
    assert_says(&message, &["other tiles", "import-rsrp"]);
    assert!(!out.exists(), "nothing was begun");
    // Stages are not mixed up either.
    let message = run(&mut shard(&HELSINKI.rsrp, &HELSINKI.rsrp, &out)).refused();
    assert_says(&message, &["rsrp.v1", "tiles.v2", "holescout rasterise"]);
    let message = run(&mut shard(&HELSINKI.tiles, &HELSINKI.tiles, &out)).refused();
    assert_says(&message, &["tiles.v2", "rsrp.v1", "holescout import-rsrp"]);
}

#[test]
fn damaged_inputs_are_named() {
    let dir = temporary_dir();
    let stages: [PathBuf; 2] = [dir.path().join("tiles"), dir.path().join("rsrp")];
    plant(&stages[0], &tree(&HELSINKI.tiles));
    plant(&stages[1], &tree(&HELSINKI.rsrp));
    let out = dir.path().join("dataset");
    let used = manifest()["records"][0]["id"].as_str().expect("a name").to_owned();
    for stage in &stages {
        let path = stage.join(format!("{used}.npz"));
        let whole = read(&path);
        let mut damaged = whole.clone();
        damaged[whole.len() / 2] ^= 1;
        write(&path, damaged);
        let message = run(&mut shard(&stages[0], &stages[1], &out)).refused();
        assert_says(&message, &[&path.to_string_lossy(), "expected", "found"]);
        assert!(!out.join("manifest.json").exists());
        write(&path, whole);
    }
    // What was begun is finished once the inputs are whole again.
    run(&mut shard(&stages[0], &stages[1], &out)).succeeds();
    assert_same_files(&tree(&out), &tree(&HELSINKI.dataset));
}

#[test]
fn without_an_imported_map_there_is_no_dataset() {
    let dir = temporary_dir();
    let (maps, rsrp) = (dir.path().join("maps"), dir.path().join("rsrp"));
    write(&maps.join("map.npz"), "PK");
    run(&mut import(&maps, &HELSINKI.tiles, &rsrp)).succeeds();
    let out = dir.path().join("dataset");
    let message = run(&mut shard(&HELSINKI.tiles, &rsrp, &out)).refused();
    assert_says(&message, &["no radio map", "1 were rejected", "rejected.csv"]);
}
