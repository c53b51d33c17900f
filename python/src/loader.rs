//! Records for training, decoded ahead of their use.

use std::num::NonZero;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use holescout::config::OnDamage;
use holescout::dataset::{self, Grids, Loaded, LoaderOptions, Record, Share};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::dataset::{Dataset, record_dict, split};
use crate::error::{mismatch, raise};

/// A record that waits to be taken. It is not kept, so that its arrays can be handed over.
type Ready = Arc<(Record, Grids)>;

/// An endless iterator over the records of a split, in an order that only a seed decides.
#[pyclass(frozen)]
pub(crate) struct Loader {
    /// There until it is dropped.
    running: Option<Mutex<dataset::Loader<Ready>>>,
    records: u32,
    /// The process that has its threads.
    process: u32,
}

impl Drop for Loader {
    fn drop(&mut self) {
        if self.process != std::process::id() {
            // Threads of the process that this one was forked from cannot be waited for here.
            std::mem::forget(self.running.take());
        }
    }
}

#[pymethods]
impl Loader {
    /// Begins at a cursor, with the share of the process `rank` of `world`.
    #[new]
    #[pyo3(signature = (dataset, split_name, *, seed, cursor, rank, world, block, threads, memory_bytes, leave_out_damaged))]
    #[expect(clippy::too_many_arguments, reason = "they are keywords")]
    fn new(
        dataset: &Dataset,
        split_name: &str,
        seed: u64,
        cursor: u64,
        rank: u32,
        world: u32,
        block: Option<usize>,
        threads: Option<usize>,
        memory_bytes: usize,
        leave_out_damaged: bool,
    ) -> PyResult<Self> {
        let share = NonZero::new(world).and_then(|world| Share::of(rank, world));
        let share =
            share.ok_or_else(|| mismatch("rank", rank, format!("below world = {world}")))?;
        let of_seed = LoaderOptions::new(seed);
        let on_damage = if leave_out_damaged { OnDamage::Quarantine } else { OnDamage::Error };
        let options = LoaderOptions {
            block: block.and_then(NonZero::new),
            share,
            threads: threads.and_then(NonZero::new).unwrap_or(of_seed.threads),
            memory_bytes,
            keep: false,
            on_damage,
            ..of_seed
        };
        let decode = |record, grids| Arc::new((record, grids));
        let loader =
            dataset::Loader::new(&dataset.inner, split(split_name)?, options, cursor, decode);
        let loader = loader.map_err(raise)?;
        let records = loader.order().records().get();
        Ok(Self { running: Some(Mutex::new(loader)), records, process: std::process::id() })
    }

    /// The next record, and the cursor that it was loaded for.
    fn next<'py>(&self, py: Python<'py>) -> PyResult<(u64, Bound<'py, PyDict>)> {
        let loaded = py.detach(|| self.locked().next()).expect("a loader has no end");
        let Loaded { cursor, value, .. } = loaded.map_err(raise)?;
        let (record, grids) = Arc::try_unwrap(value).unwrap_or_else(|kept| (*kept).clone());
        Ok((cursor, record_dict(py, &record, grids)?))
    }

    /// The cursor of the next record: a loader that begins here goes on exactly.
    #[getter]
    fn cursor(&self) -> u64 {
        self.locked().cursor()
    }

    /// Records of an epoch, of all processes together.
    #[getter]
    fn records(&self) -> u32 {
        self.records
    }

    /// The records that were left out so far by their names, each with what is wrong with it.
    #[getter]
    fn damaged<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        for (id, reason) in self.locked().quarantined() {
            dict.set_item(id.to_string(), reason)?;
        }
        Ok(dict)
    }
}

impl Loader {
    fn locked(&self) -> MutexGuard<'_, dataset::Loader<Ready>> {
        let loader = self.running.as_ref().expect("it is there until it is dropped");
        loader.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
