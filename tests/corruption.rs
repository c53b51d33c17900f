//! A thousand single bytes of a dataset changed, one at a time: `verify` finds each, and the loader
//! gives an error or the very arrays that were written, never others.
#![allow(clippy::panic, reason = "helpers of tests fail by panicking")]

mod pipeline;

use std::collections::BTreeMap;
use std::num::NonZero;
use std::path::Path;
use std::sync::Arc;

use holescout::config::{OnDamage, Split};
use holescout::dataset::{Dataset, Grids, Loader, LoaderOptions, Record};
use holescout::grid::TileId;
use holescout::progress::Silent;
use holescout::verify::verify;

use pipeline::{HELSINKI, Random, copy_of, write};

const CORRUPTIONS: usize = 1000;

type Records = BTreeMap<TileId, (Record, Grids)>;

/// What the loader gives of a dataset in one epoch of each split, and how many records it does not
/// give; `None` if the dataset cannot be opened.
fn loaded(root: &Path, on_damage: OnDamage) -> Option<(Records, usize)> {
    let dataset = Arc::new(Dataset::open(root).ok()?);
    let (mut records, mut failed) = (Records::new(), 0);
    for split in [Split::Train, Split::Val] {
        let threads = NonZero::<usize>::MIN;
        let options = LoaderOptions { threads, on_damage, keep: false, ..LoaderOptions::new(3) };
        let decode = |record, grids| (record, grids);
        let mut loader = Loader::new(&dataset, split, options, 0, decode).expect("begun");
        let epoch = loader.ids().len() as u64;
        while loader.cursor() < epoch {
            match loader.next().expect("endless") {
                Ok(item) => drop(records.insert(item.value.0.id, item.value)),
                Err(_) => failed += 1,
            }
        }
        failed += loader.quarantined().len();
    }
    Some((records, failed))
}

fn is_shard(name: &str) -> bool {
    name.contains("/shard-")
}

#[test]
fn no_changed_byte_goes_unnoticed_or_gives_another_array() {
    let (_dir, root, files) = copy_of(&HELSINKI.dataset);
    let (whole, failed) = loaded(&root, OnDamage::Error).expect("opened");
    assert_eq!((whole.len(), failed), (15, 0));
    let names: Vec<&String> = files.keys().collect();
    let mut random = Random(61);
    let (mut unopened, mut unread, mut unharmed) = (0, 0, 0);
    for corruption in 0..CORRUPTIONS {
        // Two thirds hit shards, else any file.
        let shards: Vec<&String> = names.iter().filter(|name| is_shard(name)).copied().collect();
        let among = if corruption % 3 == 0 { &names } else { &shards };
        let name = among[random.below(among.len())];
        let bytes = &files[name];
        let (at, mask) = (random.below(bytes.len()), 1 + random.below(255) as u8);
        let mut damaged = bytes.clone();
        damaged[at] ^= mask;
        write(&root.join(name), damaged);
        let what = format!("byte {at} of {name} ^ {mask:#x}");

        let found = verify(&root, &Silent).map(|verification| verification.failures);
        let noticed = found.as_ref().map_or(true, |failures| !failures.is_empty());
        assert!(noticed, "{what}: verify notices nothing");

        let on_damage = [OnDamage::Error, OnDamage::Quarantine][corruption % 2];
        match loaded(&root, on_damage) {
            None => unopened += 1,
            Some((records, failed)) => {
                for (id, record) in &records {
                    assert!(whole[id] == *record, "{what}: another record {id}");
                }
                // In quarantine a split without a sound record may repeat its error.
                assert!(records.len() + failed >= whole.len(), "{what}: records are lost");
                if failed > 0 { unread += 1 } else { unharmed += 1 }
            }
        }
        if name == "manifest.json" {
            assert!(loaded(&root, OnDamage::Error).is_none(), "{what}: the loader begins");
        }
        write(&root.join(name), bytes);
    }
    assert!(unopened > 50 && unread > 500, "{unopened} unopened, {unread} unread");
    assert!(unharmed < CORRUPTIONS / 3, "{unharmed} of {CORRUPTIONS} read without an error");
}
