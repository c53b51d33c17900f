//! `verify` finds what checksums cannot tell: records that contradict themselves, the
//! manifest or each other, in datasets forged with all checksums made anew.

mod pipeline;

use std::collections::BTreeMap;
use std::path::Path;

use holescout::dataset::{Grids, Record, statistics_of};
use holescout::store::{SeekTable, SeekableWriter, compress_frame, npy_bytes};
use ndarray::{Array2, s};
use ndarray_npy::WritableElement;
use serde_bytes::ByteBuf;
use serde_json::{Value, json};

use pipeline::repeats::REPEATED;
use pipeline::{
    DATASET_FILES, HELSINKI, assert_says, copy_of, plant, read_json, run, sha256, verify,
};

/// A dataset, taken apart. [`Forgery::verdict`] puts it together again with
/// index, digests, statistics and checksums that fit what has been changed.
struct Forgery {
    dataset: &'static Path,
    manifest: Value,
    shards: BTreeMap<String, Vec<Record>>,
    /// Whether index and statistics follow the records.
    follows: bool,
}

fn to_text(manifest: &Value) -> Vec<u8> {
    serde_json::to_vec_pretty(manifest).expect("JSON")
}

/// Adds numbers to numbers of the same place; leaves thresholds and steps alone.
fn add(sum: &mut Value, more: &Value) {
    match (sum, more) {
        (Value::Object(sum), Value::Object(more)) => {
            for (key, value) in sum {
                if !["hole_threshold_dbm", "first_dbm", "step_db"].contains(&key.as_str()) {
                    add(value, &more[key]);
                }
            }
        }
        (Value::Array(sum), Value::Array(more)) => {
            sum.iter_mut().zip(more).for_each(|(sum, more)| add(sum, more));
        }
        (sum, more) => {
            let number = |value: &Value| value.as_u64().expect("a count");
            *sum = json!(number(sum).wrapping_add(number(more)));
        }
    }
}

impl Forgery {
    /// The fixtures' dataset.
    fn new() -> Self {
        Self::of(&HELSINKI.dataset)
    }

    fn of(dataset: &'static Path) -> Self {
        let manifest = read_json(&dataset.join("manifest.json"));
        let mut shards = BTreeMap::new();
        for shard in manifest["shards"].as_array().expect("shards") {
            let name = shard["file"].as_str().expect("a name");
            let (mut file, table) = SeekTable::open(&dataset.join(name)).expect("opened");
            let records: Vec<Record> = (0..table.len())
                .map(|frame| table.frame(&mut file, frame).expect("whole"))
                .map(|bytes| Record::decode(&bytes).expect("a record"))
                .collect();
            shards.insert(name.to_owned(), records);
        }
        Self { dataset, manifest, shards, follows: true }
    }

    fn train(&mut self) -> &mut Vec<Record> {
        self.shards.get_mut(DATASET_FILES[4]).expect("a shard")
    }

    /// The first record.
    fn first(&mut self) -> &mut Record {
        self.shards.values_mut().find_map(|records| records.first_mut()).expect("a record")
    }

    fn val(&mut self) -> &mut Vec<Record> {
        self.shards.get_mut(DATASET_FILES[5]).expect("a shard")
    }

    /// Puts the arrays of the first record through a change.
    fn change_grids(&mut self, change: impl Fn(&mut Grids)) {
        let record = self.first();
        let mut grids = record.grids(121).expect("arrays");
        change(&mut grids);
        *record = record.clone().with_grids(&grids);
    }

    /// Index and statistics of the records as they are now.
    fn follow(&mut self) {
        let mut index = vec![];
        let mut statistics = json!({});
        for (number, (file, records)) in self.shards.iter().enumerate() {
            self.manifest["shards"][number]["records"] = json!(records.len());
            let split = self.manifest["shards"][number]["split"].clone();
            let split = split.as_str().expect("a name");
            for (frame, record) in records.iter().enumerate() {
                index.push(json!({"id": record.id, "shard": file, "frame": frame}));
                let Ok(grids) = record.grids(121) else {
                    continue;
                };
                let of_record = json!(statistics_of(record, &grids));
                match statistics.get_mut(split) {
                    Some(sum) => add(sum, &of_record),
                    None => statistics[split] = of_record,
                }
            }
        }
        index.sort_by_key(|entry| entry["id"].to_string());
        self.manifest["records"] = json!(index);
        self.manifest["statistics"] = statistics;
    }

