//! The loader of training on a real dataset: the same records in the same order with any number
//! of threads and after any interruption, in bounded memory, past damage and panics.
#![allow(clippy::panic, reason = "helpers of tests fail by panicking")]

mod pipeline;

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZero;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock, mpsc};
use std::time::{Duration, Instant};

use holescout::config::{OnDamage, Split};
use holescout::dataset::{
    Dataset, Grids, Loader, LoaderError, LoaderOptions, Order, Record, Share,
};
use holescout::error::{Fault, HasFault};
use holescout::grid::TileId;
use holescout::store::SeekTable;

use serde_json::{Value, json};

use pipeline::{
    HELSINKI, Random, assert_says, copy_of, read, run, sha256, shard, shared_dir, write,
};

const SEED: u64 = 7;
/// Memory for some 250 records, in bytes.
const PLENTY: usize = 1 << 26;

/// The fixtures' dataset with two records a shard, so that there are several.
static DATASET: LazyLock<PathBuf> = LazyLock::new(|| {
    let out = shared_dir("loader").join("dataset");
    let mut command = shard(&HELSINKI.tiles, &HELSINKI.rsrp, &out);
    run(command.args(["--records-per-shard", "2"])).succeeds();
    out
});

fn open(root: &Path) -> Arc<Dataset> {
    Arc::new(Dataset::open(root).expect("opened"))
}

fn options(threads: usize, memory_bytes: usize) -> LoaderOptions {
    let threads = NonZero::new(threads).expect("threads");
    LoaderOptions { threads, memory_bytes, keep: false, ..LoaderOptions::new(SEED) }
}

/// What tells whether a record and all of its values are those that they should be.
type Seen = (TileId, Record, Grids);

fn seen(record: Record, grids: Grids) -> Seen {
    (record.id, record, grids)
}

fn train(threads: usize, memory_bytes: usize, cursor: u64) -> Loader<Seen> {
    let options = options(threads, memory_bytes);
    Loader::new(&open(&DATASET), Split::Train, options, cursor, seen).expect("begun")
}

/// Cursor, number and record of the next items.
fn take(loader: &mut Loader<Seen>, count: usize) -> Vec<(u64, u32, Seen)> {
    let items = loader.take(count).map(|item| item.expect("sound"));
    items.map(|item| (item.cursor, item.number, item.value)).collect()
}

fn records(split: Split) -> Vec<TileId> {
    let ids = open(&DATASET).ids();
    ids.into_iter().filter(|(_, of)| *of == split).map(|(id, _)| id).collect()
}

/// The records of a split as shards have them.
fn stored(split: Split) -> Vec<TileId> {
    open(&DATASET).shards_of(split).into_iter().flat_map(|(_, ids)| ids).collect()
}

/// Which record comes at a cursor, from the order and the shards alone.
fn expected(split: Split) -> impl Fn(u64) -> TileId {
    let stored = stored(split);
    let order = Order::new(SEED, NonZero::new(stored.len() as u32).expect("records"));
    move |cursor| stored[order.at(cursor).1 as usize]
}

#[test]
fn any_number_of_threads_gives_the_order_and_the_records_of_the_dataset() {
    let (dataset, ids) = (open(&DATASET), records(Split::Train));
    let wanted = expected(Split::Train);
    let shards = dataset.manifest().shards.iter().filter(|shard| shard.split == Split::Train);
    assert!(shards.count() > 2, "several shards");
    let count = 3 * ids.len() + 1;
    // Of 200 threads each keeps one shard open only.
    for threads in [1, 2, 8, 200] {
        let mut loader = train(threads, PLENTY, 0);
        assert_eq!(loader.ids(), ids);
        let items = take(&mut loader, count);
        assert_eq!((items.len(), loader.cursor()), (count, count as u64));
        for (at, (cursor, number, (id, record, grids))) in (0..).zip(items) {
            assert_eq!((cursor, id), (at, wanted(at)));
            assert_eq!(id, ids[number as usize]);
            let (same_record, same_grids) = dataset.record_with_grids(id).expect("read");
            assert!(record == same_record && grids == same_grids, "{id} differs");
        }
    }
}

#[test]
fn every_epoch_has_every_record_once_and_an_order_of_its_own() {
    for split in [Split::Train, Split::Val] {
        let dataset = open(&DATASET);
        let loader = Loader::new(&dataset, split, options(2, PLENTY), 0, |record, _| record.id);
        let ids = records(split);
        let loaded = loader.expect("begun").take(6 * ids.len());
        let loaded: Vec<TileId> = loaded.map(|item| item.expect("sound").value).collect();
        let mut orders = BTreeSet::new();
        for epoch in loaded.chunks(ids.len()) {
            let mut sorted = epoch.to_vec();
            sorted.sort_unstable();
            assert_eq!(sorted, ids);
            orders.insert(epoch);
        }
        assert!(orders.len() > 1, "epochs of {split} are alike");
    }
}

