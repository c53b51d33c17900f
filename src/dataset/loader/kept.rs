//! Decoded records that stay in memory.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A place for each record of a split, filled once.
#[derive(Debug)]
pub(super) struct Kept<T> {
    places: Box<[OnceLock<T>]>,
    filled: AtomicUsize,
}

impl<T: Clone> Kept<T> {
    pub(super) fn new(records: usize) -> Self {
        let places = (0..records).map(|_| OnceLock::new()).collect();
        Self { places, filled: AtomicUsize::new(0) }
    }

    pub(super) fn get(&self, number: usize) -> Option<T> {
        self.places[number].get().cloned()
    }

    /// Keeps a record; of two for one place, the first.
    pub(super) fn put(&self, number: usize, value: &T) {
        if self.places[number].set(value.clone()).is_ok() {
            self.filled.fetch_add(1, Ordering::Release);
        }
    }

    /// Whether all records are here.
    pub(super) fn is_full(&self) -> bool {
        self.filled.load(Ordering::Acquire) == self.places.len()
    }
}
