//! Messages on standard output, on standard error and in the file of `--log`.
//!
//! Printing never affects results. A closed pipe is not an error; a full device is one, reported after all
//! other work. Control characters are escaped, so that nothing in a file can act on the terminal.

use std::{
    borrow::Cow,
    fmt,
    fs::{File, OpenOptions},
    io::{self, ErrorKind, IsTerminal, Read, Write},
    path::{Path, PathBuf},
    sync::{
        Mutex, OnceLock, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::Instant,
};

use anyhow::{Context, Result, ensure};
use clap::Args;
use headtail_render::remark::Remark;
use indicatif::{ProgressBar, WeakProgressBar};

/// Amount of messages, and a log file.
#[derive(Args, Clone, Debug, Default)]
pub struct Voice {
    /// Print only data, warnings and errors.
    #[arg(short, long, global = true, conflicts_with = "verbose", help_heading = "Messages")]
    quiet: bool,
    /// Treat warnings about input files as errors.
    #[arg(long, global = true, help_heading = "Messages")]
    strict: bool,
    /// Print what is opened and written, and the memory that it takes.
    #[arg(short, long, global = true, help_heading = "Messages")]
    verbose: bool,
    /// Append all messages to a file, with the seconds since the start.
    #[arg(long, global = true, value_name = "FILE", help_heading = "Messages")]
    log: Option<PathBuf>,
}

/// The state of the program's output.
struct Terminal {
    voice: Voice,
    start: Instant,
    log: Option<Mutex<File>>,
}

static ONLY_DATA: AtomicBool = AtomicBool::new(false);
static TERMINAL: OnceLock<Terminal> = OnceLock::new();
/// The first error of standard output other than a closed pipe.
static FAILURE: Mutex<Option<io::Error>> = Mutex::new(None);
/// The bars that are shown; messages are printed above the last one.
static SHOWN: Mutex<Vec<WeakProgressBar>> = Mutex::new(Vec::new());

/// Prints data on standard output, as a line.
macro_rules! out {
    ($($argument:tt)*) => { $crate::terminal::print_data(format_args!($($argument)*)) };
}
/// Reports a completed action on standard output, as a line; `--quiet` omits it.
macro_rules! say {
    ($($argument:tt)*) => { $crate::terminal::print_done(format_args!($($argument)*)) };
}
/// Prints a note on standard error; `--quiet` omits it.
macro_rules! note {
    ($($argument:tt)*) => { $crate::terminal::print_note(format_args!($($argument)*)) };
}
/// Warns on standard error.
macro_rules! warning {
    ($($argument:tt)*) => { $crate::terminal::print_warning(format_args!($($argument)*)) };
}
/// Prints a detail on standard error, with `--verbose`.
macro_rules! detail {
    ($($argument:tt)*) => { $crate::terminal::print_detail(format_args!($($argument)*)) };
}
pub(crate) use {detail, note, out, say, warning};

impl Voice {
    /// Applies these settings to the program and opens the log, whose first line is the command.
    ///
    /// # Errors
    /// If the log cannot be opened.
    pub fn begin(&self) -> Result<()> {
        let open = |path: &PathBuf| {
            ensure!(is_log(path), "--log {}: the file is not a log of headtail; name another", path.display());
            let file = OpenOptions::new().create(true).append(true).open(path);
            file.with_context(|| format!("--log {}", path.display())).map(Mutex::new)
        };
        let log = self.log.as_ref().map(open).transpose()?;
        TERMINAL.get_or_init(|| Terminal { voice: self.clone(), start: Instant::now(), log });
        log_line("start", &format!("headtail {}: {}", env!("CARGO_PKG_VERSION"), command()));
        Ok(())
    }
}

/// The text after the time in the first line of a log.
const FIRST_LINE: &[u8] = b" s  start    headtail ";

/// Whether messages may be appended to a file: to a log or an empty file, but to no other regular file, which
/// may be an input.
fn is_log(path: &Path) -> bool {
    let Ok((file, size)) = headtail_render::file::open_regular(path) else { return true };
    let mut start = Vec::new();
    let is_read = file.take(10 + FIRST_LINE.len() as u64).read_to_end(&mut start).is_ok();
    size == 0 || is_read && start.ends_with(FIRST_LINE)
}

/// Whether only data, warnings and errors are printed.
pub fn is_quiet() -> bool {
    TERMINAL.get().is_some_and(|terminal| terminal.voice.quiet)
}

/// Reserves standard output for data from now on.
pub fn only_data() {
    ONLY_DATA.store(true, Ordering::Relaxed);
}

/// Prints a value as JSON on standard output.
///
/// # Errors
/// If it cannot be written as JSON.
pub fn print_json(value: &impl serde::Serialize) -> Result<()> {
    print(&serde_json::to_string_pretty(value)?);
    Ok(())
}

/// See [`out!`].
pub fn print_data(text: fmt::Arguments<'_>) {
    print(&text.to_string());
}

/// See [`say!`].
pub fn print_done(text: fmt::Arguments<'_>) {
    let text = text.to_string();
    log_line("done", &text);
    if !is_quiet() && !ONLY_DATA.load(Ordering::Relaxed) {
        print(&text);
    }
}

/// See [`note!`].
pub fn print_note(text: fmt::Arguments<'_>) {
    message("note", &text.to_string(), !is_quiet());
}

/// See [`warning!`].
pub fn print_warning(text: fmt::Arguments<'_>) {
    message("warning", &text.to_string(), true);
}

/// Prints a remark about a file: a note, or a warning, which `--strict` makes an error.
///
/// # Errors
/// The warning, with `--strict`.
pub fn say_remark(file: &str, remark: &Remark) -> Result<()> {
    match remark {
        Remark::Note(text) => note!("{file}: {text}"),
        Remark::Warning(text) if TERMINAL.get().is_some_and(|terminal| terminal.voice.strict) => {
            anyhow::bail!("{file}: {text} (--strict)")
        }
        Remark::Warning(text) => warning!("{file}: {text}"),
    }
    Ok(())
}

/// See [`detail!`].
pub fn print_detail(text: fmt::Arguments<'_>) {
    message("detail", &text.to_string(), TERMINAL.get().is_some_and(|terminal| terminal.voice.verbose));
}

/// Prints the error that ends the program.
pub fn error(kind: &str, text: &str) {
    message(kind, &in_words(&text.replace('\n', " ")), true);
}

/// Prints a message of the argument parser and returns the exit status: help goes to standard output,
/// mistakes to standard error with status 2.
pub fn usage(error: &clap::Error) -> u8 {
    let is_terminal = io::stderr().is_terminal();
    let text = error.render();
    match error.use_stderr() {
        false => print(text.to_string().trim_end()),
        true if is_terminal => drop(write!(io::stderr(), "{}", in_words(&text.ansi().to_string()))),
        true => drop(write!(io::stderr(), "{}", in_words(&text.to_string()))),
    }
    error.exit_code() as u8
}

/// Replaces Rust's terms in parser errors by plain words.
fn in_words(text: &str) -> String {
    const WORDS: [(&str, &str); 16] = [
        ("number too large to fit in target type", "the number is too large"),
        ("number too small to fit in target type", "the number is too small"),
        ("invalid digit found in string", "not a whole number"),
        ("invalid float literal", "not a number"),
        ("cannot parse integer from empty string", "it is empty"),
        ("cannot parse float from empty string", "it is empty"),
        ("expected usize", "expected a whole number"),
        ("expected u64", "expected a whole number"),
        ("expected u32", "expected a whole number"),
        ("expected i64", "expected a whole number"),
        ("expected f32", "expected a number"),
        ("expected f64", "expected a number"),
        ("expected a sequence", "expected a list"),
        ("expected a string", "expected a text"),
        ("expected a boolean", "expected true or false"),
        ("invalid type: string", "found the text"),
    ];
    WORDS.iter().fold(text.to_owned(), |text, (from, to)| text.replace(from, to))
}

/// Prints a line of progress on a standard error that is not a terminal.
pub fn progress(text: &str) {
    log_line("progress", text);
    if !is_quiet() {
        print_error(text);
    }
}

/// Makes messages appear above a bar while it is shown.
pub fn show_above(bar: &ProgressBar) {
    SHOWN.lock().unwrap_or_else(PoisonError::into_inner).push(bar.downgrade());
}

/// Flushes standard output.
///
/// # Errors
/// If part of it was lost, other than to a closed pipe.
pub fn finish() -> Result<()> {
    if let Err(error) = io::stdout().flush() {
        remember(error);
    }
    match FAILURE.lock().unwrap_or_else(PoisonError::into_inner).take() {
        Some(error) => Err(error).context("standard output is incomplete (all files are written)"),
        None => Ok(()),
    }
}

/// Returns the command line, quoted for a shell, with `headtail` as the program. Bytes that are not UTF-8 are
/// replaced.
pub fn command() -> String {
    let quote = |argument: std::ffi::OsString| {
        let argument = argument.to_string_lossy().into_owned();
        let plain =
            !argument.is_empty() && argument.chars().all(|c| c.is_ascii_alphanumeric() || "-_./:,=+".contains(c));
        if plain { argument } else { format!("'{}'", argument.replace('\'', "'\\''")) }
    };
    std::iter::once("headtail".to_owned()).chain(std::env::args_os().skip(1).map(quote)).collect::<Vec<_>>().join(" ")
}

/// Escapes control characters as in JSON, so that a text cannot move a cursor or change the writing
/// direction. Line feeds and tabs stay.
pub fn plain(text: &str) -> Cow<'_, str> {
    let acts = |c: char| {
        c.is_control() && c != '\n' && c != '\t'
            || matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{61c}')
    };
    if !text.contains(acts) {
        return Cow::Borrowed(text);
    }
    let mut escaped = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match acts(c) {
            true => escaped += &format!("\\u{:04x}", u32::from(c)),
            false => escaped.push(c),
        }
    }
    Cow::Owned(escaped)
}

