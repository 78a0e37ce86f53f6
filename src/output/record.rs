//! The record of a folder: its files, and the commands that made them.

use std::{
    fmt,
    fs::{File, OpenOptions},
    io::{BufRead, BufReader, Result, Write},
    path::Path,
    time::Duration,
};

/// File name of the record.
pub const RECORD: &str = ".headtail";

/// A line: REQUEST, optionally followed by `:DIGEST`, a space and NAME.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Identifies the command.
    pub request: String,
    /// Hash of the file's final content, if it is checked.
    pub digest: Option<String>,
    /// The file.
    pub name: String,
}

impl Entry {
    fn parse(line: &str) -> Option<Self> {
        let (by, name) = line.split_once(' ')?;
        let (request, digest) = by.split_once(':').map_or((by, None), |(request, digest)| (request, Some(digest)));
        Some(Self { request: request.to_owned(), digest: digest.map(str::to_owned), name: name.to_owned() })
    }
}

impl fmt::Display for Entry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digest = self.digest.iter().map(|digest| format!(":{digest}")).collect::<String>();
        write!(f, "{}{digest} {}", self.request, self.name)
    }
}

/// Locks a folder's record for writing; retries for a moment, because adding a line also takes the lock.
///
/// # Errors
/// If the record cannot be opened.
pub fn lock(folder: &Path) -> Result<Option<File>> {
    for _ in 0..5 {
        let lock = super::lock::lock_file(&folder.join(RECORD))?;
        if lock.is_some() {
            return Ok(lock);
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    Ok(None)
}

/// Returns all entries, the latest last.
pub fn entries(record: &File) -> Vec<Entry> {
    BufReader::new(record).lines().map_while(Result::ok).filter_map(|line| Entry::parse(&line)).collect()
}

/// Returns the latest entry of a file.
pub fn latest<'a>(entries: &'a [Entry], name: &str) -> Option<&'a Entry> {
    entries.iter().rfind(|entry| entry.name == name)
}

/// Replaces all entries.
pub fn write(record: &File, entries: &[Entry]) -> Result<()> {
    record.set_len(0)?;
    entries.iter().try_for_each(|entry| add(record, entry))
}

/// Appends an entry.
pub fn add(mut record: &File, entry: &Entry) -> Result<()> {
    // In one write, so that lines of two processes do not mix.
    record.write_all(format!("{entry}\n").as_bytes())
}

/// Replaces the entries of a file in a folder's record by a new one; appends it if another process holds the
/// record.
///
/// # Errors
/// If the record cannot be written.
pub fn replace(folder: &Path, entry: &Entry) -> Result<()> {
    match lock(folder)? {
        Some(record) => {
            let mut entries = entries(&record);
            entries.retain(|known| known.name != entry.name);
            entries.push(entry.clone());
            write(&record, &entries)
        }
        None => add(&OpenOptions::new().append(true).open(folder.join(RECORD))?, entry),
    }
}
