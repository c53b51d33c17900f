//! Records for training: decoded ahead of their use by other threads, in a shuffled order that
//! only a seed decides.
//!
//! [`Order`] says which record stands at a cursor. Workers claim cursors in turn and decode;
//! a queue puts their results back into order and keeps them from running ahead too far. So
//! neither the number of threads nor an interruption changes what comes next.

mod order;
mod queue;
mod shards;

use std::num::NonZero;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::PathBuf;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

pub use self::order::Order;
use self::queue::Queue;
use self::shards::OpenShards;
use super::read::{Dataset, ReadError};
use super::record::{Grids, Record};
use crate::config::Split;
use crate::error::{Fault, HasFault};
use crate::grid::TileId;

/// Most shards that the workers of a loader keep open together; each keeps at least one.
const OPEN_SHARDS: usize = 256;
/// Bytes of a cell in [`Grids`]: two float32 and one uint8.
const CELL_BYTES: usize = 4 + 4 + 1;

/// Why a loader cannot begin.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoaderError {
    /// Nothing to load.
    #[error("{}: no records in split {split}; records are in: {}", root.display(), names(found))]
    Empty {
        /// The dataset.
        root: PathBuf,
        /// The split that was asked for.
        split: Split,
        /// The splits that have records.
        found: Vec<Split>,
    },
    /// The operating system gave no thread.
    #[error("cannot start a thread that decodes records: {0}; try fewer threads")]
    Thread(std::io::Error),
}

fn names(splits: &[Split]) -> String {
    let names: Vec<&str> = splits.iter().map(|split| split.name()).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

impl HasFault for LoaderError {
    fn fault(&self) -> Fault {
        match self {
            Self::Empty { .. } => Fault::Input,
            Self::Thread(_) => Fault::Running,
        }
    }
}

/// How records are loaded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LoaderOptions {
    /// Decides the order together with the number of records, see [`Order`].
    pub seed: u64,
    /// Most threads that decode; no effect on what is loaded.
    pub threads: NonZero<usize>,
    /// Memory for records that are being decoded or wait to be taken, in bytes. Each is taken to
    /// need as much as its arrays and its frame; one is always allowed. No effect on what is
    /// loaded.
    pub memory_bytes: usize,
}

/// What was made of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Loaded<T> {
    /// The cursor that it was loaded for.
    pub cursor: u64,
    /// The record's place in [`Loader::ids`].
    pub number: u32,
    /// What `decode` returned.
    pub value: T,
}

/// What a worker hands over; a panic is carried to the consumer.
type Outcome<T> = std::thread::Result<Result<Loaded<T>, ReadError>>;

/// An endless iterator over the records of a split, epoch after epoch, in the order of
/// [`Order`].
///
/// A record that cannot be read is an error in its place; the next one follows. Dropping the
/// loader ends its threads; at most the record that each of them has begun is awaited.
#[derive(Debug)]
pub struct Loader<T> {
    ids: Arc<[TileId]>,
    queue: Arc<Queue<Outcome<T>>>,
    workers: Vec<JoinHandle<()>>,
    waited: Duration,
}

