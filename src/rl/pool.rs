//! The maps of a split in memory.

use std::sync::Arc;

use rayon::prelude::*;

use super::world::World;
use crate::config::{RlConfig, Split};
use crate::dataset::{Dataset, ReadError};
use crate::grid::TileId;

/// All maps of a split, in the order of their names: about 250 kB each.
///
/// # Errors
/// The first record that cannot be read.
pub fn load_split(
    dataset: &Dataset,
    split: Split,
    config: &RlConfig,
) -> Result<Vec<Arc<World>>, ReadError> {
    let manifest = dataset.manifest();
    let of_split = |shard: &str| {
        manifest.shards.iter().any(|entry| entry.file == shard && entry.split == split)
    };
    let records = manifest.records.iter().filter(|record| of_split(&record.shard));
    let ids: Vec<TileId> = records.map(|record| record.id).collect();
    let load = |id| {
        let (record, grids) = dataset.record_with_grids(id)?;
        Ok(Arc::new(World::new(&record, &grids, config)))
    };
    ids.into_par_iter().map(load).collect()
}
