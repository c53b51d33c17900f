//! Holescout: from OpenStreetMap buildings and ray-traced radio maps to reproducible
//! datasets for finding coverage holes.
//!
//! The library is pure: no argument parsing, no printing. Each stage of the pipeline is
//! one function that reads files and writes a directory; the command `holescout` (in
//! `pipeline/`) parses, calls it, and reports. ARCHITECTURE.md tells the way that data
//! takes.
//!
//! Modules import only from those above them in this list:
//!
//! 1. [`units`], [`error`], [`progress`], [`config`]: words that everything else uses
//! 2. [`crs`], [`reliability`]: longitude/latitude to UTM and back; how sure a coverage hole is
//! 3. [`grid`], [`building`]: tiles and windows; tags, heights, defects
//! 4. [`store`]: files that are whole or absent, `.npy`, `.npz`, seekable Zstandard
//! 5. [`manifest`]: what stages write about their outputs
//! 6. [`osm`], [`rasterise`], [`scenes`], [`rsrp`]: extracts to buildings to height grids and
//!    scenes for a ray tracer; anyone's radio maps to aligned RSRP
//! 7. [`dataset`]: records, splits, shards; verifying and drawing them
//! 8. [`rl`]: the task on a record, policies, the exact optimum
//! 9. [`evaluate`]: precision and recall of policies, with intervals, and the report
//! 10. `train` (feature `torch`): runs that learn an agent
//! 11. [`release`]: datasets that are published, and what changes from one to the next
//! 12. [`verify`]: whether an output is what its manifest says
//! 13. [`rebuild`]: an output once more from its recorded inputs

pub mod building;
pub mod config;
pub mod crs;
pub mod dataset;
pub mod error;
pub mod evaluate;
pub mod grid;
pub mod manifest;
pub mod osm;
pub mod progress;
pub mod random;
pub mod rasterise;
pub mod rebuild;
pub mod release;
pub mod reliability;
pub mod rl;
pub mod rsrp;
pub mod scenes;
pub mod store;
#[cfg(feature = "torch")]
pub mod train;
pub mod units;
pub mod verify;