    /// Writes the dataset and verifies it.
    fn run(mut self) -> pipeline::Run {
        if self.follows {
            self.follow();
        }
        let (_dir, root, mut files) = copy_of(self.dataset);
        for (number, (file, records)) in self.shards.iter().enumerate() {
            let mut writer = SeekableWriter::new(vec![]);
            for record in records {
                let bytes = record.encode();
                let frame = compress_frame(&bytes, 9).expect("compressed");
                writer.push(&frame, bytes.len()).expect("written");
            }
            let bytes = writer.finish().expect("written");
            let digest = json!({"bytes": bytes.len(), "sha256": sha256(&bytes)});
            self.manifest["shards"][number]["digest"] = digest;
            files.insert(file.clone(), bytes);
        }
        files.insert("manifest.json".to_owned(), to_text(&self.manifest));
        files.remove("SHA256SUMS");
        let sums: Vec<String> =
            files.iter().map(|(name, bytes)| format!("{}  {name}\n", sha256(bytes))).collect();
        files.insert("SHA256SUMS".to_owned(), sums.concat().into_bytes());
        plant(&root, &files);
        run(&mut verify(&root))
    }

    /// What is said against the forgery.
    fn verdict(self) -> String {
        self.run().refused()
    }
}

/// The tests below mean something: a forgery that changes nothing passes.
#[test]
fn a_dataset_put_together_again_is_sound() {
    Forgery::new().run().succeeds();
}

#[test]
fn a_record_in_the_shard_of_another_split_is_found() {
    let mut forgery = Forgery::new();
    let moved = forgery.train().remove(2);
    let id = moved.id.to_string();
    forgery.val().push(moved);
    assert_says(&forgery.verdict(), &[&id, "split differs", DATASET_FILES[5]]);
}

#[test]
fn a_record_that_overlaps_another_split_is_found() {
    let mut forgery = Forgery::new();
    let mut moved = forgery.train().remove(2);
    moved.split = forgery.val()[0].split;
    let id = moved.id.to_string();
    forgery.val().push(moved);
    assert_says(&forgery.verdict(), &[&id, "overlaps", "train", "val"]);
}

/// The distance that splits must keep is not the forger's to choose: records say how large
/// they are.
#[test]
fn a_smaller_window_in_the_manifest_does_not_hide_overlaps() {
    let mut forgery = Forgery::new();
    let mut moved = forgery.train().remove(2);
    moved.split = forgery.val()[0].split;
    forgery.val().push(moved);
    forgery.manifest["config"]["grid"]["crop_m"] = json!(4);
    forgery.verdict();
}

#[test]
fn a_record_that_occurs_twice_is_found() {
    for into in [DATASET_FILES[4], DATASET_FILES[5]] {
        let mut forgery = Forgery::new();
        let mut twin = forgery.train()[1].clone();
        let id = twin.id.to_string();
        if into == DATASET_FILES[5] {
            twin.split = forgery.val()[0].split;
        }
        forgery.shards.get_mut(into).expect("a shard").push(twin);
        assert_says(&forgery.verdict(), &[&id, "more than once"]);
    }
}

#[test]
fn index_and_shards_must_agree() {
    let follow_then = |change: fn(&mut Forgery)| {
        let mut forgery = Forgery::new();
        forgery.follows = false;
        change(&mut forgery);
        forgery.verdict()
    };
    // A record left out.
    let message = follow_then(|forgery| drop(forgery.train().pop()));
    assert_says(&message, &["frame 7 holds nothing", "7 frames, the manifest says 8"]);
    // Two records in each other's place.
    let message = follow_then(|forgery| forgery.val().swap(0, 1));
    assert_says(&message, &["frame 0 holds utm35n", "frame 1 holds utm35n"]);
    // A record that the index does not know, and one that it knows twice.
    let message = follow_then(|forgery| {
        forgery.manifest["records"].as_array_mut().expect("a list").remove(4);
    });
    assert_says(&message, &["not in the manifest's index"]);
    let message = follow_then(|forgery| {
        let index = forgery.manifest["records"].as_array_mut().expect("a list");
        index.push(index[4].clone());
    });
    assert_says(&message, &["holds nothing"]);
    // A shard that the manifest does not know.
    let message = follow_then(|forgery| {
        forgery.manifest["shards"].as_array_mut().expect("a list").remove(1);
        forgery.shards.remove(DATASET_FILES[5]);
    });
    assert_says(&message, &[DATASET_FILES[5], "holds nothing"]);
}

