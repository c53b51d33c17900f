//! Records for training: decoded ahead of their use by other threads, in a shuffled order that
//! only a seed decides.
//!
//! [`Order`] says which record stands at a cursor. Workers claim cursors in turn and decode;
//! a queue puts their results back into order and keeps them from running ahead too far. So
//! neither the number of threads nor an interruption changes what comes next.

mod ahead;
mod error;
mod kept;
mod options;
mod order;
mod queue;
mod shards;
mod work;

use std::collections::BTreeMap;
use std::num::NonZero;
use std::panic::resume_unwind;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

pub use self::error::LoaderError;
use self::kept::Kept;
pub use self::options::{LoaderOptions, Share};
pub use self::order::{Epoch, Order};
use self::queue::Queue;
pub use self::work::Loaded;
use self::work::{DecodePlan, Delivery, Unreadable, Worker};
use super::error::ReadError;
use super::grids::Grids;
use super::read::Dataset;
use super::record::Record;
use super::statistics::reliability_of;
use crate::config::{OnDamage, Split};
use crate::grid::TileId;

/// Most shards that the workers of a loader keep open together; each keeps at least one.
const OPEN_SHARDS: usize = 256;
/// Bytes of a cell in [`Grids`]: two float32 and one uint8.
const CELL_BYTES: usize = 4 + 4 + 1;
/// Two float32 more where there are errors.
const ERROR_BYTES: usize = 4 + 4;
const TWO: NonZero<usize> = NonZero::new(2).expect("not zero");
/// Bytes of a record besides its arrays, generously.
const OTHER_BYTES: usize = 8 << 10;
/// Bytes that a thread needs besides records: Zstandard's tables, a packed record, seek tables, and what
/// the allocator holds ready for it. Measured, see `benches/RESULTS.md`.
const THREAD_BYTES: usize = 1 << 20;

/// An endless iterator over the records of a split, epoch after epoch, in the order of
/// [`Order`].
///
/// A record that cannot be read is an error in its place, or left out ([`OnDamage`]); the next one
/// follows. Dropping the loader ends its threads and downloads; at most the record that each of them
/// has begun is awaited.
#[derive(Debug)]
pub struct Loader<T> {
    plan: Arc<DecodePlan>,
    /// The epoch of the next item.
    epoch: Epoch,
    /// The next cursor.
    cursor: u64,
    queue: Arc<Queue<Delivery<T>>>,
    workers: Vec<JoinHandle<()>>,
    kept: Option<Arc<Kept<T>>>,
    on_damage: OnDamage,
    quarantined: BTreeMap<TileId, String>,
    waited: Duration,
}

impl<T: Clone + Send + Sync + 'static> Loader<T> {
    /// Begins to load a split from a cursor on, 0 or the [`Loader::cursor`] of a loader that
    /// this one continues. `decode` makes of a record and its checked arrays, `[n, n]`, what the
    /// iterator yields; it runs on several threads at once. If it panics, so does
    /// [`Iterator::next`] in that record's place. A kept record is cloned for each epoch: let it
    /// be an `Arc` of something.
    ///
    /// # Errors
    /// [`LoaderError`] if there are no records for this process, or no thread can be started.
    /// Damaged shards are errors of their records.
    pub fn new(
        dataset: &Arc<Dataset>,
        split: Split,
        options: LoaderOptions,
        cursor: u64,
        decode: impl Fn(Record, Grids) -> T + Send + Sync + 'static,
    ) -> Result<Self, LoaderError> {
        let plan = Arc::new(DecodePlan::new(dataset, split, &options)?);
        let mut open_shards = OPEN_SHARDS;
        if let Some(limit) = dataset.cache_bytes() {
            let shards = dataset.shards_of(split);
            let sizes = shards.iter().map(|(shard, _)| shard.digest.bytes);
            // While one block is read, the next one comes.
            let shards_at_hand = options.block.map(|block| block.saturating_mul(TWO));
            let (shards, bytes) = together(sizes, shards_at_hand);
            if bytes > limit {
                return Err(LoaderError::CacheTooSmall { split, shards, bytes, limit });
            }
            // What is open stays on the disk when it is evicted.
            open_shards = open_shards.min(shards);
        }
        let cells = dataset.manifest().cells as usize;
        let has_errors = reliability_of(dataset.manifest()).is_some();
        let cell_bytes = CELL_BYTES + if has_errors { ERROR_BYTES } else { 0 };
        let record = cells.saturating_mul(cells).saturating_mul(2 * cell_bytes) + OTHER_BYTES;
        let affordable = options.memory_bytes / (THREAD_BYTES + record);
        let threads = options.threads.get().min(affordable.max(1));
        let fitting = options.memory_bytes.saturating_sub(threads * THREAD_BYTES) / record;
        let all = plan.ids.len();
        // What is kept needs a place; so does what the threads have in hand.
        let keeps = options.keep && fitting >= all + threads;
        let kept = keeps.then(|| Arc::new(Kept::new(all)));
        let window = NonZero::new(if keeps { fitting - all } else { fitting });
        let window = window.unwrap_or(NonZero::<usize>::MIN);
        let cursor = options.share.first(cursor);
        let queue = Arc::new(Queue::new(window));
        let (epoch, on_damage) = (plan.order.epoch(plan.order.split(cursor).0), options.on_damage);
        // From here on the loader's end stops the workers, also when one of them cannot start.
        let mut loader = Self {
            plan,
            epoch,
            cursor,
            queue,
            workers: Vec::new(),
            kept,
            on_damage,
            quarantined: BTreeMap::new(),
            waited: Duration::ZERO,
        };
        let decode = Arc::new(decode);
        for _ in 0..threads {
            let open = open_shards / threads;
            let plan = Arc::clone(&loader.plan);
            let worker = Worker::new(dataset, plan, cursor, open, &decode, loader.kept.as_ref());
            let queue = Arc::clone(&loader.queue);
            let thread =
                Builder::new().name("loader".to_owned()).spawn(move || worker.work(&queue));
            loader.workers.push(thread.map_err(LoaderError::Thread)?);
        }
        if dataset.cache_bytes().is_some() {
            let (dataset, plan) = (Arc::clone(dataset), Arc::clone(&loader.plan));
            let queue = Arc::clone(&loader.queue);
            let download = move || ahead::download(&dataset, split, &plan, cursor, &queue);
            let thread = Builder::new().name("download".to_owned()).spawn(download);
            loader.workers.push(thread.map_err(LoaderError::Thread)?);
        }
        Ok(loader)
    }

    /// The next item of the share, damaged or not.
    fn step(&mut self) -> Delivery<T> {
        let cursor = self.cursor;
        self.cursor = self.plan.share.after(cursor, 1);
        if self.kept.as_ref().is_some_and(|kept| kept.is_full()) {
            self.dismiss();
            let number = self.plan.number(cursor, &mut self.epoch);
            let kept = self.kept.as_ref().and_then(|kept| kept.get(number as usize));
            return Ok(Ok(Loaded { cursor, number, value: kept.expect("all records are kept") }));
        }
        let (outcome, waited) = self.queue.take();
        self.waited += waited;
        outcome
    }
}

