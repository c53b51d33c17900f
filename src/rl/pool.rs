//! The maps of a split in memory: all of them, or as many as fit, replaced as training goes on.

use std::collections::BTreeMap;
use std::num::NonZero;
use std::sync::Arc;
use std::time::Duration;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::maps::{MapKey, MapList, NothingToLearn};
use super::world::World;
use crate::config::{OnDamage, RlConfig, Split};
use crate::dataset::{Dataset, Loader, LoaderError, LoaderOptions, ReadError};
use crate::error::{Fault, HasFault};
use crate::grid::TileId;
use crate::random::Random;

/// Threads that decode maps while others train.
const DECODERS: NonZero<usize> = NonZero::<usize>::MIN;
/// Memory for maps that are decoded ahead, as a share of that for those in the pool.
const AHEAD: usize = 16;
const SAMPLE: u64 = 31;

/// The maps of a split, in the order of their names.
///
/// # Errors
/// The first record that cannot be read.
pub fn load_split(
    dataset: &Dataset,
    split: Split,
    config: &RlConfig,
) -> Result<Vec<Arc<World>>, ReadError> {
    load_maps(dataset, &dataset.ids_of(split), config)
}

/// At most `count` maps of a split, chosen by `seed`, in the order of their names.
///
/// # Errors
/// If the split is empty, or a record cannot be read.
pub fn load_sample(
    dataset: &Dataset,
    split: Split,
    config: &RlConfig,
    count: usize,
    seed: u64,
) -> Result<Vec<Arc<World>>, PoolError> {
    let mut ids = Random::keyed(&[seed, SAMPLE]).sample(&dataset.ids_of(split), count);
    if ids.is_empty() {
        return Err(PoolError::Empty { split });
    }
    ids.sort_unstable();
    Ok(load_maps(dataset, &ids, config)?)
}

/// The maps of some records, in their order.
///
/// # Errors
/// The first record that cannot be read.
pub fn load_maps(
    dataset: &Dataset,
    ids: &[TileId],
    config: &RlConfig,
) -> Result<Vec<Arc<World>>, ReadError> {
    ids.par_iter().map(|&id| load_one(dataset, id, config)).collect()
}

fn load_one(dataset: &Dataset, id: TileId, config: &RlConfig) -> Result<Arc<World>, ReadError> {
    let (record, grids) = dataset.record_with_grids(id)?;
    Ok(Arc::new(World::new(&record, &grids, config)))
}

/// All records of a split that can be read, with their numbers, and what is wrong with the others; an
/// error if that is all of them.
fn load_sound(
    dataset: &Dataset,
    split: Split,
    config: &RlConfig,
) -> Result<(Keyed, BTreeMap<TileId, String>), ReadError> {
    let ids = dataset.ids_of(split);
    let loaded: Vec<_> = ids.par_iter().map(|&id| load_one(dataset, id, config)).collect();
    let (mut sound, mut damaged, mut last) = (Vec::new(), BTreeMap::new(), None);
    for (number, (id, map)) in (0..).zip(ids.into_iter().zip(loaded)) {
        match map {
            Ok(map) => sound.push((number, map)),
            Err(error) if error.is_damage() => {
                damaged.insert(id, error.to_string());
                last = Some(error);
            }
            Err(error) => return Err(error),
        }
    }
    match last {
        Some(error) if sound.is_empty() => Err(error),
        _ => Ok((sound, damaged)),
    }
}

/// Why maps cannot be had.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PoolError {
    /// A record cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The split cannot be read.
    #[error(transparent)]
    Loader(#[from] LoaderError),
    /// There is nothing in the split.
    #[error("the {split} split has no records: build the dataset with one, see [split]")]
    Empty {
        /// The split.
        split: Split,
    },
    /// No map teaches anything.
    #[error(transparent)]
    NothingToLearn(#[from] NothingToLearn),
}

impl HasFault for PoolError {
    fn fault(&self) -> Fault {
        match self {
            Self::Read(error) => error.fault(),
            Self::Loader(error) => error.fault(),
            Self::NothingToLearn(error) => error.fault(),
            Self::Empty { .. } => Fault::Input,
        }
    }
}

/// What a checkpoint must keep of a pool.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PoolState {
    /// Keys of the maps in it.
    numbers: Vec<u32>,
    /// What the loader reads next.
    cursor: u64,
    /// Maps that were replaced so far.
    replaced: u64,
}

