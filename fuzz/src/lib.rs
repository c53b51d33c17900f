//! What all targets share: an allocator that ends a run which takes more memory than any small
//! file deserves. A size that a header only claims is found at once, whether it is written to or not.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

/// What a target may hold at any time, in bytes, unless it calls [`allow`].
const USUAL: usize = 64 << 20;

static LIVE: AtomicUsize = AtomicUsize::new(0);
static BOUND: AtomicUsize = AtomicUsize::new(USUAL);

/// Sets what may be held at any time, in bytes.
pub fn allow(bytes: usize) {
    BOUND.store(bytes, Ordering::Relaxed);
}

struct Bounded;

#[global_allocator]
static ALLOCATOR: Bounded = Bounded;

fn taken(bytes: usize) {
    let before = LIVE.fetch_add(bytes, Ordering::Relaxed);
    // What a panic needs to print where it is does not count.
    if before.saturating_add(bytes) > BOUND.load(Ordering::Relaxed) && !std::thread::panicking() {
        allow(usize::MAX);
        eprintln!("allocates {bytes} bytes while {before} are in use");
        std::process::abort();
    }
}

// SAFETY: every call is passed on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Bounded {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        taken(layout.size());
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        taken(layout.size());
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        taken(size);
        LIVE.fetch_sub(layout.size(), Ordering::Relaxed);
        unsafe { System.realloc(block, layout, size) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size(), Ordering::Relaxed);
        unsafe { System.dealloc(block, layout) }
    }
}
