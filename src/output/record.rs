//! The record of a folder: which command made which of its files.

use std::{
    fmt,
    fs::{File, OpenOptions},
    io::{BufRead, BufReader, Result, Write},
    path::Path,
    time::Duration,
};

/// The record's name.
pub const RECORD: &str = ".headtail";

/// A line: REQUEST, perhaps with `:DIGEST`, and NAME after a space.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// What tells the command from others.
    pub request: String,
    /// What the file held when the command was done with it, if that counts.
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

/// The right to write a folder's record, if nobody has it for long: whoever adds a line has it for a moment.
///
/// # Errors
/// If the record cannot be opened.
pub fn lock(folder: &Path) -> Result<Option<File>> {
    for _ in 0..5 {
        let lock = super::lock_file(&folder.join(RECORD))?;
        if lock.is_some() {
            return Ok(lock);
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    Ok(None)
}

/// All entries, the latest last.
pub fn entries(record: &File) -> Vec<Entry> {
    BufReader::new(record).lines().map_while(Result::ok).filter_map(|line| Entry::parse(&line)).collect()
}

/// The latest entry of a file.
pub fn latest<'a>(entries: &'a [Entry], name: &str) -> Option<&'a Entry> {
    entries.iter().rfind(|entry| entry.name == name)
}

/// Writes all entries anew.
pub fn write(record: &File, entries: &[Entry]) -> Result<()> {
    record.set_len(0)?;
    entries.iter().try_for_each(|entry| add(record, entry))
}

/// Adds an entry at the end.
pub fn add(mut record: &File, entry: &Entry) -> Result<()> {
    // At once, so that lines of two processes do not mix.
    record.write_all(format!("{entry}\n").as_bytes())
}

/// Adds an entry to a folder's record in place of others of the file; after them, while another process has the record.
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
