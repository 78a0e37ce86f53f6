//! Processor time of this process.

/// Returns the processor seconds of all threads of this process; `None` if the system does not report them.
#[cfg(unix)]
#[expect(clippy::unnecessary_wraps, reason = "other systems have none")]
fn processor_seconds() -> Option<f64> {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Some(time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64)
}

/// Returns `None`: processor time is not available on this system.
#[cfg(not(unix))]
fn processor_seconds() -> Option<f64> {
    None
}

/// Returns the result of some work, and the processor seconds that this process spent on it.
pub fn with_processor_seconds<T>(work: impl FnOnce() -> T) -> (T, Option<f64>) {
    let before = processor_seconds();
    let result = work();
    (result, processor_seconds().zip(before).map(|(after, before)| after - before))
}

#[cfg(test)]
mod tests {
    use super::processor_seconds;

    #[test]
    #[cfg(unix)]
    fn processor_time_grows_with_work() {
        let before = processor_seconds().unwrap();
        let start = std::time::Instant::now();
        let mut sum = 0.0_f64;
        while start.elapsed().as_millis() < 50 {
            sum += f64::sin(sum + 1.0);
        }
        assert!(processor_seconds().unwrap() > before + 0.001, "{sum}");
    }
}
