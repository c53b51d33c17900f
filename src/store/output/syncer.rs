//! Brings files to the disk while others are still being made.
//!
//! Nothing relies on a file's being there for good before the output is complete, and then all are synced.
//! But a disk takes as long as it takes: one thread that begins early leaves little to wait for at the end.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::{Builder, JoinHandle};

use crate::error::FileError;
use crate::store::atomic::sync_file;

/// What the thread is told by, and the thread.
type Running = (Sender<PathBuf>, JoinHandle<Result<(), FileError>>);

/// A thread that waits for the disk.
#[derive(Debug)]
pub(super) struct Syncer {
    /// `None` where no thread could be started, or it was asked to end.
    running: Mutex<Option<Running>>,
    is_over: Arc<AtomicBool>,
}

impl Syncer {
    pub(super) fn start() -> Self {
        let (queue, files) = channel::<PathBuf>();
        let is_over = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&is_over);
        let sync = move || {
            let mut files = files.iter().take_while(|_| !ends.load(Ordering::Relaxed));
            files.try_for_each(|file| sync_file(&file))
        };
        let thread = Builder::new().name("sync".to_owned()).spawn(sync).ok();
        Self { running: Mutex::new(thread.map(|thread| (queue, thread))), is_over }
    }

    /// Syncs a file some time.
    pub(super) fn take(&self, file: PathBuf) {
        let running = self.running.lock().expect("nothing panics while it holds the lock");
        if let Some((queue, _)) = &*running {
            // A thread that has failed takes no more, and says why at the end.
            let _ = queue.send(file);
        }
    }

    /// Leaves what has not been synced yet to the caller.
    ///
    /// # Errors
    /// The first failure. The operating system tells it only once, so that the caller would not learn of it.
    pub(super) fn end(&self) -> Result<(), FileError> {
        self.is_over.store(true, Ordering::Relaxed);
        let running = self.running.lock().expect("nothing panics while it holds the lock").take();
        let Some((queue, thread)) = running else { return Ok(()) };
        drop(queue);
        thread.join().expect("syncing does not panic")
    }
}

impl Drop for Syncer {
    fn drop(&mut self) {
        // A build that failed has said why.
        drop(self.end());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failures_are_told_at_the_end_and_once() {
        let dir = tempfile::tempdir().expect("a directory");
        let file = dir.path().join("file");
        std::fs::write(&file, "text").expect("written");
        let syncer = Syncer::start();
        syncer.take(file);
        assert!(syncer.end().is_ok());
        syncer.take(dir.path().join("nowhere"));
        assert!(syncer.end().is_ok(), "it takes nothing any more");

        let syncer = Syncer::start();
        let nowhere = dir.path().join("nowhere");
        syncer.take(nowhere.clone());
        let running = |syncer: &Syncer| {
            let running = syncer.running.lock().expect("unpoisoned");
            running.as_ref().is_some_and(|(_, thread)| !thread.is_finished())
        };
        while running(&syncer) {
            std::thread::yield_now();
        }
        let failure = syncer.end().expect_err("there is no such file").to_string();
        assert!(failure.contains("nowhere"), "{failure}");
        assert!(syncer.end().is_ok());
    }
}
