//! Releases: datasets as they are published, and what changes from one to the next.
//!
//! A release is a dataset: the same shards, byte for byte, and the same manifest with a version
//! more, so that everything that reads datasets reads it. Around them lies what somebody needs who
//! has nothing else: a card with figures and pictures, the table of records, the configuration and
//! the checksums of all inputs to build it again.

mod archive;
mod card;
mod changes;
mod charts;
mod compare;
mod date;
mod diff;
mod page;
mod rebuild;
mod scan;
mod stage;
mod version;
mod walls;

pub use changes::{Change, ChangedRecord, FileChanges, MovedRecord, RecordChanges};
pub use date::{Date, DateError};
pub use diff::{Diff, DiffError, Reason, Side, diff};
pub use semver::Version;
pub use stage::{ReleaseError, ReleaseJob, Released, release};
pub use version::{VersionStep, is_enough, least};
