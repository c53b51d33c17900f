//! Arrays that are used again once nobody in Python holds them: new memory for the megabytes of a step would take as long
//! as the step.

use std::sync::{Mutex, PoisonError};

use numpy::{Element, PyArray1};
use pyo3::prelude::*;

/// Arrays that are remembered. A loop holds those of an observation and of the next one, of which each may have two.
const MOST: usize = 8;

/// Arrays that were given out.
pub(crate) struct Spare<T: Element>(Mutex<Vec<Py<PyArray1<T>>>>);

impl<T: Element> Default for Spare<T> {
    fn default() -> Self {
        Self(Mutex::new(Vec::new()))
    }
}

impl<T: Element> Spare<T> {
    /// An array of so many values, whatever they are.
    pub(crate) fn take<'py>(&self, py: Python<'py>, len: usize) -> Bound<'py, PyArray1<T>> {
        let mut given = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // A view of an array holds it, and so does whatever else can see its memory.
        #[expect(deprecated, reason = "what takes its place is not safe Rust")]
        let is_free = |array: &Py<PyArray1<T>>| array.get_refcnt(py) == 1;
        let fits = |array: &Py<PyArray1<T>>| array.bind(py).len().is_ok_and(|found| found == len);
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
