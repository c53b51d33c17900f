//! The threads that work for Python. A process that was forked has none of its parent's: it gets a pool of its own.

use std::sync::Mutex;

use holescout::rl::Environment;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// The pool of a process, by its number. One of a parent is never dropped: its threads are not there to be ended.
static POOL: Mutex<Option<(u32, &'static ThreadPool)>> = Mutex::new(None);

/// The pool of this process; `RAYON_NUM_THREADS` says how many threads it has.
fn pool() -> &'static ThreadPool {
    let process = std::process::id();
    let mut pool = POOL.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    match *pool {
        Some((of, pool)) if of == process => pool,
        _ => {
            let built = ThreadPoolBuilder::new().build().expect("a process may have threads");
            let built: &'static ThreadPool = Box::leak(Box::new(built));
            *pool = Some((process, built));
            built
        }
    }
}

/// Does work on `count` episodes, on this thread if they are few.
pub(crate) fn spread<T: Send>(count: usize, work: impl FnOnce() -> T + Send) -> T {
    if count <= Environment::ALONE { work() } else { install(work) }
}

/// Does work that is spread over threads.
pub(crate) fn install<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    pool().install(work)
}
