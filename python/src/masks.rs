//! Arrays of action masks, used again once nobody in Python holds them: at 4,096 environments new memory for
//! 4 MB a step would take as long as the steps do.

use std::sync::{Mutex, PoisonError};

use numpy::PyArray1;
use pyo3::prelude::*;

/// Arrays that are remembered. A loop holds the last two: those of an observation and of the next one.
const MOST: usize = 4;

/// Arrays that were given out.
#[derive(Default)]
pub(crate) struct Masks(Mutex<Vec<Py<PyArray1<u8>>>>);

impl Masks {
    /// An array of so many flags, whatever they are.
    pub(crate) fn take<'py>(&self, py: Python<'py>, len: usize) -> Bound<'py, PyArray1<u8>> {
        let mut given = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // A view of an array holds it, and so does whatever else can see its memory.
        #[expect(deprecated, reason = "what takes its place is not safe Rust")]
        let is_free = |array: &Py<PyArray1<u8>>| array.get_refcnt(py) == 1;
        let fits = |array: &Py<PyArray1<u8>>| array.bind(py).len().is_ok_and(|found| found == len);
        if let Some(free) = given.iter().find(|array| is_free(array) && fits(array)) {
            return free.bind(py).clone();
        }
        let new = PyArray1::zeros(py, len, false);
        if given.len() == MOST {
            given.remove(0);
        }
        given.push(new.clone().unbind());
        new
    }
}
