//! Progress bars with the time left, and interruption by Ctrl-C.

use std::sync::{Arc, atomic::AtomicBool};

use anyhow::{Context, Result};
use indicatif::{ProgressBar, ProgressStyle};
use signal_hook::{
    consts::{SIGINT, SIGTERM},
    flag,
};

/// A flag that SIGINT and SIGTERM set; a second signal ends the process at once.
pub fn stop_flag() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        flag::register_conditional_shutdown(signal, 130, stop.clone()).context("signal handler")?;
        flag::register(signal, stop.clone()).context("signal handler")?;
    }
    Ok(stop)
}

/// A bar over `length` units on standard error; silent where that is no terminal.
pub fn bar(length: u64, what: &str) -> ProgressBar {
    let style =
        ProgressStyle::with_template("{prefix:>12} [{bar:32}] {percent:>3}%  {elapsed} done, {eta} left  {msg}");
    let bar = ProgressBar::new(length);
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
    bar.set_prefix(what.to_owned());
    bar
}
