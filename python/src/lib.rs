//! Python's side of Holescout, as `holescout._native`: what needs the library's speed or its exact rules. The
//! classes that people use are in `holescout/`, in Python.
//!
//! Arrays are NumPy's and take over the memory that was filled here. Python's lock is let go of while Rust works.

mod array;
mod compact;
mod dataset;
mod episodes;
mod error;
mod evaluation;
mod loader;
mod maps;
mod replay;
mod spare;
mod stages;
mod watch;
mod workers;

/// What `holescout/` is made of.
#[pyo3::pymodule]
mod _native {
    #[pymodule_export]
    use crate::dataset::Dataset;
    #[pymodule_export]
    use crate::episodes::Episodes;
    #[pymodule_export]
    use crate::evaluation::evaluate;
    #[pymodule_export]
    use crate::loader::Loader;
    #[pymodule_export]
    use crate::maps::{Map, Maps};
    #[pymodule_export]
    use crate::replay::ReplayBuffer;
    #[pymodule_export]
    use crate::stages::{import_rsrp, rasterise, scenes, shard, verify};
}
