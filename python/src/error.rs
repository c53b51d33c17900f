//! Errors of the library as exceptions of `holescout.errors`.

use holescout::config::ConfigError;
use holescout::dataset::RecordError;
use holescout::error::{Fault, HasFault};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyDict, PyType};

static INVALID_INPUT: PyOnceLock<Py<PyType>> = PyOnceLock::new();
static RUN_FAILED: PyOnceLock<Py<PyType>> = PyOnceLock::new();

/// What was found and expected where it is known, and how to mend it.
#[derive(Debug, Default)]
struct Details {
    found: Option<String>,
    expected: Option<String>,
}

/// The exception for an error of the library: `InvalidInput` or `RunFailed`.
pub(crate) fn raise(error: impl HasFault + 'static) -> PyErr {
    let fault = error.fault();
    exception(fault, error.to_string(), details(&error))
}

/// The exception for input that this crate found to be wrong.
pub(crate) fn invalid(message: String) -> PyErr {
    exception(Fault::Input, message, Details::default())
}

/// The same with what was found and expected.
pub(crate) fn mismatch(
    what: &str,
    found: impl std::fmt::Display,
    expected: impl std::fmt::Display,
) -> PyErr {
    let (found, expected) = (found.to_string(), expected.to_string());
    let message = format!("{what}: found {found}, expected {expected}");
    exception(Fault::Input, message, Details { found: Some(found), expected: Some(expected) })
}

/// A number of Python that must be one of 0 to `end` - 1.
pub(crate) fn below(what: &str, found: i64, end: usize) -> PyResult<usize> {
    let known = usize::try_from(found).ok().filter(|&found| found < end);
    known.ok_or_else(|| mismatch(what, found, format!("0 to {}", end.saturating_sub(1))))
}

fn details(error: &(dyn std::error::Error + 'static)) -> Details {
    let mut next = Some(error);
    while let Some(error) = next {
        if let Some(ConfigError { found, expected, .. }) = error.downcast_ref() {
            return Details { found: Some(found.clone()), expected: Some(expected.clone()) };
        }
        if let Some(RecordError::Value { found, expected, .. }) = error.downcast_ref() {
            return Details { found: Some(found.clone()), expected: Some(expected.clone()) };
        }
        next = error.source();
    }
    Details::default()
}

fn exception(fault: Fault, message: String, details: Details) -> PyErr {
    Python::attach(|py| {
        let (cell, name) = match fault {
            Fault::Input => (&INVALID_INPUT, "InvalidInput"),
            Fault::Running => (&RUN_FAILED, "RunFailed"),
        };
        let built = || -> PyResult<PyErr> {
            let class = cell.import(py, "holescout.errors", name)?;
            let keywords = PyDict::new(py);
            keywords.set_item("found", details.found)?;
            keywords.set_item("expected", details.expected)?;
            Ok(PyErr::from_value(class.call((message.as_str(),), Some(&keywords))?))
        };
        built().unwrap_or_else(|_| PyRuntimeError::new_err(message.clone()))
    })
}