/// Maps to train on. Those that cannot teach anything are left out.
#[derive(Debug)]
pub struct MapPool {
    maps: MapList,
    replaced: u64,
    stream: Option<Stream>,
    /// Maps that were left out when all were read.
    damaged: BTreeMap<TileId, String>,
}

/// Where other maps come from.
#[derive(Debug)]
struct Stream {
    dataset: Arc<Dataset>,
    config: RlConfig,
    loader: Loader<Arc<World>>,
}

/// Where a pool's maps come from.
#[derive(Debug)]
pub struct MapSource(Origin);

#[derive(Debug)]
enum Origin {
    Given(Vec<Arc<World>>),
    Split(SplitMaps),
}

/// Which maps of a dataset, and how many at a time.
#[derive(Debug)]
struct SplitMaps {
    dataset: Arc<Dataset>,
    split: Split,
    config: RlConfig,
    memory_bytes: usize,
    seed: u64,
    on_damage: OnDamage,
    block: Option<NonZero<usize>>,
}

impl MapSource {
    /// Maps that are never replaced.
    #[must_use]
    pub fn maps(maps: Vec<Arc<World>>) -> Self {
        Self(Origin::Given(maps))
    }

    /// All maps of a split if they take at most `memory_bytes`, else as many as that holds, in the
    /// order that `seed` gives them; at most three quarters of them, so that others are soon found.
    #[must_use]
    pub fn split(
        dataset: &Arc<Dataset>,
        split: Split,
        config: &RlConfig,
        memory_bytes: usize,
        seed: u64,
    ) -> Self {
        let (dataset, config) = (Arc::clone(dataset), config.clone());
        let (on_damage, block) = (OnDamage::Error, None);
        Self(Origin::Split(SplitMaps {
            dataset,
            split,
            config,
            memory_bytes,
            seed,
            on_damage,
            block,
        }))
    }

    /// The same, but with only so many shards shuffled together where maps come and go.
    #[must_use]
    pub fn block(mut self, shards: Option<NonZero<usize>>) -> Self {
        if let Origin::Split(maps) = &mut self.0 {
            maps.block = shards;
        }
        self
    }

    /// The same, but with this done about maps that cannot be read.
    #[must_use]
    pub fn on_damage(mut self, on_damage: OnDamage) -> Self {
        if let Origin::Split(maps) = &mut self.0 {
            maps.on_damage = on_damage;
        }
        self
    }

    /// A pool at its beginning.
    ///
    /// # Errors
    /// If a record cannot be read, or no map can teach anything.
    pub fn fill(self) -> Result<MapPool, PoolError> {
        let (mut stream, capacity) = match self.open(0)? {
            OpenedMaps::Part { stream, capacity } => (stream, capacity),
            OpenedMaps::Whole { maps, damaged } => return MapPool::whole(maps, damaged),
        };
        let mut maps = Vec::new();
        while maps.len() < capacity {
            match stream.next(&maps)? {
                Some(next) => maps.push(next),
                // There are no others.
                None => return MapPool::of(maps, None),
            }
        }
        MapPool::of(maps, Some(stream))
    }

    /// A pool as a checkpoint has kept it; `None` if that does not fit.
    ///
    /// # Errors
    /// As [`MapSource::fill`].
    pub fn restore(self, state: &PoolState) -> Result<Option<MapPool>, PoolError> {
        let mut pool = match self.open(state.cursor)? {
            OpenedMaps::Whole { maps, damaged } => MapPool::whole(maps, damaged)?,
            OpenedMaps::Part { stream, capacity } => {
                let known = stream.loader.ids();
                let ids = state.numbers.iter().map(|&number| known.get(number as usize).copied());
                let Some(ids) = ids.collect::<Option<Vec<TileId>>>() else { return Ok(None) };
                let maps = load_maps(&stream.dataset, &ids, &stream.config)?;
                let maps = state.numbers.iter().copied().zip(maps).collect();
                let is_full = ids.len() == capacity;
                MapPool::of(maps, is_full.then_some(stream))?
            }
        };
        pool.replaced = state.replaced;
        Ok((pool.state() == *state).then_some(pool))
    }

