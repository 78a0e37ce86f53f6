//! Progress bars with the time left, and interruption by signals.

use std::{
    cell::{Cell, OnceCell},
    error::Error,
    fmt,
    io::IsTerminal,
    ops::Range,
    sync::{
        Arc, Mutex, OnceLock, PoisonError,
        atomic::{AtomicBool, AtomicUsize, Ordering},
        mpsc,
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use anyhow::{Context, Result};
use headtail_train::Progress;
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
#[cfg(unix)]
use signal_hook::consts::SIGHUP;
use signal_hook::{
    consts::{SIGINT, SIGTERM},
    flag,
};

use crate::{report::number::duration, terminal};

/// Stop flag and exit status, set by the first signal.
struct Interruption {
    stop: Arc<AtomicBool>,
    /// Exit status of an interrupted program; 0 before a signal.
    status: Arc<AtomicUsize>,
}

static INTERRUPTION: OnceLock<Interruption> = OnceLock::new();

/// Returns the process-wide flag that SIGINT, SIGTERM and SIGHUP set; a second signal ends the process at
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
        // Before the flag, so that a set flag implies a set status.
        flag::register_usize(signal, status.clone(), code as usize).context("signal handler")?;
        flag::register(signal, stop.clone()).context("signal handler")?;
    }
    Ok(INTERRUPTION.get_or_init(|| Interruption { stop, status }).stop.clone())
}

/// Exit status after SIGUSR1.
const USER_SIGNAL_STATUS: usize = 138;

/// Makes SIGUSR1, by which batch systems warn that the time is almost up, set the same flag.
///
/// # Errors
/// If the system refuses a signal handler.
#[cfg(unix)]
pub fn stop_at_user_signal() -> Result<()> {
    use signal_hook::consts::SIGUSR1;
    stop_flag()?;
    if let Some(known) = INTERRUPTION.get() {
        flag::register_usize(SIGUSR1, known.status.clone(), USER_SIGNAL_STATUS).context("signal handler")?;
        flag::register(SIGUSR1, known.stop.clone()).context("signal handler")?;
    }
    Ok(())
}

/// Whether the signal was SIGUSR1.
pub fn is_user_signal() -> bool {
    INTERRUPTION.get().is_some_and(|known| known.status.load(Ordering::Relaxed) == USER_SIGNAL_STATUS)
}

/// Does nothing: this system has no such signal.
#[cfg(not(unix))]
pub fn stop_at_user_signal() -> Result<()> {
    Ok(())
}

/// Returns the interrupting signals and their exit statuses, 128 plus the number as in shells. SIGHUP (the
/// terminal is gone) ends a program as SIGTERM does, unless `nohup` started it.
fn signals() -> Vec<(i32, i32)> {
    #[cfg(unix)]
    if !std::fs::read_to_string("/proc/self/status").is_ok_and(|status| ignores(&status, SIGHUP)) {
        return vec![(SIGINT, 130), (SIGTERM, 143), (SIGHUP, 143)];
    }
    vec![(SIGINT, 130), (SIGTERM, 143)]
}

/// Whether a process ignores a signal, by its `/proc/PID/status` of Linux: `SigIgn` is a hexadecimal mask.
#[cfg(unix)]
fn ignores(status: &str, signal: i32) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

/// Error of a command that a signal interrupted.
#[derive(Debug)]
pub struct Interrupted {
    what: String,
    /// Exit status of the program.
    pub status: u8,
}