impl<T> Loader<T> {
    /// The cursor of the next item. A loader that begins here, with the same dataset, split, seed
    /// and block, continues exactly. Where each of several processes has taken as many items, the
    /// smallest of their cursors continues all of them, whatever number of processes goes on.
    #[must_use]
    pub fn cursor(&self) -> u64 {
        self.cursor
    }

    /// The records of the split by number: in the order of [`Dataset::ids`].
    #[must_use]
    pub fn ids(&self) -> &[TileId] {
        &self.plan.ids
    }

    /// The order in which records come.
    #[must_use]
    pub fn order(&self) -> &Order {
        &self.plan.order
    }

    /// Most records that are being decoded or wait to be taken.
    #[must_use]
    pub fn window(&self) -> NonZero<usize> {
        self.queue.window()
    }

    /// Whether decoded records are kept from epoch to epoch.
    #[must_use]
    pub fn keeps(&self) -> bool {
        self.kept.is_some()
    }

    /// The records that were left out so far, each with what is wrong with it.
    #[must_use]
    pub fn quarantined(&self) -> &BTreeMap<TileId, String> {
        &self.quarantined
    }

    /// The time that [`Iterator::next`] has waited for records, all together.
    #[must_use]
    pub fn waited(&self) -> Duration {
        self.waited
    }

    /// Ends the workers.
    fn dismiss(&mut self) {
        if self.workers.is_empty() {
            return;
        }
        self.queue.stop();
        for worker in self.workers.drain(..) {
            // A worker carries panics to the consumer and has none of its own.
            let _ = worker.join();
        }
    }
}

impl<T: Clone + Send + Sync + 'static> Iterator for Loader<T> {
    type Item = Result<Loaded<T>, ReadError>;

    /// The next record; never `None`. If every record of the split is damaged, that of the last
    /// one is an error also in quarantine.
    fn next(&mut self) -> Option<Self::Item> {
        loop {
            match self.step() {
                Err(panic) => resume_unwind(panic),
                Ok(Ok(loaded)) => return Some(Ok(loaded)),
                Ok(Err(unreadable)) => {
                    let Unreadable { id, error } = *unreadable;
                    let others = self.plan.ids.len() - 1;
                    let known = self.quarantined.contains_key(&id);
                    let is_damage = error.is_damage();
                    let leaves_some = known || self.quarantined.len() < others;
                    if self.on_damage == OnDamage::Error || !is_damage || !leaves_some {
                        return Some(Err(error));
                    }
                    self.quarantined.insert(id, error.to_string());
                }
            }
        }
    }
}

/// How many shards of a split may be shuffled together, and the bytes of the largest so many.
fn together(sizes: impl Iterator<Item = u64>, block: Option<NonZero<usize>>) -> (usize, u64) {
    let mut sizes: Vec<u64> = sizes.collect();
    sizes.sort_unstable_by(|a, b| b.cmp(a));
    let shards = block.map_or(sizes.len(), |block| block.get().min(sizes.len()));
    (shards, sizes[..shards].iter().fold(0, |sum, &size| sum.saturating_add(size)))
}

impl<T> Drop for Loader<T> {
    fn drop(&mut self) {
        self.dismiss();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_shards_of_a_block_count() {
        let sizes = || [5, 9, u64::MAX, 7].into_iter();
        assert_eq!(together(sizes().take(2), None), (2, 14));
        assert_eq!(together(sizes(), NonZero::new(1)), (1, u64::MAX));
        assert_eq!(together(sizes(), NonZero::new(9)), (4, u64::MAX));
        assert_eq!(together([5, 9, 7].into_iter(), NonZero::new(2)), (2, 16));
    }
}
