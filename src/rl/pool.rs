//! The maps of a split in memory.

use std::sync::Arc;

use rayon::prelude::*;

use super::world::World;
use crate::config::{RlConfig, Split};
use crate::dataset::{Dataset, ReadError};

/// All maps of a split, in the order of their names: about 250 kB each.
///
/// # Errors
/// The first record that cannot be read.
pub fn load_split(
    dataset: &Dataset,
    split: Split,
    config: &RlConfig,
) -> Result<Vec<Arc<World>>, ReadError> {
    let mut records = dataset.ids();
    records.retain(|(_, of)| *of == split);
    let load = |(id, _)| {
        let (record, grids) = dataset.record_with_grids(id)?;
        Ok(Arc::new(World::new(&record, &grids, config)))
    };
    records.into_par_iter().map(load).collect()
}