/// The ids of a loader's next items.
fn next_ids(loader: &mut Loader<TileId>, count: usize) -> Vec<TileId> {
    loader.take(count).map(|item| item.expect("sound").value).collect()
}

fn loader_of(options: LoaderOptions, cursor: u64) -> Loader<TileId> {
    Loader::new(&open(&DATASET), Split::Train, options, cursor, |record, _| record.id)
        .expect("begun")
}

/// A thousand interruptions: threads, memory, number of processes and whether records are kept
/// change with each, the sequence does not.
#[test]
fn interrupted_epochs_are_continued_exactly() {
    let dataset = open(&DATASET);
    let epoch = records(Split::Train).len();
    let mut random = Random(31);
    let mut interruptions = 0;
    for block in [None, NonZero::new(1), NonZero::new(2)] {
        let of_block = LoaderOptions { block, ..options(1, PLENTY) };
        let uninterrupted = next_ids(&mut loader_of(of_block, 0), 350 * epoch);
        let mut sequence = Vec::new();
        while sequence.len() < uninterrupted.len() {
            let world = NonZero::new(1 + random.below(4) as u32).expect("processes");
            let items = random.below(6);
            let cursor = sequence.len() as u64;
            let mut shares: Vec<Vec<TileId>> = Vec::new();
            let mut cursors = Vec::new();
            for rank in 0..world.get() {
                let memory = [0, 1 << 20, PLENTY][random.below(3)];
                let options = LoaderOptions {
                    block,
                    share: Share::of(rank, world).expect("a rank"),
                    keep: random.below(2) == 0,
                    ..options(1 + random.below(8), memory)
                };
                let decode = |record: Record, _| record.id;
                // A cursor of the last round, as a checkpoint would keep it.
                let loader = Loader::new(&dataset, Split::Train, options, cursor, decode);
                let mut loader = loader.expect("begun");
                shares.push(next_ids(&mut loader, items));
                cursors.push(loader.cursor());
            }
            // Which rank comes first depends on the cursor.
            let processes = world.get() as usize;
            let ranks = (0..processes).map(|at| (cursor as usize + at) % processes);
            let turns = (0..items).flat_map(|item| ranks.clone().map(move |rank| (rank, item)));
            sequence.extend(turns.map(|(rank, item)| shares[rank][item]));
            assert_eq!(cursors.into_iter().min(), Some(sequence.len() as u64));
            interruptions += 1;
        }
        assert!(sequence.starts_with(&uninterrupted), "a continuation differs: {block:?}");
    }
    assert!(interruptions >= 1000, "only {interruptions} interruptions");
}

/// Each process has its part of every epoch: nothing twice, nothing lost, sizes within one.
#[test]
fn processes_share_every_epoch() {
    let ids = records(Split::Train);
    for world in 1..=4_u32 {
        let mut epochs: Vec<Vec<TileId>> = vec![Vec::new(); 3];
        for rank in 0..world {
            let share = Share::of(rank, NonZero::new(world).expect("processes"));
            let share = share.expect("a rank");
            let mut loader = loader_of(LoaderOptions { share, ..options(2, PLENTY) }, 0);
            let mut sizes = [0; 3];
            loop {
                let (epoch, _) = loader.order().split(loader.cursor());
                let Some(of_epoch) = epochs.get_mut(epoch as usize) else { break };
                of_epoch.extend(next_ids(&mut loader, 1));
                sizes[epoch as usize] += 1;
            }
            let even = ids.len() / world as usize;
            assert!(sizes.iter().all(|size| (even..=even + 1).contains(size)), "{sizes:?}");
        }
        for mut epoch in epochs {
            epoch.sort_unstable();
            assert_eq!(epoch, ids, "{world} processes");
        }
    }
    let world = NonZero::new(ids.len() as u32 + 1).expect("processes");
    let share = Share::of(0, world).expect("a rank");
    let options = LoaderOptions { share, ..options(1, PLENTY) };
    let begun = Loader::new(&open(&DATASET), Split::Train, options, 0, |record, _| record.id);
    assert_says(&begun.expect_err("too many").to_string(), &["8 records", "9 processes"]);
}