impl Interrupted {
    /// Returns the error for the received signal; `what` describes what was completed.
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

/// Announces the expected duration if it is at least [`LONG`].
pub fn announce(what: &str, seconds: f64) {
    if seconds >= LONG.as_secs_f64() {
        terminal::note!("{what} will take about {}", duration(seconds));
    }
}

/// Progress of some work: a bar on a terminal, else a line from time to time.
#[derive(Clone)]
pub struct Bar {
    shown: ProgressBar,
    what: String,
    start: Instant,
    /// Units that were completed before the start.
    before: u64,
    pace: Arc<Mutex<Pace>>,
}

/// When the next line is due.
struct Pace {
    next: Duration,
    /// Whether the total duration was announced.
    is_estimated: bool,
}

/// Elapsed time from which on the total duration is estimated.
const ESTIMATE_AFTER: Duration = Duration::from_secs(3);
/// Minimum duration of work that is announced.
const LONG: Duration = Duration::from_secs(120);
/// Time of the first line without a terminal, and the longest time between two lines.
const FIRST_LINE: Duration = Duration::from_secs(10);
const BETWEEN_LINES: Duration = Duration::from_secs(60);

/// Units of a bar over fractions of some work; fine enough for an estimate from the first update.
pub const FRACTION_UNITS: u64 = 1_000_000_000;

/// Returns a bar over `length` units on standard error.
pub fn bar(length: u64, what: &str) -> Bar {
    new_bar(length, what, false)
}

/// Announces work of estimated duration and returns a bar over it, in thousandths of a second.
pub fn announced_bar(seconds: f64, what: &str) -> Bar {
    announce(what, seconds);
    new_bar(thousandths(seconds).max(1), what, true)
}

/// Converts estimated seconds to units of [`announced_bar`].
pub fn thousandths(seconds: f64) -> u64 {
    (1000.0 * seconds).round() as u64
}

fn new_bar(length: u64, what: &str, is_estimated: bool) -> Bar {
    let style =
        ProgressStyle::with_template("{prefix:>12} [{bar:32}] {percent:>3}%  {elapsed} done, {eta} left  {msg}");
    let shown = if terminal::is_quiet() { ProgressBar::hidden() } else { ProgressBar::new(length) };
    shown.set_length(length);
    shown.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
    shown.set_prefix(what.to_owned());
    terminal::show_above(&shown);
    let pace = Arc::new(Mutex::new(Pace { next: FIRST_LINE, is_estimated }));
    Bar { shown, what: what.to_owned(), start: Instant::now(), before: 0, pace }
}

impl Bar {
    /// Starts at `units`, whose time does not count.
    fn resuming_at(self, units: u64) -> Self {
        self.shown.set_position(units);
        self.shown.reset_eta();
        Self { before: units, ..self }
    }

    /// Sets the number of completed units.
    pub fn set_position(&self, position: u64) {
        self.shown.set_position(position);
        self.tell();
    }

    /// Adds completed units.
    pub fn inc(&self, units: u64) {
        self.shown.inc(units);
        self.tell();
    }

    /// Sets the text after the bar.
    pub fn set_message(&self, message: impl AsRef<str>) {
        self.shown.set_message(terminal::plain(message.as_ref()).into_owned());
        self.tell();
    }

    /// Adds the bar to others, below them.
    #[must_use]
    pub fn among(self, others: &MultiProgress) -> Self {
        Self { shown: others.add(self.shown), ..self }
    }

    /// Ends and clears the bar.
    pub fn finish_and_clear(&self) {
        self.shown.finish_and_clear();
    }

    /// Returns a function that shows a fraction in [0, 1] on a bar of [`FRACTION_UNITS`] units.
    pub fn fraction_setter(&self) -> impl Fn(f64) + Sync + use<> {
        let bar = self.clone();
        move |fraction| bar.set_position((FRACTION_UNITS as f64 * fraction) as u64)
    }

    /// Announces the total duration once it is known, if it is long; without a terminal, prints progress from
    /// time to time.
    fn tell(&self) {
        let elapsed = self.start.elapsed();
        if elapsed < ESTIMATE_AFTER {
            return;
        }
        let length = self.shown.length().unwrap_or(0).max(1);
        let position = self.shown.position();
        let left = seconds_left(elapsed.as_secs_f64(), self.before..position, length);
        let mut pace = self.pace.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(left) = left
            && !pace.is_estimated
        {
            pace.is_estimated = true;
            announce(&self.what, elapsed.as_secs_f64() + left);
        }
        if elapsed < pace.next || std::io::stderr().is_terminal() {
            return;
        }
        pace.next = elapsed + elapsed.min(BETWEEN_LINES);
        let left = left.map_or("time left unknown".to_owned(), |left| format!("about {} left", duration(left)));
        let message = self.shown.message();
        let message = if message.is_empty() { message } else { format!("; {message}") };
        terminal::progress(&format!(
            "{}: {:.0} %, {} done, {left}{message}",
            self.what,
            100.0 * position as f64 / length as f64,
            duration(elapsed.as_secs_f64())
        ));
    }
}

/// Estimates the time left from the units that were completed in `elapsed` seconds, of `length` in all.
fn seconds_left(elapsed: f64, completed: Range<u64>, length: u64) -> Option<f64> {
    let (new, rest) = (completed.end.saturating_sub(completed.start), length.saturating_sub(completed.end));
    (new > 0).then(|| elapsed * rest as f64 / new as f64)
}

/// A bar over training steps that starts at the second report: earlier work, such as the fit of a flow tail or
/// the compilation of a GPU's kernels in the first step, does not count as time of steps.
pub struct TrainingBar<'a> {
    what: &'a str,
    has_begun: Cell<bool>,
    bar: OnceCell<Bar>,
}

