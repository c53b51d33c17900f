//! Long work: it runs on a thread of its own, while Python's main thread looks for Ctrl-C and passes progress on.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use holescout::progress::Progress;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

use crate::workers;

/// How often Ctrl-C is looked for.
const PERIOD: Duration = Duration::from_millis(50);

/// What unwinds work that nobody wants any more.
struct Cancelled;

/// What work tells.
enum Told {
    Begin(String, Option<u64>),
    Advance(u64),
    End,
    Note(String),
}

/// Work in progress.
pub(crate) struct Watch {
    told: Sender<Told>,
    is_cancelled: AtomicBool,
    /// What Python raised first, in the work or beside it.
    failure: Mutex<Option<PyErr>>,
}

impl Watch {
    /// Unwinds the work if it is not wanted any more; outputs under temporary names are removed on the way.
    pub(crate) fn check(&self) {
        if self.is_cancelled.load(Ordering::Relaxed) {
            resume_unwind(Box::new(Cancelled));
        }
    }

    /// Ends the work, which will have raised this.
    pub(crate) fn fail(&self, error: PyErr) {
        self.failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        self.is_cancelled.store(true, Ordering::Relaxed);
    }

    fn tell(&self, told: Told) {
        self.check();
        // The listener hears until the work is over.
        let _ = self.told.send(told);
    }
}

impl Progress for Watch {
    fn begin(&self, phase: &str, total: Option<u64>) {
        self.tell(Told::Begin(phase.to_owned(), total));
    }

    fn advance(&self, steps: u64) {
        self.tell(Told::Advance(steps));
    }

    fn end(&self) {
        self.tell(Told::End);
    }

    fn note(&self, text: &str) {
        self.tell(Told::Note(text.to_owned()));
    }
}

/// How far the current phase is, as `progress(phase, done, total)` is told.
#[derive(Default)]
struct Phase {
    name: String,
    done: u64,
    total: Option<u64>,
}

/// Does work on other threads. `progress(phase, done, total)` is called on this one, and notes are warnings.
/// What it raises, and Ctrl-C, ends the work.
pub(crate) fn watched<T: Send>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Watch) -> PyResult<T> + Send,
) -> PyResult<T> {
    let (told, heard) = channel();
    let watch = Watch { told, is_cancelled: AtomicBool::new(false), failure: Mutex::new(None) };
    std::thread::scope(|scope| {
        let (watch, (done, mut ended)) = (&watch, channel());
        let worker = scope.spawn(move || {
            let outcome = catch_unwind(AssertUnwindSafe(|| workers::install(|| work(watch))));
            // The listener only leaves after this.
            let _ = done.send(());
            outcome
        });
        let mut phase = Phase::default();
        loop {
            let listener = &mut ended;
            let is_over =
                py.detach(move || listener.recv_timeout(PERIOD)) != Err(RecvTimeoutError::Timeout);
            if let Err(error) =
                py.check_signals().and_then(|()| pass_on(py, &heard, progress, &mut phase))
            {
                watch.fail(error);
            }
            if is_over {
                break;
            }
        }
        let outcome = py.detach(|| worker.join()).unwrap_or_else(Err);
        let failure = watch.failure.lock().unwrap_or_else(PoisonError::into_inner).take();
        match (failure, outcome) {
            (Some(failure), _) => Err(failure),
            (None, Ok(outcome)) => outcome,
            (None, Err(panic)) => Err(of_panic(&*panic)),
        }
    })
}

fn of_panic(panic: &(dyn Any + Send)) -> PyErr {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("unknown");
    PyRuntimeError::new_err(format!("a bug in holescout: {text}"))
}

/// Calls `progress` once for all that was told since.
fn pass_on(
    py: Python<'_>,
    heard: &Receiver<Told>,
    progress: Option<&Bound<'_, PyAny>>,
    phase: &mut Phase,
) -> PyResult<()> {
    let mut is_changed = false;
    for told in heard.try_iter() {
        match told {
            Told::Begin(name, total) => *phase = Phase { name, done: 0, total },
            Told::Advance(steps) => phase.done += steps,
            Told::End => phase.done = phase.total.unwrap_or(phase.done),
            Told::Note(text) => {
                let category = py.get_type::<pyo3::exceptions::PyUserWarning>();
                let text = std::ffi::CString::new(text).unwrap_or_default();
                PyErr::warn(py, &category, &text, 2)?;
                continue;
            }
        }
        is_changed = true;
    }
    match progress {
        Some(progress) if is_changed => {
            progress.call1((&phase.name, phase.done, phase.total)).map(drop)
        }
        _ => Ok(()),
    }
}
