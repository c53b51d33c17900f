//! Datasets: aligned tiles and radio maps become records, records become shards.
//!
//! A dataset is a directory of `train/`, `val/` and `test/` with shards in the Zstandard
//! seekable format, one MessagePack record a frame, beside `manifest.json`, `SHA256SUMS`,
//! a card and the licence notice. Everything is a pure function of inputs and configuration.

pub(crate) mod card;
pub(crate) mod croissant;
mod downsample;
mod loader;
mod packed;
mod place;
mod read;
mod record;
mod render;
mod schema;
mod shard;
mod split;
mod stage;
mod statistics;
mod verify;
mod view;

pub use downsample::{downsample_errors, downsample_heights, downsample_rsrp};
pub use loader::{Epoch, Loaded, Loader, LoaderError, LoaderOptions, Order, Share};
pub use read::{Dataset, ReadError};
#[cfg(test)]
pub(crate) use record::tests::example;
pub use record::{Grids, Provenance, Record, RecordError};
pub use render::{PanelStyle, panels_png};
pub use schema::record_schemas;
pub use split::{SplitAssignment, assign_splits};
pub use stage::{ShardError, ShardJob, build_dataset};
pub(crate) use statistics::reliability_of;
pub use statistics::{hole_share, statistics_of, unsure_share};
pub use verify::{Verification, VerifyFailure, verify};
pub use view::{record_json, records_csv};
pub(crate) use view::{table_csv, table_row};
