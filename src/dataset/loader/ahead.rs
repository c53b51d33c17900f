//! Shards on a server, downloaded before their records are wanted.

use std::sync::Arc;

use super::queue::Queue;
use super::work::DecodePlan;
use crate::config::Split;
use crate::dataset::read::Dataset;

/// Downloads the shards of one block after the other, from that of a cursor on, and stays at most
/// one block ahead. Failures are left to those who want the records.
pub(super) fn download<R>(
    dataset: &Dataset,
    split: Split,
    plan: &Arc<DecodePlan>,
    first: u64,
    queue: &Queue<R>,
) {
    let mut begin = 0;
    let shards: Vec<(u32, &str)> = dataset
        .shards_of(split)
        .into_iter()
        .map(|(shard, _)| {
            begin += shard.records;
            (begin - shard.records, &*shard.file)
        })
        .collect();
    let (mut number, mut place) = plan.order.split(first);
    let records = u64::from(plan.order.records().get());
    loop {
        let epoch = plan.order.epoch(number);
        for (begins, stretches) in epoch.blocks(place) {
            let inside = |begin: u32| {
                stretches.iter().any(|&(from, size)| begin >= from && begin - from < size)
            };
            for (_, file) in shards.iter().filter(|(begin, _)| inside(*begin)) {
                let _ = dataset.open_shard(file, &|| !queue.is_stopped());
                if queue.is_stopped() {
                    return;
                }
            }
            let cursor = number.wrapping_mul(records).wrapping_add(begins.into());
            if !queue.wait_for(plan.share.items(first, cursor)) {
                return;
            }
        }
        (number, place) = (number.wrapping_add(1), 0);
    }
}
