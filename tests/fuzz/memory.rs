//! An allocator that knows how much is taken, and refuses more than an input may take.

use std::{
    alloc::{GlobalAlloc, Layout, System},
    sync::atomic::{AtomicUsize, Ordering::Relaxed},
};

/// Counts what the process has taken.
pub struct Counting;

static TAKEN: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);
static LIMIT: AtomicUsize = AtomicUsize::new(usize::MAX);

/// The most bytes that were taken at once during some work, beyond those before it. More than `limit` ends the process, as an
/// exhausted memory does.
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

// SAFETY: every call is the system allocator's with the same arguments, or a null pointer, which means that there is no memory.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if !take(layout.size()) {
            return std::ptr::null_mut();
        }
        // SAFETY: the caller's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        if !take(layout.size()) {
            return std::ptr::null_mut();
        }
        // SAFETY: the caller's.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        TAKEN.fetch_sub(layout.size(), Relaxed);
        // SAFETY: the caller's.
        unsafe { System.dealloc(pointer, layout) }
    }
}
