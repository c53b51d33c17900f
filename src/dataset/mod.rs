//! Datasets: aligned tiles and radio maps become records, records become shards.
//!
//! A dataset is a directory of `train/`, `val/` and `test/` with shards in the Zstandard
//! seekable format, one MessagePack record a frame, beside `manifest.json`, `SHA256SUMS`,
//! a card and the licence notice. Everything is a pure function of inputs and configuration.

#[cfg(feature = "build")]
pub(crate) mod card;
#[cfg(feature = "build")]
pub(crate) mod croissant;
#[cfg(feature = "build")]
mod downsample;
mod error;
mod grids;
mod loader;
mod location;
mod packed;
mod read;
mod record;
#[cfg(feature = "report")]
mod render;
mod schema;
mod shard_reader;
#[cfg(feature = "build")]
mod split;
#[cfg(feature = "build")]
mod stage;
mod statistics;
#[cfg(feature = "build")]
mod view;

#[cfg(feature = "build")]
pub use downsample::{downsample_errors, downsample_heights, downsample_rsrp};
pub use error::ReadError;
pub use grids::{Grids, RecordError};
pub use loader::{Epoch, Loaded, Loader, LoaderError, LoaderOptions, Order, Share};
pub use read::Dataset;
#[cfg(test)]
pub(crate) use record::tests::example;
pub use record::{Provenance, Record};
#[cfg(feature = "report")]
pub use render::{PanelStyle, panels_png};
pub use schema::record_schemas;
pub(crate) use shard_reader::ShardReader;
#[cfg(feature = "build")]
pub use split::{SplitAssignment, assign_splits};
#[cfg(feature = "build")]
pub use stage::{ShardError, ShardJob, shard};
pub(crate) use statistics::add as add_statistics;
pub(crate) use statistics::reliability_of;
pub use statistics::{hole_share, statistics_of, unsure_share};
#[cfg(feature = "build")]
pub use view::{record_json, records_csv};
#[cfg(feature = "build")]
pub(crate) use view::{table_csv, table_row};