impl<T: Send + 'static> Loader<T> {
    /// Begins to load a split from a cursor on, 0 or the [`Loader::cursor`] of a loader that
    /// this one continues. `decode` makes of a record and its checked arrays, `[n, n]`, what the
    /// iterator yields; it runs on several threads at once. If it panics, so does
    /// [`Iterator::next`] in that record's place.
    ///
    /// # Errors
    /// [`LoaderError`] if the split has no records or no thread can be started. Damaged shards
    /// are errors of their records.
    pub fn new(
        dataset: &Arc<Dataset>,
        split: Split,
        options: LoaderOptions,
        cursor: u64,
        decode: impl Fn(Record, Grids) -> T + Send + Sync + 'static,
    ) -> Result<Self, LoaderError> {
        let ids = ids_of(dataset, split)?;
        let records = u32::try_from(ids.len()).ok().and_then(NonZero::new);
        let records = records.expect("a manifest that fits in memory has fewer than 2^32 records");
        let order = Order::new(options.seed, records);
        let window = NonZero::new(options.memory_bytes / record_bytes(dataset, split));
        let window = window.unwrap_or(NonZero::<usize>::MIN);
        let threads = options.threads.min(window);
        let queue = Arc::new(Queue::new(cursor, window));
        // From here on the loader's end stops the workers, also when one of them cannot start.
        let mut loader = Self { ids, queue, workers: Vec::new(), waited: Duration::ZERO };
        let decode = Arc::new(decode);
        for _ in 0..threads.get() {
            let (queue, ids) = (Arc::clone(&loader.queue), Arc::clone(&loader.ids));
            let decode = Arc::clone(&decode);
            let mut shards = OpenShards::new(Arc::clone(dataset), OPEN_SHARDS / threads);
            let load = move |cursor| {
                let (_, number) = order.at(cursor);
                let (record, grids) = shards.read(ids[number as usize])?;
                Ok(Loaded { cursor, number, value: decode(record, grids) })
            };
            let worker = Builder::new().name("loader".to_owned()).spawn(move || work(&queue, load));
            loader.workers.push(worker.map_err(LoaderError::Thread)?);
        }
        Ok(loader)
    }
}

impl<T> Loader<T> {
    /// The cursor of the next item. A loader that begins here, with the same dataset, split and
    /// seed, continues exactly.
    #[must_use]
    pub fn cursor(&self) -> u64 {
        self.queue.wanted()
    }

    /// The records of the split by number: in the order of [`Dataset::ids`].
    #[must_use]
    pub fn ids(&self) -> &[TileId] {
        &self.ids
    }

    /// Most records that are being decoded or wait to be taken.
    #[must_use]
    pub fn window(&self) -> NonZero<usize> {
        self.queue.window()
    }

    /// The time that [`Iterator::next`] has waited for records, all together.
    #[must_use]
    pub fn waited(&self) -> Duration {
        self.waited
    }
}

impl<T> Iterator for Loader<T> {
    type Item = Result<Loaded<T>, ReadError>;

    /// The next record; never `None`.
    fn next(&mut self) -> Option<Self::Item> {
        let (outcome, waited) = self.queue.take();
        self.waited += waited;
        Some(outcome.unwrap_or_else(|panic| resume_unwind(panic)))
    }
}

impl<T> Drop for Loader<T> {
    fn drop(&mut self) {
        self.queue.stop();
        for worker in self.workers.drain(..) {
            // A worker carries panics to the consumer and has none of its own.
            let _ = worker.join();
        }
    }
}

/// The records of a split, in the order of [`Dataset::ids`].
fn ids_of(dataset: &Dataset, split: Split) -> Result<Arc<[TileId]>, LoaderError> {
    let ids: Arc<[TileId]> = dataset.ids_of(split).into();
    if ids.is_empty() {
        let has_records = |split: &Split| !dataset.ids_of(*split).is_empty();
        let found = Split::ALL.into_iter().filter(has_records).collect();
        return Err(LoaderError::Empty { root: dataset.root().to_owned(), split, found });
    }
    Ok(ids)
}

/// About what a record of a split needs in memory, in bytes: its arrays and the largest frame.
fn record_bytes(dataset: &Dataset, split: Split) -> usize {
    let manifest = dataset.manifest();
    let shards = manifest.shards.iter().filter(|shard| shard.split == split);
    // A shard that cannot be opened is the error of its records.
    let opened = shards.filter_map(|shard| dataset.open_shard(&shard.file).ok());
    let frame = opened.map(|shard| shard.largest_frame()).max().unwrap_or(0);
    let cells = manifest.cells as usize;
    cells.saturating_mul(cells).saturating_mul(CELL_BYTES).saturating_add(frame).max(1)
}

/// Loads one cursor after the other until the queue is stopped.
fn work<T>(queue: &Queue<Outcome<T>>, mut load: impl FnMut(u64) -> Result<Loaded<T>, ReadError>) {
    while let Some(cursor) = queue.claim() {
        queue.put(cursor, catch_unwind(AssertUnwindSafe(|| load(cursor))));
    }
}