#[test]
fn statistics_must_be_those_of_the_records() {
    let paths = [
        "/statistics/train/records",
        "/statistics/val/cells/unreached",
        "/statistics/train/holes",
        "/statistics/val/rsrp/counts/20",
        "/statistics/train/built_cells/default",
    ];
    for path in paths {
        let mut forgery = Forgery::new();
        forgery.follows = false;
        let value = forgery.manifest.pointer_mut(path).expect(path);
        *value = json!(value.as_u64().expect("a count") + 1);
        assert_says(&forgery.verdict(), &["manifest.json", "statistics differ"]);
    }
    let mut forgery = Forgery::new();
    forgery.follows = false;
    let statistics = forgery.manifest["statistics"].as_object_mut().expect("by split");
    statistics.remove("val");
    assert_says(&forgery.verdict(), &["manifest.json", "statistics differ"]);
}

type Change<T> = fn(&mut T);
type GridChange<'a> = &'a dyn Fn(&mut Grids);

#[test]
fn unsound_cells_are_found() {
    let cells_of = |record: &Record| {
        let grids = record.grids(121).expect("arrays");
        [0, 1, 2].map(|kind| {
            let found = grids.mask.indexed_iter().find(|(_, cell)| **cell == kind);
            found.map(|(at, _)| at).expect("a cell of this kind")
        })
    };
    let [reached, building, unreached] = cells_of(&Forgery::new().train()[0]);
    let changes: [(&str, GridChange<'_>); 8] = [
        ("height_m", &|grids| grids.height_m[reached] = -1.0),
        ("height_m", &|grids| {
            grids.height_m[building] = f32::INFINITY;
        }),
        ("rsrp_dbm", &|grids| grids.rsrp_dbm[reached] = f32::NAN),
        ("rsrp_dbm", &|grids| grids.rsrp_dbm[unreached] = -90.0),
        ("mask", &|grids| grids.mask[reached] = 1),
        ("mask", &|grids| grids.mask[building] = 0),
        ("mask", &|grids| grids.mask[reached] = 3),
        ("height_m", &|grids| {
            grids.height_m = grids.height_m.slice(s![..120, ..120]).to_owned();
        }),
    ];
    for (field, change) in changes {
        let mut forgery = Forgery::new();
        let id = forgery.train()[0].id.to_string();
        forgery.change_grids(change);
        assert_says(&forgery.verdict(), &[&id, field, DATASET_FILES[4]]);
    }
    let bytes: [Vec<u8>; 3] = [vec![], vec![0; 1000], npy_bytes(&Array2::<f64>::zeros((121, 121)))];
    for bytes in bytes {
        let mut forgery = Forgery::new();
        let id = forgery.train()[0].id.to_string();
        forgery.train()[0].rsrp_dbm = ByteBuf::from(bytes);
        assert_says(&forgery.verdict(), &[&id, "rsrp_dbm"]);
    }
}

/// Arrays of a record with errors, as integers.
fn packed<T: WritableElement + Clone>(value: T) -> ByteBuf {
    ByteBuf::from(npy_bytes(&Array2::from_elem((121, 121), value)))
}

#[test]
fn unsound_errors_are_found() {
    let whole = || Forgery::of(&REPEATED.dataset);
    whole().run().succeeds();
    let changes: [(&str, Change<Record>); 8] = [
        ("std_error_db", |record| record.std_error_db = Some(packed(435_u16))),
        ("std_error_db", |record| record.std_error_db = Some(packed(100_i16))),
        ("std_error_db", |record| record.std_error_db = Some(ByteBuf::new())),
        ("first_half_share", |record| record.first_half_share = Some(packed(251_u8))),
        ("no level", |record| record.rsrp_dbm = packed(i16::MIN)),
        ("repeats", |record| record.repeats = None),
        ("std_error_db", |record| record.std_error_db = None),
        ("record.v1", |record| record.schema = Record::SCHEMA.to_owned()),
    ];
    for (said, change) in changes {
        let mut forgery = whole();
        let record = forgery.first();
        let id = record.id.to_string();
        change(record);
        assert_says(&forgery.verdict(), &[&id, said]);
    }
    // Sound in itself, and another count of what is sure.
    let mut forgery = whole();
    forgery.follow();
    forgery.follows = false;
    forgery.change_grids(|grids| {
        grids.errors.as_mut().expect("errors").std_error_db.fill(0.0);
    });
    assert_says(&forgery.verdict(), &["manifest.json", "statistics differ"]);
}

#[test]
fn records_must_agree_with_the_manifest() {
    let changes: [(&str, Change<Record>); 8] = [
        ("schema", |record| record.schema = "record.v2".to_owned()),
        ("epsg", |record| record.epsg = 32634),
        ("center_m", |record| record.center_m[0] += 1.0),
        ("center_lon_lat", |record| record.center_lon_lat[0] += 0.1),
        ("cell_m", |record| record.cell_m = 2.0),
        ("row_order", |record| {
            record.row_order = "south_first".to_owned();
        }),
        ("floor_dbm", |record| record.floor_dbm.0 = -170.0),
        ("flight_height_m", |record| record.flight_height_m = 0.5),
    ];
    let mut missed = vec![];
    for (field, change) in changes {
        let mut forgery = Forgery::new();
        change(&mut forgery.train()[0]);
        let outcome = forgery.run();
        if outcome.code != Some(3) || !outcome.stdout.contains(DATASET_FILES[4]) {
            missed.push((field, outcome));
        }
    }
    assert!(missed.is_empty(), "{missed:#?}");
}

#[test]
fn nonsense_in_the_manifest_is_refused_without_a_panic() {
    let most = u64::MAX;
    let changes = [
        ("/cells", json!(0)),
        ("/cells", json!(u32::MAX)),
        ("/cell_m", json!(0.0)),
        ("/epsg", json!(4326)),
        ("/config/grid/crop_m", json!(0)),
        ("/config/grid/side_m", json!(u32::MAX)),
        ("/config/grid/cell_m", json!(0.0)),
        ("/config/shard/downsample", json!(0)),
        ("/statistics/train/records", json!(most)),
        ("/shards/0/records", json!(u32::MAX)),
        ("/shards/0/file", json!("../copy/train/shard-00000.msgpack.zst")),
        ("/shards/0/file", json!("/etc/passwd")),
        ("/shards/0/digest/bytes", json!(most)),
        ("/records/0/frame", json!(u32::MAX)),
        ("/records/0/id", json!("utm35n_e9223372036854775807_n-9223372036854775808")),
        ("/unknown", json!(1)),
    ];
    let mut missed = vec![];
    for (path, value) in changes {
        let mut forgery = Forgery::new();
        forgery.follows = false;
        match forgery.manifest.pointer_mut(path) {
            Some(place) => *place = value.clone(),
            None => forgery.manifest["unknown"] = value.clone(),
        }
        if path.ends_with("bytes") {
            forgery.manifest["shards"][1] = forgery.manifest["shards"][0].clone();
        }
        let outcome = forgery.run();
        if outcome.code != Some(3) {
            missed.push((path, value, outcome));
        }
    }
    assert!(missed.is_empty(), "{missed:#?}");
}

/// Counts that overflow when they are added up.
#[test]
fn endless_counts_in_records_are_refused_without_a_panic() {
    let mut forgery = Forgery::new();
    for record in forgery.train() {
        record.provenance.built_cells.height = u64::MAX;
    }
    forgery.follows = false;
    forgery.verdict();
}

/// Places at the ends of the number range may pass or not, but must not end the run.
#[test]
fn extreme_places_do_not_panic() {
    for id in
        ["utm35n_e9223372036854775807_n9223372036854775807", "utm35n_e-9223372036854775808_n0"]
    {
        let mut forgery = Forgery::new();
        let id = id.parse().expect("an id");
        forgery.train()[0].id = id;
        forgery.train()[0].center_m = id.center();
        let code = forgery.run().code;
        assert!([Some(0), Some(3)].contains(&code), "{code:?}");
    }
}
