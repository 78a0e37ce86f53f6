//! Progress bars with the time left, and interruption by signals.

use std::{
    error::Error,
    fmt,
    sync::{
        Arc, OnceLock,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
};

use anyhow::{Context, Result};
use indicatif::{ProgressBar, ProgressStyle};
#[cfg(unix)]
use signal_hook::consts::SIGHUP;
use signal_hook::{
    consts::{SIGINT, SIGTERM},
    flag,
};

/// What the first signal left.
struct Interruption {
    stop: Arc<AtomicBool>,
    /// Exit status of an interrupted program; 0 before a signal.
    status: Arc<AtomicUsize>,
}

static INTERRUPTION: OnceLock<Interruption> = OnceLock::new();

/// A flag that SIGINT, SIGTERM and SIGHUP set, one and the same for the whole process; a second signal ends the process at
/// once.
///
/// # Errors
/// If the system refuses a signal handler.
pub fn stop_flag() -> Result<Arc<AtomicBool>> {
    if let Some(known) = INTERRUPTION.get() {
        return Ok(known.stop.clone());
    }
    let (stop, status) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicUsize::new(0)));
    for (signal, code) in signals() {
        flag::register_conditional_shutdown(signal, code, stop.clone()).context("signal handler")?;
        // Before the flag: who sees the flag finds the status.
        flag::register_usize(signal, status.clone(), code as usize).context("signal handler")?;
        flag::register(signal, stop.clone()).context("signal handler")?;
    }
    Ok(INTERRUPTION.get_or_init(|| Interruption { stop, status }).stop.clone())
}

/// Lets SIGUSR1 set the same flag: a batch system's "the time is almost up".
///
/// # Errors
/// If the system refuses a signal handler.
#[cfg(unix)]
pub fn stop_at_user_signal() -> Result<()> {
    use signal_hook::consts::SIGUSR1;
    stop_flag()?;
    if let Some(known) = INTERRUPTION.get() {
        flag::register_usize(SIGUSR1, known.status.clone(), 138).context("signal handler")?;
        flag::register(SIGUSR1, known.stop.clone()).context("signal handler")?;
    }
    Ok(())
}

/// There is no such signal on this system.
#[cfg(not(unix))]
pub fn stop_at_user_signal() -> Result<()> {
    Ok(())
}

/// The signals that interrupt, each with the exit status that follows: 128 and its number, as shells have it. A terminal
/// that goes away (SIGHUP) ends a program as SIGTERM does, unless `nohup` started it.
fn signals() -> Vec<(i32, i32)> {
    #[cfg(unix)]
    if !std::fs::read_to_string("/proc/self/status").is_ok_and(|status| ignores(&status, SIGHUP)) {
        return vec![(SIGINT, 130), (SIGTERM, 143), (SIGHUP, 143)];
    }
    vec![(SIGINT, 130), (SIGTERM, 143)]
}

/// Whether a process ignores a signal, by its `/proc/PID/status` of Linux: `SigIgn` is a mask in hexadecimal digits.
#[cfg(unix)]
fn ignores(status: &str, signal: i32) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

/// The end of a command that a signal interrupted.
#[derive(Debug)]
pub struct Interrupted {
    what: String,
    /// Exit status of the program.
    pub status: u8,
}

impl Interrupted {
    /// The end by the signal that came, with what is left of the command, in words.
    pub fn new(what: impl Into<String>) -> Self {
        let status = INTERRUPTION.get().map_or(0, |known| known.status.load(Ordering::Relaxed));
        Self { what: what.into(), status: status.max(1) as u8 }
    }
}

impl fmt::Display for Interrupted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.what)
    }
}

impl Error for Interrupted {}

/// A bar over `length` units on standard error; silent where that is no terminal.
pub fn bar(length: u64, what: &str) -> ProgressBar {
    let style =
        ProgressStyle::with_template("{prefix:>12} [{bar:32}] {percent:>3}%  {elapsed} done, {eta} left  {msg}");
    let bar = ProgressBar::new(length);
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
    bar.set_prefix(what.to_owned());
    bar
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn ignored_signals_are_read_from_the_mask() {
        let status = |mask: &str| format!("Name:\theadtail\nSigBlk:\tffffffffffffffff\nSigIgn:\t{mask}\nSigCgt:\t0\n");
        assert!(ignores(&status("0000000000001001"), SIGHUP));
        assert!(!ignores(&status("0000000000001002"), SIGHUP) && ignores(&status("0000000000001002"), SIGINT));
        assert!(!ignores("SigIgn:\tmany\n", SIGHUP) && !ignores("", SIGHUP));
    }
}