fn message(kind: &str, text: &str, is_shown: bool) {
    log_line(kind, text);
    if is_shown {
        print_error(&format!("{kind}: {text}"));
    }
}

fn print(text: &str) {
    above_bar(|| {
        if let Err(error) = writeln!(io::stdout(), "{}", plain(text)) {
            remember(error);
        }
    });
}

fn print_error(text: &str) {
    // A failure to write to standard error cannot be reported.
    above_bar(|| drop(writeln!(io::stderr(), "{}", plain(text))));
}

fn above_bar(print: impl FnOnce()) {
    // The last one still shown: nested work has its own bar.
    let bar = {
        let mut shown = SHOWN.lock().unwrap_or_else(PoisonError::into_inner);
        shown.retain(|bar| bar.upgrade().is_some_and(|bar| !bar.is_finished()));
        shown.last().and_then(WeakProgressBar::upgrade)
    };
    match bar {
        Some(bar) => bar.suspend(print),
        None => print(),
    }
}

fn remember(error: io::Error) {
    if error.kind() != ErrorKind::BrokenPipe {
        FAILURE.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    }
}

fn log_line(kind: &str, text: &str) {
    let Some((terminal, log)) = TERMINAL.get().and_then(|terminal| Some((terminal, terminal.log.as_ref()?))) else {
        return;
    };
    let mut log = log.lock().unwrap_or_else(PoisonError::into_inner);
    // A full log must not cost results.
    drop(writeln!(log, "{:10.1} s  {kind:8} {}", terminal.start.elapsed().as_secs_f64(), plain(text)));
}