/// Records of a block come together, each once an epoch, in an order of each epoch's own.
#[test]
fn blocks_are_shuffled_one_after_the_other() {
    let ids = records(Split::Train);
    let shards: BTreeMap<TileId, String> = open(&DATASET)
        .shards_of(Split::Train)
        .into_iter()
        .flat_map(|(shard, ids)| ids.into_iter().map(|id| (id, shard.file.clone())))
        .collect();
    let block = NonZero::new(2);
    let mut loader = loader_of(LoaderOptions { block, ..options(3, PLENTY) }, 0);
    let mut orders = BTreeSet::new();
    for _ in 0..6 {
        let epoch = next_ids(&mut loader, ids.len());
        let mut sorted = epoch.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, ids);
        // Two shards of two records each.
        for of_block in epoch.chunks(4) {
            let of_block: BTreeSet<&String> = of_block.iter().map(|id| &shards[id]).collect();
            assert!(of_block.len() <= 2, "{of_block:?}");
        }
        orders.insert(epoch);
    }
    assert_eq!(orders.len(), 6, "epochs are alike");
}

#[test]
fn a_split_that_fits_is_decoded_once() {
    let decoded = Arc::new(AtomicUsize::new(0));
    let ids = records(Split::Train);
    for (memory_bytes, keep, wanted) in
        [(PLENTY, true, ids.len()), (PLENTY, false, 5 * ids.len()), (1 << 20, true, 5 * ids.len())]
    {
        decoded.store(0, Ordering::SeqCst);
        let counter = Arc::clone(&decoded);
        let decode = move |record: Record, _: Grids| {
            counter.fetch_add(1, Ordering::SeqCst);
            Arc::new(record.id)
        };
        let options = LoaderOptions { keep, ..options(2, memory_bytes) };
        let dataset = open(&DATASET);
        let mut loader = Loader::new(&dataset, Split::Train, options, 0, decode).expect("begun");
        assert_eq!(loader.keeps(), wanted == ids.len());
        let expected = expected(Split::Train);
        for cursor in 0..5 * ids.len() as u64 {
            let item = loader.next().expect("endless").expect("sound");
            assert_eq!((item.cursor, *item.value), (cursor, expected(cursor)));
            assert_eq!(loader.cursor(), cursor + 1);
        }
        let window = if loader.keeps() { 0 } else { loader.window().get() };
        let decoded = decoded.load(Ordering::SeqCst);
        // Of the first epoch two threads may decode a record of the second one at the same time.
        let spare = if loader.keeps() { 2 } else { window };
        assert!((wanted..=wanted + spare).contains(&decoded), "{decoded} decoded, not {wanted}");
    }
}

/// Counts what is decoded and not yet dropped.
struct Live(Arc<AtomicUsize>);

