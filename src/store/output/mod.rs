//! A directory that a stage fills: resumable, never half-done under a final name.
//!
//! While a build runs, the directory holds a journal (`.holescout-build.jsonl`): its first
//! line says which stage builds from which inputs, every further line names an item that
//! is done, with the digests of its files. A killed build leaves the journal and no
//! manifest; the next run with the same inputs takes over what the journal vouches for.
//! The manifest is written last and the journal removed after it, so a directory with a
//! manifest is whole.
//!
//! Several tasks may share a build: each has a journal of its own
//! (`.holescout-build.2-of-8.jsonl`) and builds what falls to it of a plan that all know. A merge
//! takes the journals of all tasks for earlier work and builds nothing: what is missing is an
//! error that names the task.
//!
//! A stage goes through it in one order, since each step is what the last one gives:
//! [`Build::open`], then [`Build::run_items`] (or [`Build::begin`], if it has no items), then
//! [`Output::write`] and [`Output::complete`].

mod build;
mod dir;
mod error;
mod journal;
mod part;
mod presence;
mod removal;
mod syncer;

pub use build::Built;
pub(crate) use build::{Build, Finished, Item, Items, Opened, Output, Parallel};
pub use error::{Gap, OutputError};
#[cfg(feature = "torch")]
pub(crate) use journal::lock;
pub use part::{BuildMode, Part, Task, TaskReport};
#[cfg(feature = "torch")]
pub(crate) use presence::demand_outside;