/// Returns version, features, instruction set and target.
pub fn long_version() -> &'static str {
    static TEXT: OnceLock<String> = OnceLock::new();
    TEXT.get_or_init(|| {
        let features = [
            ("ndarray", cfg!(feature = "ndarray")),
            ("flex", cfg!(feature = "flex")),
            ("wgpu", cfg!(feature = "wgpu")),
        ];
        let features: Vec<&str> = features.iter().filter(|(_, has)| *has).map(|(name, _)| *name).collect();
        let instructions = match headtail_render::simd::instruction_set() {
            Ok(set) => set.to_string(),
            Err(error) => error.to_string(),
        };
        format!(
            "{}\nfeatures: {}\ninstruction set: {instructions}\ntarget: {}-{}",
            env!("CARGO_PKG_VERSION"),
            if features.is_empty() { "none".to_owned() } else { features.join(", ") },
            std::env::consts::ARCH,
            std::env::consts::OS,
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rust_types_are_replaced_by_plain_words() {
        let said = in_words("--set steps: invalid type: string \"x\", expected usize");
        assert_eq!(said, "--set steps: found the text \"x\", expected a whole number");
    }

    #[test]
    fn control_characters_are_escaped() {
        assert_eq!(plain("a\x1b[2Jb\r\u{9b}c\u{202e}\n\t"), "a\\u001b[2Jb\\u000d\\u009bc\\u202e\n\t");
        assert!(matches!(plain("plain \u{e4} \u{d7}\n"), Cow::Borrowed(_)));
    }
}