impl<'a> TrainingBar<'a> {
    /// Returns a bar that is not shown yet.
    pub fn new(what: &'a str) -> Self {
        Self { what, has_begun: Cell::new(false), bar: OnceCell::new() }
    }

    /// Shows a report.
    pub fn show(&self, progress: &Progress, message: impl AsRef<str>) {
        if !self.has_begun.replace(true) {
            return;
        }
        let bar = self.bar.get_or_init(|| bar(progress.steps as u64, self.what).resuming_at(progress.step as u64));
        bar.set_message(message);
        bar.set_position(progress.step as u64);
    }

    /// Ends and clears the bar.
    pub fn finish_and_clear(&self) {
        if let Some(bar) = self.bar.get() {
            bar.finish_and_clear();
        }
    }
}

/// Indicator of work without known progress: a spinner on a terminal, else a line from time to time. Dropping
/// it ends it.
pub struct Busy {
    shown: ProgressBar,
    end: Option<mpsc::Sender<()>>,
    teller: Option<JoinHandle<()>>,
}

/// Starts an indicator of work without known progress.
pub fn busy(what: &str) -> Busy {
    let shown = if terminal::is_quiet() { ProgressBar::hidden() } else { ProgressBar::new_spinner() };
    shown.set_prefix(what.to_owned());
    let style = ProgressStyle::with_template("{prefix:>12} {spinner} {elapsed} so far");
    shown.set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
    shown.enable_steady_tick(Duration::from_millis(200));
    terminal::show_above(&shown);
    let (end, ended) = mpsc::channel::<()>();
    let (what, start) = (what.to_owned(), Instant::now());
    let tell = move || {
        let mut next = FIRST_LINE;
        // The sender is dropped when the work is done.
        while ended.recv_timeout(next) == Err(mpsc::RecvTimeoutError::Timeout) {
            if !std::io::stderr().is_terminal() {
                terminal::progress(&format!("{what}: {} so far", duration(start.elapsed().as_secs_f64())));
            }
            next = start.elapsed().min(BETWEEN_LINES);
        }
    };
    Busy { shown, end: Some(end), teller: Some(std::thread::spawn(tell)) }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.shown.finish_and_clear();
        drop(self.end.take());
        if let Some(teller) = self.teller.take() {
            // The thread only waits and prints.
            drop(teller.join());
        }
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn units_of_an_earlier_command_do_not_count_as_done_in_this_time() {
        assert_eq!(seconds_left(10.0, 700..710, 1000), Some(290.0));
        assert_eq!((seconds_left(10.0, 700..700, 1000), seconds_left(1.0, 0..8, 4)), (None, Some(0.0)));
    }

    #[test]
    fn ignored_signals_are_read_from_the_mask() {
        let status = |mask: &str| format!("Name:\theadtail\nSigBlk:\tffffffffffffffff\nSigIgn:\t{mask}\nSigCgt:\t0\n");
        assert!(ignores(&status("0000000000001001"), SIGHUP));
        assert!(!ignores(&status("0000000000001002"), SIGHUP) && ignores(&status("0000000000001002"), SIGINT));
        assert!(!ignores("SigIgn:\tmany\n", SIGHUP) && !ignores("", SIGHUP));
    }
}
