//! Holescout: from OpenStreetMap buildings and ray-traced radio maps to reproducible
//! datasets for finding coverage holes.
//!
//! The library is pure: no argument parsing, no printing. Each stage of the pipeline is
//! one function that reads files and fills a directory; the command `holescout` (in
//! `pipeline/`) parses, calls it, and reports.
//!
//! ```
//! use std::path::Path;
//!
//! use holescout::config::{Config, Split};
//! use holescout::dataset::{Dataset, ShardJob, shard};
//! use holescout::grid::Area;
//! use holescout::progress::Silent;
//! use holescout::rasterise::{RasteriseJob, rasterise};
//! use holescout::rl::{Hops, Sight, World};
//! use holescout::rsrp::{ImportRsrpJob, import_rsrp};
//! use holescout::store::BuildMode;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let scratch = tempfile::tempdir()?;
//! # let scratch = scratch.path();
//! # let helsinki = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/helsinki");
//! # let osm = helsinki.join("helsinki.osm.pbf");
//! # let maps = &helsinki.join("rsrp");
//! # let text = std::fs::read_to_string(helsinki.join("holescout.toml"))?;
//! // The settings, and what is to be built: all of it, into new directories.
//! let config = &Config::parse(&text)?;
//! let mode = BuildMode::default();
//! let [tiles, rsrp, out] = &["tiles", "rsrp", "dataset"].map(|name| scratch.join(name));
//!
//! // Buildings of an extract to height grids, radio maps to RSRP on them, both to records.
//! let job = RasteriseJob { osm: &[osm], area: &Area::Whole, config, out: tiles, mode };
//! rasterise(job, &Silent)?;
//! import_rsrp(ImportRsrpJob { maps, tiles, scenes: None, config, out: rsrp, mode }, &Silent)?;
//! shard(ShardJob { tiles, rsrp, config, out, mode }, &Silent)?;
//!
//! // A record: heights in metres, RSRP in dBm, row 0 north, column 0 west.
//! let dataset = Dataset::open(out)?;
//! let id = dataset.ids_of(Split::Train)[0];
//! let (record, grids) = dataset.record_with_grids(id)?;
//! assert_eq!(grids.rsrp_dbm.dim(), (121, 121));
//!
//! // The task on it: from how many cells is a coverage hole one move away?
//! let world = World::new(&record, &grids, &config.rl);
//! let hops = Hops::new(&world, &Sight::new(config.rl.reach_cells));
//! let near = world.covered().filter(|&cell| hops.from(cell) == Some(1)).count();
//! println!("{id}: {near} cells");
//! # assert!(near > 0);
//! # Ok(())
//! # }
//! ```
//!
//! # Features
//!
//! Each adds to the others. Without any, the library reads datasets ([`dataset`]) and knows the task
//! ([`rl`]), which takes some 60 crates.
//!
//! | feature | adds |
//! |---|---|
//! | `build` | what datasets are made from: [`osm`], [`rasterise`], [`scenes`], [`rsrp`], [`dataset::shard`]; Unix only |
//! | `report` | `build`, and [`evaluate`] with plots, [`release`], [`export`], [`verify`], [`rebuild`] |
//! | `cli` (default) | `report`, and the command `holescout` |
//! | `remote` | datasets at `http(s)://` and `s3://` |
//! | `torch` | `report`, `rl::agent` and `train`; needs libtorch |
//!
//! # Order
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
//! 7. [`dataset`]: records, splits, shards; reading and drawing them
//! 8. [`rl`]: the task on a record, policies, the exact optimum
//! 9. [`evaluate`]: precision and recall of policies, with intervals, and the report
//! 10. `train` (feature `torch`): runs that learn an agent
//! 11. [`release`], [`export`]: datasets that are published, and what changes from one to the next;
//!     datasets in a format of others
//! 12. [`verify`]: whether an output is what its manifest says
//! 13. [`rebuild`]: an output once more from its recorded inputs
//!
//! ARCHITECTURE.md tells the way that data takes.

#![cfg_attr(
    not(feature = "report"),
    allow(
        dead_code,
        unused_imports,
        unreachable_pub,
        rustdoc::broken_intra_doc_links,
        reason = "what only further features use is not worth a gate each"
    )
)]

#[cfg(all(feature = "build", not(unix)))]
compile_error!("the feature `build` needs a Unix system (Linux, macOS); reading datasets does not");

#[cfg(feature = "build")]
pub use geo;
pub use ndarray;

pub mod building;
pub mod config;
pub mod crs;
pub mod dataset;
pub mod error;
#[cfg(feature = "report")]
pub mod evaluate;
#[cfg(feature = "report")]
pub mod export;
pub mod grid;
pub mod manifest;
#[cfg(feature = "build")]
pub mod osm;
pub mod progress;
pub mod random;
#[cfg(feature = "build")]
pub mod rasterise;
#[cfg(feature = "report")]
pub mod rebuild;
#[cfg(feature = "report")]
pub mod release;
pub mod reliability;
pub mod rl;
#[cfg(feature = "build")]
pub mod rsrp;
#[cfg(feature = "build")]
pub mod scenes;
pub mod store;
#[cfg(feature = "torch")]
pub mod train;
pub mod units;
#[cfg(feature = "report")]
pub mod verify;
