//! The pool of maps that training takes place on: all of a split, or a part that changes.

mod pipeline;

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use holescout::config::{OnDamage, RlConfig, Split};
use holescout::dataset::Dataset;
use holescout::rl::{MapPool, MapSource, World, load_sample, load_split};

use pipeline::{HELSINKI, assert_says, copy_of, read, write};

const HELD: usize = 3;

fn open(root: &Path) -> Arc<Dataset> {
    Arc::new(Dataset::open(root).expect("opened"))
}

fn dataset() -> Arc<Dataset> {
    open(&HELSINKI.dataset)
}

fn source(dataset: &Arc<Dataset>, maps: usize, seed: u64) -> MapSource {
    let bytes = maps * World::bytes(dataset.manifest().cells as usize);
    MapSource::split(dataset, Split::Train, &RlConfig::default(), bytes, seed)
}

fn pool(dataset: &Arc<Dataset>, maps: usize, seed: u64) -> MapPool {
    source(dataset, maps, seed).fill().expect("a pool")
}

fn numbers(pool: &MapPool) -> Vec<u32> {
    pool.maps().all().iter().map(|&(number, _)| number).collect()
}

#[test]
fn a_split_that_fits_is_held_in_the_order_of_its_names() {
    let dataset = dataset();
    let all = load_split(&dataset, Split::Train, &RlConfig::default()).expect("loaded");
    assert!(all.len() > HELD);
    let mut pool = pool(&dataset, all.len(), 0);
    assert!(!pool.is_streamed());
    for (number, map) in pool.maps().all() {
        assert_eq!(map.id(), all[*number as usize].id());
    }
    assert_eq!(pool.refresh().expect("nothing to read"), None);
    let restored = source(&dataset, all.len(), 0).restore(&pool.state()).expect("read");
    assert_eq!(restored.map(|pool| numbers(&pool)), Some(numbers(&pool)));
}

#[test]
fn a_part_of_a_split_changes_until_all_maps_were_there() {
    let dataset = dataset();
    let all = load_split(&dataset, Split::Train, &RlConfig::default()).expect("loaded");
    let mut pool = pool(&dataset, HELD, 0);
    assert!(pool.is_streamed());
    let mut seen: BTreeSet<u32> = numbers(&pool).into_iter().collect();
    assert_eq!(seen.len(), HELD);
    for refreshed in 0..3 * all.len() {
        let before = numbers(&pool);
        let [gone, by] = pool.refresh().expect("read").expect("another map");
        assert_eq!(gone, before[refreshed % HELD], "the one that is there for longest");
        assert!(!before.contains(&by), "one that was not there");
        assert_eq!(pool.maps().place(by), refreshed % HELD);
        assert_eq!(pool.maps().get(by).id(), all[by as usize].id());
        seen.insert(by);
    }
    let usable = all.iter().filter(|map| map.can_teach()).count();
    assert_eq!(seen.len(), usable);
}

#[test]
fn a_restored_pool_goes_on_as_the_saved_one() {
    let dataset = dataset();
    let mut saved = pool(&dataset, HELD, 1);
    for _ in 0..4 {
        saved.refresh().expect("read");
    }
    let state = saved.state();
    assert_ne!(numbers(&pool(&dataset, HELD, 1)), numbers(&saved));
    let restored = |held| source(&dataset, held, 1).restore(&state).expect("read");
    assert!(restored(HELD + 1).is_none(), "of another size");
    let mut restored = restored(HELD).expect("the same size");
    for _ in 0..10 {
        assert_eq!(numbers(&restored), numbers(&saved));
        assert_eq!(restored.refresh().expect("read"), saved.refresh().expect("read"));
    }
}

/// A pool of the whole split and one of a part leave out the same, and say so.
#[test]
fn damaged_maps_are_left_out_on_request_and_named() {
    let (_dir, root, _) = copy_of(&HELSINKI.dataset);
    let sound = open(&root);
    let all = load_split(&sound, Split::Train, &RlConfig::default()).expect("loaded");
    let (shard, ids) = &sound.shards_of(Split::Train)[0];
    let mut bytes = read(&root.join(&shard.file));
    bytes[1000] ^= 0x10;
    write(&root.join(&shard.file), bytes);

    let dataset = open(&root);
    let number = all.iter().position(|map| map.id() == ids[0]).expect("in the split") as u32;
    for held in [all.len(), HELD] {
        let error = source(&dataset, held, 0).fill().map(|mut pool| {
            (0..all.len()).find_map(|_| pool.refresh().err()).expect("found in the first epoch")
        });
        let (Ok(error) | Err(error)) = error;
        assert_says(&error.to_string(), &[&shard.file, "frame 0"]);

        let source = || source(&dataset, held, 0).on_damage(OnDamage::Quarantine);
        let mut pool = source().fill().expect("the others");
        for _ in 0..2 * all.len() {
            assert!(!numbers(&pool).contains(&number));
            pool.refresh().expect("the others");
        }
        assert_eq!(pool.quarantined().keys().collect::<Vec<_>>(), [&ids[0]], "{held} held");
        assert_says(&pool.quarantined()[&ids[0]], &[&shard.file, "frame 0"]);
        let restored = source().restore(&pool.state()).expect("read").expect("the same");
        assert_eq!(numbers(&restored), numbers(&pool));
    }

    for (shard, _) in dataset.shards_of(Split::Train) {
        write(&root.join(&shard.file), "no shard");
    }
    for held in [all.len(), HELD] {
        let error = source(&open(&root), held, 0).on_damage(OnDamage::Quarantine).fill();
        assert_says(&error.expect_err("nothing is left").to_string(), &["train/shard-"]);
    }
}

#[test]
fn samples_are_the_same_each_time_and_empty_splits_are_refused() {
    let (dataset, config) = (dataset(), RlConfig::default());
    let sample = |count, seed| {
        let maps = load_sample(&dataset, Split::Train, &config, count, seed).expect("loaded");
        maps.iter().map(|map| map.id()).collect::<Vec<_>>()
    };
    assert_eq!(sample(3, 0), sample(3, 0));
    assert!(sample(3, 0).is_sorted());
    assert!((1..9).any(|seed| sample(3, seed) != sample(3, 0)));
    let all = load_split(&dataset, Split::Train, &config).expect("loaded");
    assert_eq!(sample(1000, 5), all.iter().map(|map| map.id()).collect::<Vec<_>>());
    let empty = load_sample(&dataset, Split::Test, &config, 3, 0).expect_err("no test split");
    assert_says(&empty.to_string(), &["test split", "no records"]);
}
