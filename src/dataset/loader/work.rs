//! What a loader's threads do.

use std::collections::BTreeMap;
use std::num::NonZero;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use super::error::LoaderError;
use super::kept::Kept;
use super::options::{LoaderOptions, Share};
use super::order::{Epoch, Order};
use super::queue::Queue;
use super::shards::OpenShards;
use crate::config::Split;
use crate::dataset::error::ReadError;
use crate::dataset::grids::Grids;
use crate::dataset::read::Dataset;
use crate::dataset::record::Record;
use crate::grid::TileId;

/// What was made of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Loaded<T> {
    /// The cursor that it was loaded for.
    pub cursor: u64,
    /// The record's place in [`Loader::ids`](super::Loader::ids).
    pub number: u32,
    /// What `decode` returned.
    pub value: T,
}

/// What a worker hands over; a panic is carried to the consumer.
pub(super) type Delivery<T> = std::thread::Result<Result<Loaded<T>, Box<Unreadable>>>;

/// A record that could not be read.
#[derive(Debug)]
pub(super) struct Unreadable {
    pub(super) id: TileId,
    pub(super) error: ReadError,
}

/// Which record comes when.
#[derive(Debug)]
pub(super) struct DecodePlan {
    pub(super) order: Order,
    pub(super) share: Share,
    /// The records of the split, by name.
    pub(super) ids: Vec<TileId>,
    /// The order's numbers, shard after shard, as places in `ids`.
    numbers: Vec<u32>,
}

impl DecodePlan {
    pub(super) fn new(
        dataset: &Dataset,
        split: Split,
        options: &LoaderOptions,
    ) -> Result<Self, LoaderError> {
        let ids = dataset.ids_of(split);
        let by_shard = dataset.shards_of(split);
        let sizes: Vec<_> =
            by_shard.iter().filter_map(|(_, ids)| NonZero::new(ids.len() as u32)).collect();
        let block = options.block.unwrap_or(NonZero::<usize>::MAX);
        let Some(order) = Order::of_blocks(options.seed, &sizes, block) else {
            let has_records = |split: &Split| !dataset.ids_of(*split).is_empty();
            let found = Split::ALL.into_iter().filter(has_records).collect();
            return Err(LoaderError::Empty { root: dataset.root().to_owned(), split, found });
        };
        let (records, world) = (order.records(), options.share.world());
        if world > records {
            let (records, world) = (records.get(), world.get());
            return Err(LoaderError::TooManyProcesses { split, records, world });
        }
        let places: BTreeMap<TileId, u32> = ids.iter().copied().zip(0..).collect();
        let numbers = by_shard.iter().flat_map(|(_, ids)| ids).map(|id| places[id]).collect();
        Ok(Self { order, share: options.share, ids, numbers })
    }

    /// The record at a cursor. `epoch` is the last one that was asked for, and becomes that of the
    /// cursor.
    pub(super) fn number(&self, cursor: u64, epoch: &mut Epoch) -> u32 {
        let (number, place) = self.order.split(cursor);
        if epoch.number() != number {
            *epoch = self.order.epoch(number);
        }
        self.numbers[epoch.at(place) as usize]
    }
}

/// One thread's part.
pub(super) struct Worker<T, D> {
    plan: Arc<DecodePlan>,
    epoch: Epoch,
    /// The cursor of the loader's first item.
    first: u64,
    shards: OpenShards,
    decode: Arc<D>,
    kept: Option<Arc<Kept<T>>>,
}

impl<T: Clone, D: Fn(Record, Grids) -> T> Worker<T, D> {
    pub(super) fn new(
        dataset: &Arc<Dataset>,
        plan: Arc<DecodePlan>,
        first: u64,
        open_shards: usize,
        decode: &Arc<D>,
        kept: Option<&Arc<Kept<T>>>,
    ) -> Self {
        let epoch = plan.order.epoch(plan.order.split(first).0);
        let shards = OpenShards::new(Arc::clone(dataset), open_shards);
        Self { plan, epoch, first, shards, decode: Arc::clone(decode), kept: kept.cloned() }
    }

    /// Loads one record after the other until the queue is stopped.
    pub(super) fn work(mut self, queue: &Queue<Delivery<T>>) {
        while let Some(item) = queue.claim() {
            let cursor = self.plan.share.after(self.first, item);
            queue.put(
                item,
                catch_unwind(AssertUnwindSafe(|| self.load(cursor, &|| !queue.is_stopped()))),
            );
        }
    }

    fn load(
        &mut self,
        cursor: u64,
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<Loaded<T>, Box<Unreadable>> {
        let number = self.plan.number(cursor, &mut self.epoch);
        let place = number as usize;
        if let Some(value) = self.kept.as_ref().and_then(|kept| kept.get(place)) {
            return Ok(Loaded { cursor, number, value });
        }
        let id = self.plan.ids[place];
        let read = self.shards.read(id, is_wanted);
        let (record, grids) = read.map_err(|error| Unreadable { id, error })?;
        let value = (self.decode)(record, grids);
        if let Some(kept) = &self.kept {
            kept.put(place, &value);
        }
        Ok(Loaded { cursor, number, value })
    }
}