    fn open(self, cursor: u64) -> Result<OpenedMaps, PoolError> {
        let whole = |maps, damaged| Ok(OpenedMaps::Whole { maps, damaged });
        let maps = match self.0 {
            Origin::Given(maps) => return whole((0..).zip(maps).collect(), BTreeMap::new()),
            Origin::Split(maps) => maps,
        };
        let SplitMaps { dataset, split, config, memory_bytes, seed, on_damage, block } = maps;
        let records = dataset.ids_of(split).len();
        let fitting = memory_bytes / World::bytes(dataset.manifest().cells as usize);
        if records > 0 && records <= fitting {
            if on_damage == OnDamage::Quarantine {
                let (maps, damaged) = load_sound(&dataset, split, &config)?;
                return whole(maps, damaged);
            }
            let maps = load_split(&dataset, split, &config)?;
            return whole((0..).zip(maps).collect(), BTreeMap::new());
        }
        let memory_bytes = memory_bytes / AHEAD;
        let of_seed = LoaderOptions::new(seed);
        let (threads, keep) = (DECODERS, false);
        let options = LoaderOptions { block, threads, memory_bytes, keep, on_damage, ..of_seed };
        let of = config.clone();
        let decode = move |record, grids| Arc::new(World::new(&record, &grids, &of));
        let loader = Loader::new(&dataset, split, options, cursor, decode)?;
        let capacity = fitting.min(records * 3 / 4).max(1);
        Ok(OpenedMaps::Part { stream: Stream { dataset, config, loader }, capacity })
    }
}

/// What a source gives.
enum OpenedMaps {
    /// All maps, and what is wrong with those that were left out.
    Whole { maps: Keyed, damaged: BTreeMap<TileId, String> },
    /// So many at a time.
    Part { stream: Stream, capacity: usize },
}

/// Maps with their keys.
type Keyed = Vec<(MapKey, Arc<World>)>;

impl MapPool {
    /// Memory that the maps of a split of `records` take at most, and those that are read ahead.
    #[must_use]
    pub fn bytes(records: usize, cells: usize, memory_bytes: usize) -> usize {
        (records * World::bytes(cells)).min(memory_bytes + memory_bytes / AHEAD)
    }

    /// Those of the maps that can teach something.
    fn of(maps: Keyed, stream: Option<Stream>) -> Result<Self, PoolError> {
        let maps = MapList::new(maps)?;
        Ok(Self { maps, replaced: 0, stream, damaged: BTreeMap::new() })
    }

    fn whole(maps: Keyed, damaged: BTreeMap<TileId, String>) -> Result<Self, PoolError> {
        Ok(Self { damaged, ..Self::of(maps, None)? })
    }

    /// The maps.
    #[must_use]
    pub fn maps(&self) -> &MapList {
        &self.maps
    }

    /// Whether other maps come and go.
    #[must_use]
    pub fn is_streamed(&self) -> bool {
        self.stream.is_some()
    }

    /// Replaces the map that is in the pool for longest, if there is another; returns the keys of the old
    /// one and the new one.
    ///
    /// # Errors
    /// If a record cannot be read.
    pub fn refresh(&mut self) -> Result<Option<[MapKey; 2]>, PoolError> {
        let Some(stream) = &mut self.stream else { return Ok(None) };
        let Some((key, map)) = stream.next(self.maps.all())? else { return Ok(None) };
        let place = (self.replaced % self.maps.len() as u64) as usize;
        let gone = self.maps.replace(place, key, map);
        self.replaced += 1;
        Ok(Some([gone, key]))
    }

    /// How long training had to wait for maps so far.
    #[must_use]
    pub fn waited(&self) -> Duration {
        self.stream.as_ref().map_or(Duration::ZERO, |stream| stream.loader.waited())
    }

    /// The maps that were left out so far since they cannot be read, each with the reason.
    #[must_use]
    pub fn quarantined(&self) -> &BTreeMap<TileId, String> {
        self.stream.as_ref().map_or(&self.damaged, |stream| stream.loader.quarantined())
    }

    /// What a checkpoint must keep.
    #[must_use]
    pub fn state(&self) -> PoolState {
        PoolState {
            numbers: self.maps.all().iter().map(|&(key, _)| key).collect(),
            cursor: self.stream.as_ref().map_or(0, |stream| stream.loader.cursor()),
            replaced: self.replaced,
        }
    }
}

impl Stream {
    /// The next map that can teach something and is not among these, within an epoch.
    fn next(
        &mut self,
        held: &[(MapKey, Arc<World>)],
    ) -> Result<Option<(MapKey, Arc<World>)>, ReadError> {
        for _ in 0..self.loader.ids().len() {
            let loaded = self.loader.next().expect("a loader has no end")?;
            let is_held = held.iter().any(|&(key, _)| key == loaded.number);
            if !is_held && loaded.value.can_teach() {
                return Ok(Some((loaded.number, loaded.value)));
            }
        }
        Ok(None)
    }
}
