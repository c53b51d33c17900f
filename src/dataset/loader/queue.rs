//! What threads have done, in the order in which it is wanted.

use std::collections::BTreeMap;
use std::num::NonZero;
use std::sync::{Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};

/// A reorder buffer between workers, which claim items in turn, and one consumer, which takes the
/// results in the order of the items. Items are counted from 0.
#[derive(Debug)]
pub(super) struct Queue<R> {
    /// Most items that are claimed and not taken.
    window: NonZero<usize>,
    state: Mutex<QueueState<R>>,
    /// Signals the consumer: the result that is wanted next is there.
    filled: Condvar,
    /// Signals the workers: an item may be claimed, or there is nothing left to do.
    freed: Condvar,
    /// Signals who waits for the consumer: an item was taken, or the queue was stopped.
    taken: Condvar,
}

#[derive(Debug)]
struct QueueState<R> {
    /// The item to be taken next.
    wanted: u64,
    /// The item to be claimed next, at most `window` ahead of `wanted`.
    unclaimed: u64,
    results: BTreeMap<u64, R>,
    stopped: bool,
}

impl<R> Queue<R> {
    pub(super) fn new(window: NonZero<usize>) -> Self {
        let (results, stopped) = (BTreeMap::new(), false);
        let state = Mutex::new(QueueState { wanted: 0, unclaimed: 0, results, stopped });
        let (filled, freed, taken) = (Condvar::new(), Condvar::new(), Condvar::new());
        Self { window, state, filled, freed, taken }
    }

    fn lock(&self) -> MutexGuard<'_, QueueState<R>> {
        self.state.lock().expect("nothing panics while it holds the lock")
    }

    pub(super) fn window(&self) -> NonZero<usize> {
        self.window
    }

    /// The next item to work on, once it is inside the window; `None` after
    /// [`Queue::stop`].
    pub(super) fn claim(&self) -> Option<u64> {
        let window = self.window.get() as u64;
        let is_full =
            |state: &mut QueueState<R>| !state.stopped && state.unclaimed - state.wanted >= window;
        let waited = self.freed.wait_while(self.lock(), is_full);
        let mut state = waited.expect("nothing panics while it holds the lock");
        if state.stopped {
            return None;
        }
        let claimed = state.unclaimed;
        state.unclaimed = claimed + 1;
        Some(claimed)
    }

    /// Hands over the result of a claimed item.
    pub(super) fn put(&self, item: u64, result: R) {
        let mut state = self.lock();
        state.results.insert(item, result);
        if item == state.wanted {
            self.filled.notify_one();
        }
    }

    /// The next result, and how long it was waited for.
    pub(super) fn take(&self) -> (R, Duration) {
        let mut state = self.lock();
        let mut waited = Duration::ZERO;
        loop {
            let wanted = state.wanted;
            if let Some(result) = state.results.remove(&wanted) {
                state.wanted = wanted + 1;
                self.freed.notify_one();
                self.taken.notify_all();
                return (result, waited);
            }
            let begin = Instant::now();
            state = self.filled.wait(state).expect("nothing panics while it holds the lock");
            waited += begin.elapsed();
        }
    }

    /// Waits until the consumer has come to an item; false after [`Queue::stop`].
    pub(super) fn wait_for(&self, item: u64) -> bool {
        let is_early = |state: &mut QueueState<R>| !state.stopped && state.wanted < item;
        let waited = self.taken.wait_while(self.lock(), is_early);
        !waited.expect("nothing panics while it holds the lock").stopped
    }

    pub(super) fn is_stopped(&self) -> bool {
        self.lock().stopped
    }

    /// Sends the workers home.
    pub(super) fn stop(&self) {
        self.lock().stopped = true;
        self.freed.notify_all();
        self.taken.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    fn queue(window: usize) -> Queue<u64> {
        Queue::new(NonZero::new(window).expect("a window"))
    }

    #[test]
    fn results_come_in_the_order_of_items() {
        let queue = queue(4);
        let claimed: Vec<_> = (0..4).map(|_| queue.claim().expect("an item")).collect();
        assert_eq!(claimed, [0, 1, 2, 3]);
        claimed.iter().rev().for_each(|item| queue.put(*item, *item));
        for item in claimed {
            assert_eq!(queue.take(), (item, Duration::ZERO));
        }
    }

    #[test]
    fn claims_wait_for_the_window_and_end_with_a_stop() {
        let queue = queue(2);
        thread::scope(|scope| {
            assert_eq!((queue.claim(), queue.claim()), (Some(0), Some(1)));
            let third = scope.spawn(|| queue.claim());
            queue.put(1, 1);
            thread::sleep(Duration::from_millis(20));
            assert!(!third.is_finished(), "a result out of order frees nothing");
            queue.put(0, 0);
            queue.take();
            assert_eq!(third.join().expect("no panic"), Some(2));
            let blocked: Vec<_> = (0..3).map(|_| scope.spawn(|| queue.claim())).collect();
            queue.take();
            thread::sleep(Duration::from_millis(20));
            queue.stop();
            let claimed = blocked.into_iter().filter_map(|it| it.join().expect("no panic"));
            assert_eq!(claimed.collect::<Vec<_>>(), [3]);
        });
    }

    #[test]
    fn others_can_wait_for_the_consumer() {
        let queue = queue(4);
        (0..3).for_each(|item| queue.put(item, item));
        assert!(queue.wait_for(0), "it is there already");
        thread::scope(|scope| {
            let second = scope.spawn(|| queue.wait_for(2));
            queue.take();
            thread::sleep(Duration::from_millis(20));
            assert!(!second.is_finished(), "one item was taken");
            queue.take();
            assert!(second.join().expect("no panic"));
            let never = scope.spawn(|| queue.wait_for(9));
            queue.stop();
            assert!(!never.join().expect("no panic"));
        });
        assert!(queue.is_stopped());
    }

    #[test]
    fn the_time_that_is_waited_is_measured() {
        let queue = queue(1);
        let late = Duration::from_millis(50);
        thread::scope(|scope| {
            scope.spawn(|| {
                thread::sleep(late);
                queue.put(0, 0);
            });
            let begin = Instant::now();
            let (_, waited) = queue.take();
            assert!(waited <= begin.elapsed() && waited > late / 2, "{waited:?}");
        });
    }
}