impl Drop for Live {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

#[test]
fn memory_bounds_what_is_decoded_ahead() {
    // Arrays of 9 bytes a cell, once as they are and once in a record with its other fields.
    let record = 2 * 121 * 121 * 9 + (8 << 10);
    let thread = 1 << 20;
    for (memory, window) in [
        (0, 1),
        (thread + record - 20_000, 1),
        (thread + record, 1),
        (thread + 5 * record, 5),
        (3 * thread + 12 * record, 12),
        (2 * thread + 2 * record - 1, 5),
    ] {
        let (live, most) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
        let decode = {
            let (live, most) = (Arc::clone(&live), Arc::clone(&most));
            move |_: Record, _: Grids| {
                most.fetch_max(1 + live.fetch_add(1, Ordering::SeqCst), Ordering::SeqCst);
                Arc::new(Live(Arc::clone(&live)))
            }
        };
        let options = options(3, memory);
        let mut loader =
            Loader::new(&open(&DATASET), Split::Train, options, 0, decode).expect("begun");
        assert_eq!(loader.window().get(), window, "{memory} bytes");
        let begin = Instant::now();
        while most.load(Ordering::SeqCst) < window {
            assert!(begin.elapsed() < Duration::from_secs(20), "the window is never filled");
            std::thread::sleep(Duration::from_millis(5));
        }
        for _ in 0..20 {
            // The item is dropped before the next one is wanted.
            drop(loader.next().expect("endless").expect("sound"));
            std::thread::sleep(Duration::from_millis(2));
        }
        // One item is in the hand of the consumer until it is dropped.
        let most = most.load(Ordering::SeqCst);
        assert!((window..=window + 1).contains(&most), "{most} records, a window of {window}");
        drop(loader);
        assert_eq!(live.load(Ordering::SeqCst), 0, "nothing is left behind");
    }
}

#[test]
fn waiting_is_measured() {
    let slow = |_: Record, _: Grids| std::thread::sleep(Duration::from_millis(20));
    let dataset = open(&DATASET);
    let mut loader = Loader::new(&dataset, Split::Train, options(1, 0), 0, slow).expect("begun");
    assert_eq!(loader.waited(), Duration::ZERO);
    let begin = Instant::now();
    (&mut loader).take(5).for_each(|item| assert!(item.is_ok()));
    let waited = loader.waited();
    assert!(waited > Duration::from_millis(50) && waited <= begin.elapsed(), "{waited:?}");
}

// What goes wrong ------------------------------------------------------------------------

/// Flips a byte in the middle of the first frame of a shard.
fn damage_first_frame(shard: &Path) {
    let (_, table) = SeekTable::open(shard).expect("a shard");
    let mut bytes = read(shard);
    assert!(table.len() > 1, "another frame stays whole");
    bytes[1000] ^= 0x10;
    write(shard, bytes);
}

#[test]
fn a_damaged_record_is_an_error_in_its_place_and_the_others_come() {
    let (_dir, root, _) = copy_of(&DATASET);
    let dataset = open(&root);
    let mut shards = dataset.manifest().shards.iter().filter(|shard| shard.split == Split::Train);
    let (flipped, cut) = (shards.next().expect("a shard"), shards.next().expect("another"));
    damage_first_frame(&root.join(&flipped.file));
    let half = read(&root.join(&cut.file));
    write(&root.join(&cut.file), &half[..half.len() / 2]);
    let places: BTreeMap<TileId, (&str, u32)> = dataset
        .manifest()
        .records
        .iter()
        .map(|entry| (entry.id, (&*entry.shard, entry.frame)))
        .collect();

    let (ids, wanted) = (records(Split::Train), expected(Split::Train));
    for threads in [1, 4] {
        let dataset = open(&root);
        let loader = Loader::new(&dataset, Split::Train, options(threads, PLENTY), 0, seen);
        let mut failed = 0;
        for (cursor, item) in (0..).zip(loader.expect("begun").take(2 * ids.len())) {
            let id = wanted(cursor);
            let (shard, frame) = places[&id];
            let is_damaged = shard == cut.file || (shard == flipped.file && frame == 0);
            match item {
                Ok(item) => {
                    assert!(!is_damaged, "{shard}: damage unnoticed");
                    assert_eq!((item.cursor, item.value.0), (cursor, id));
                }
                Err(error) => {
                    assert!(is_damaged, "{shard} is whole, but: {error}");
                    let reason = if shard == cut.file { "seek table" } else { "frame 0" };
                    assert_says(&error.to_string(), &[shard, reason]);
                    failed += 1;
                }
            }
        }
        assert_eq!(failed, 2 * (1 + cut.records), "in two epochs");
    }
}

#[test]
fn damaged_records_are_left_out_in_quarantine() {
    let (_dir, root, _) = copy_of(&DATASET);
    let dataset = open(&root);
    let shards = dataset.shards_of(Split::Train);
    let ((flipped, of_flipped), (gone, of_gone)) = (&shards[0], &shards[1]);
    damage_first_frame(&root.join(&flipped.file));
    std::fs::remove_file(root.join(&gone.file)).expect("removed");
    let damaged: BTreeSet<TileId> = of_gone.iter().chain(&of_flipped[..1]).copied().collect();
    let expected: Vec<TileId> = {
        let wanted = expected(Split::Train);
        let epochs = 0..3 * records(Split::Train).len() as u64;
        epochs.map(wanted).filter(|id| !damaged.contains(id)).collect()
    };
    for threads in [1, 4] {
        let on_damage = OnDamage::Quarantine;
        let options = LoaderOptions { on_damage, ..options(threads, PLENTY) };
        let loader = Loader::new(&dataset, Split::Train, options, 0, |record, _| record.id);
        let mut loader = loader.expect("begun");
        assert_eq!(next_ids(&mut loader, expected.len()), expected);
        let quarantined = loader.quarantined();
        assert!(quarantined.keys().eq(&damaged), "{quarantined:?}");
        assert_says(&quarantined[&of_flipped[0]], &[&flipped.file, "frame 0"]);
        assert_says(&quarantined[&of_gone[0]], &[&gone.file, "No such file"]);
    }
}

/// A quarantine of everything is an error, not an endless search.
#[test]
fn a_split_without_a_sound_record_is_an_error() {
    let (_dir, root, _) = copy_of(&DATASET);
    let dataset = open(&root);
    for (shard, _) in dataset.shards_of(Split::Train) {
        write(&root.join(&shard.file), "no shard");
    }
    let on_damage = OnDamage::Quarantine;
    let options = LoaderOptions { on_damage, ..options(2, PLENTY) };
    let loader = Loader::new(&dataset, Split::Train, options, 0, |record, _| record.id);
    let mut loader = loader.expect("begun");
    for _ in 0..3 {
        let error = loader.next().expect("endless").expect_err("nothing is left");
        assert_says(&error.to_string(), &["train/shard-", "seek table"]);
    }
    assert_eq!(loader.quarantined().len(), records(Split::Train).len() - 1);
}

/// A manifest whose index would lose a record, or leads out of the directory, though its checksum fits.
#[test]
fn an_index_that_contradicts_itself_is_refused() {
    type Change = fn(&mut Value);
    let changes: [(&str, Change); 5] = [
        ("does not come after", |manifest| {
            manifest["records"][1]["id"] = manifest["records"][0]["id"].clone();
        }),
        ("is not there, or taken", |manifest| {
            let [shard, frame] = ["shard", "frame"].map(|key| manifest["records"][0][key].clone());
            manifest["records"][1]["shard"] = shard;
            manifest["records"][1]["frame"] = frame;
        }),
        ("is not there, or taken", |manifest| manifest["records"][0]["frame"] = json!(2)),
        ("its index 15", |manifest| manifest["shards"][0]["records"] = json!(4_000_000_000_u32)),
        ("does not lie in the dataset", |manifest| {
            manifest["shards"][0]["file"] = json!("../shard-00000.msgpack.zst");
        }),
    ];
    for (wanted, change) in changes {
        let (_dir, root, files) = copy_of(&DATASET);
        let mut manifest: Value = serde_json::from_slice(&files["manifest.json"]).expect("JSON");
        change(&mut manifest);
        let manifest = manifest.to_string();
        let sums = String::from_utf8(files["SHA256SUMS"].clone()).expect("text");
        let (old, new) = (sha256(&files["manifest.json"]), sha256(manifest.as_bytes()));
        write(&root.join("SHA256SUMS"), sums.replace(&old, &new));
        write(&root.join("manifest.json"), manifest);
        let error = Dataset::open(&root).expect_err("refused");
        assert_says(&error.to_string(), &["manifest.json", wanted]);
    }
}

#[test]
fn an_empty_split_is_refused() {
    let begun = Loader::new(&open(&DATASET), Split::Test, options(1, PLENTY), 0, seen);
    let error = begun.expect_err("the fixtures have no such split");
    assert!(matches!(error, LoaderError::Empty { split: Split::Test, .. }));
    assert_eq!(error.fault(), Fault::Input);
    assert_says(&error.to_string(), &["dataset", "split test", "train, val"]);
}

#[test]
fn a_panic_of_decode_reaches_the_consumer_in_its_place() {
    let (ids, wanted) = (records(Split::Train), expected(Split::Train));
    let unlucky = wanted(3);
    let decode = move |record: Record, _: Grids| {
        assert!(record.id != unlucky, "cannot stand {unlucky}");
        record.id
    };
    let options = options(2, PLENTY);
    let mut loader = Loader::new(&open(&DATASET), Split::Train, options, 0, decode).expect("begun");
    let mut panics = 0;
    for cursor in 0..2 * ids.len() as u64 {
        let expected = wanted(cursor);
        match catch_unwind(AssertUnwindSafe(|| loader.next())) {
            Ok(item) => assert_eq!(item.expect("endless").expect("sound").value, expected),
            Err(panic) => {
                assert_eq!(expected, unlucky);
                let message = panic.downcast_ref::<String>().expect("a message");
                assert_says(message, &["cannot stand", &unlucky.to_string()]);
                panics += 1;
            }
        }
        assert_eq!(loader.cursor(), cursor + 1);
    }
    assert_eq!(panics, 2, "in two epochs");
}

#[test]
fn a_loader_that_is_dropped_ends_at_once() {
    let (done, ended) = mpsc::channel();
    std::thread::spawn(move || {
        for (threads, memory, count) in
            [(1, 0, 0), (8, 0, 1), (2, 1 << 20, 0), (8, 3 << 20, 5), (8, PLENTY, 3)]
        {
            let mut loader = train(threads, memory, 0);
            take(&mut loader, count);
            // By now the workers with little memory are blocked.
            std::thread::sleep(Duration::from_millis(30));
            drop(loader);
        }
        done.send(()).expect("the test waits");
    });
    ended.recv_timeout(Duration::from_secs(60)).expect("no loader hangs");
}
