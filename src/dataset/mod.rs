//! Datasets: aligned tiles and radio maps become records, records become shards.
//!
//! A dataset is a directory of `train/`, `val/` and `test/` with shards in the Zstandard
//! seekable format, one MessagePack record a frame, beside `manifest.json`, `SHA256SUMS`,
//! a card and the licence notice. Everything is a pure function of inputs and configuration.

pub(crate) mod card;
pub(crate) mod croissant;
mod downsample;
mod error;
mod grids;
mod loader;
mod location;
mod packed;
mod read;
mod record;
mod render;
mod schema;
mod shard_reader;
mod split;
mod stage;
mod statistics;
mod view;

pub use downsample::{downsample_errors, downsample_heights, downsample_rsrp};
pub use error::ReadError;
pub use grids::{Grids, RecordError};
pub use loader::{Epoch, Loaded, Loader, LoaderError, LoaderOptions, Order, Share};
pub use read::Dataset;
#[cfg(test)]
pub(crate) use record::tests::example;
pub use record::{Provenance, Record};
pub use render::{PanelStyle, panels_png};
pub use schema::record_schemas;
pub(crate) use shard_reader::ShardReader;
pub use split::{SplitAssignment, assign_splits};
pub use stage::{ShardError, ShardJob, shard};
pub(crate) use statistics::add as add_statistics;
pub(crate) use statistics::reliability_of;
pub use statistics::{hole_share, statistics_of, unsure_share};
pub use view::{record_json, records_csv};
pub(crate) use view::{table_csv, table_row};
