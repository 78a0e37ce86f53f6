//! Rendering time by stage. Off by default: reading the clock takes about 20 ns, 10 % of a short stage.
//!
//! Times are summed over all threads of the process, so only one rendering can be measured at a time.

use std::{
    cell::Cell,
    fmt,
    sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed},
    time::Instant,
};

/// A stage of a light estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Camera rays (and those of further bounces): traversal, the hit's normals and textures.
    CameraRays,
    /// Drawing directions: preparation for a point, the draw and its pdf.
    Sampling,
    /// Pdfs of other samplers at a drawn direction, in mixtures, MIS and RIS.
    Pdf,
    /// Shadow rays.
    ShadowRays,
    /// BRDF x cosine x light / pdf.
    Shading,
    /// Visibility updates of samplers that learn.
    Learning,
}

/// All stages with their names.
const STAGES: [(Stage, &str); 6] = [
    (Stage::CameraRays, "camera rays"),
    (Stage::Sampling, "sampling"),
    (Stage::Pdf, "pdf evaluation"),
    (Stage::ShadowRays, "shadow rays"),
    (Stage::Shading, "shading"),
    (Stage::Learning, "learning"),
];

static ENABLED: AtomicBool = AtomicBool::new(false);
static TOTALS: [AtomicU64; STAGES.len()] = [const { AtomicU64::new(0) }; STAGES.len()];

thread_local! {
    /// Nanoseconds of this thread not yet added to the totals.
    static OWN: Cell<[u64; STAGES.len()]> = const { Cell::new([0; STAGES.len()]) };
    /// Nanoseconds of stages nested in the current one.
    static INSIDE: Cell<u64> = const { Cell::new(0) };
}

/// Runs work of a stage, and measures it if timings are on. The time of a nested stage counts only for
/// the inner one.
pub fn timed<T>(stage: Stage, work: impl FnOnce() -> T) -> T {
    if !ENABLED.load(Relaxed) {
        return work();
    }
    let outside = INSIDE.replace(0);
    let start = Instant::now();
    let result = work();
    let elapsed = start.elapsed().as_nanos() as u64;
    let mut own = OWN.get();
    own[stage as usize] += elapsed.saturating_sub(INSIDE.get());
    OWN.set(own);
    INSIDE.set(outside + elapsed);
    result
}

/// Adds this thread's times to the totals.
pub fn flush() {
    if ENABLED.load(Relaxed) {
        let own = OWN.replace([0; STAGES.len()]);
        for (total, own) in TOTALS.iter().zip(own) {
            total.fetch_add(own, Relaxed);
        }
    }
}

/// Seconds of thread time in each stage.
#[derive(Clone, Debug, PartialEq)]
pub struct Timings {
    seconds: [f64; STAGES.len()],
    /// Wall-clock seconds times threads. Time outside the stages is spent on random numbers, the film
    /// and waiting.
    whole: f64,
}

impl Timings {
    /// Starts measuring.
    pub fn start() {
        TOTALS.iter().for_each(|total| total.store(0, Relaxed));
        ENABLED.store(true, Relaxed);
    }

    /// Ends the measurement of a rendering that took `seconds` on `threads` threads.
    pub fn take(seconds: f64, threads: usize) -> Self {
        ENABLED.store(false, Relaxed);
        let seconds_of = |total: &AtomicU64| 1e-9 * total.load(Relaxed) as f64;
        Self { seconds: TOTALS.each_ref().map(seconds_of), whole: seconds * threads as f64 }
    }

    /// Seconds of thread time in a stage.
    pub fn seconds(&self, stage: Stage) -> f64 {
        self.seconds[stage as usize]
    }
}

impl fmt::Display for Timings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = |seconds: f64| 100.0 * seconds / self.whole;
        for (stage, name) in STAGES {
            writeln!(f, "{name:16} {:9.3} s {:5.1} %", self.seconds(stage), percent(self.seconds(stage)))?;
        }
        let rest = self.whole - self.seconds.iter().sum::<f64>();
        write!(f, "{:16} {rest:9.3} s {:5.1} %", "everything else", percent(rest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_are_measured_only_when_enabled() {
        let work = || (0..1000).map(|i| f64::from(i).sqrt()).sum::<f64>();
        timed(Stage::Shading, work);
        Timings::start();
        timed(Stage::Sampling, work);
        flush();
        let timings = Timings::take(1.0, 2);
        assert!(timings.seconds(Stage::Sampling) > 0.0 && timings.seconds(Stage::Shading) == 0.0);
        assert_eq!(timings.to_string().lines().count(), STAGES.len() + 1);
    }
}
