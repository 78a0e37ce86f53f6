//! Progress of a bake.

use std::sync::atomic::{AtomicUsize, Ordering};

/// The progress of a part of some work, in equal steps that threads finish in any order.
pub struct StageProgress<'a> {
    watch: &'a (dyn Fn(f64) + Sync),
    from: f64,
    to: f64,
    steps: usize,
    done: AtomicUsize,
}

impl<'a> StageProgress<'a> {
    /// Makes the part of the work between the fractions `from` and `to`.
    pub fn new(watch: &'a (dyn Fn(f64) + Sync), (from, to): (f64, f64), steps: usize) -> Self {
        Self { watch, from, to, steps, done: AtomicUsize::new(0) }
    }

    /// Counts a finished step; every sixteenth call and the last one report to the watcher.
    pub fn step(&self) {
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        if done.is_multiple_of(16) || done == self.steps {
            (self.watch)(self.from + (self.to - self.from) * done as f64 / self.steps as f64);
        }
    }
}
