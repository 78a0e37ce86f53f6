//! An allocator that tracks memory use and refuses more than a limit.

use std::{
    alloc::{GlobalAlloc, Layout, System},
    sync::atomic::{AtomicUsize, Ordering::Relaxed},
};

/// Counts the bytes allocated by the process.
pub struct Counting;

static TAKEN: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);
static LIMIT: AtomicUsize = AtomicUsize::new(usize::MAX);

/// Returns the peak of bytes allocated by `work`. Exceeding `limit` ends the process, like exhausted memory.
pub fn peak_of(limit: usize, work: impl FnOnce()) -> usize {
    let before = TAKEN.load(Relaxed);
    PEAK.store(before, Relaxed);
    LIMIT.store(before + limit, Relaxed);
    work();
    LIMIT.store(usize::MAX, Relaxed);
    PEAK.load(Relaxed).saturating_sub(before)
}

fn take(size: usize) -> bool {
    let taken = TAKEN.fetch_add(size, Relaxed) + size;
    if taken > LIMIT.load(Relaxed) {
        TAKEN.fetch_sub(size, Relaxed);
        return false;
    }
    PEAK.fetch_max(taken, Relaxed);
    true
}

// SAFETY: every call forwards the same arguments to the system allocator, or returns null, which means out of
// memory.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if !take(layout.size()) {
            return std::ptr::null_mut();
        }
        // SAFETY: upheld by the caller.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        if !take(layout.size()) {
            return std::ptr::null_mut();
        }
        // SAFETY: upheld by the caller.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        TAKEN.fetch_sub(layout.size(), Relaxed);
        // SAFETY: upheld by the caller.
        unsafe { System.dealloc(pointer, layout) }
    }
}
