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

pub use build::{Build, Built, Finished, Item, Items, Opened, Output, Parallel};
pub use error::{Gap, OutputError};
pub use journal::lock;
pub use part::{BuildMode, Part, Task, TaskReport};
pub use presence::demand_outside;
pub use removal::stays_inside;

/// Name of a stage's manifest.
pub const MANIFEST: &str = "manifest.json";
/// Name of the list of checksums, in the format of `sha256sum`.
pub const SUMS: &str = "SHA256SUMS";

/// The lines of a `SHA256SUMS` file as (digest, name).
///
/// # Errors
/// The first line that is malformed or names something outside of the directory.
pub fn parse_sums(text: &str) -> Result<Vec<(&str, &str)>, &str> {
    let sound = |&(digest, name): &(&str, &str)| digest.len() == 64 && stays_inside(name);
    text.lines().map(|line| line.split_once("  ").filter(sound).ok_or(line)).collect()
}
