//! Journals of workers: each writes a file of its own, one complete line at a time; readers merge them.
//!
//! Events of a trial are ordered by the number of its attempt, which a worker chooses while it holds the
//! trial's lock. Clocks of machines differ and order nothing.

use std::{
    collections::{BTreeMap, HashMap},
    fs::{self, File, OpenOptions},
    io::{ErrorKind, Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    time::{SystemTime, UNIX_EPOCH},
};

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};

use super::{record::Record, space::Assignment};
use crate::run::Measures;

/// One line of a journal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Line {
    /// Seconds since 1970, for people.
    pub time: f64,
    /// Event.
    #[serde(flatten)]
    pub event: Event,
}

/// An event in a sweep.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "lowercase")]
pub enum Event {
    /// Adaptive search has made a configuration.
    Suggested {
        /// Index of the configuration.
        number: u64,
        /// Configuration.
        assignment: Assignment,
    },
    /// A worker started on a trial.
    Started {
        /// Identity of the trial.
        trial: String,
        /// Number of the attempt.
        #[serde(default)]
        attempt: u64,
        /// Steps done earlier.
        step: usize,
    },
    /// A worker was asked to stop, and left a checkpoint.
    Stopped {
        /// Identity of the trial.
        trial: String,
        /// Number of the attempt.
        #[serde(default)]
        attempt: u64,
        /// Steps done.
        step: usize,
        /// Seconds since it started.
        seconds: f64,
    },
    /// A trial reached a rung.
    Rung {
        /// Identity of the trial.
        trial: String,
        /// Number of the attempt.
        #[serde(default)]
        attempt: u64,
        /// Steps done.
        step: usize,
        /// Validation figures at the rung.
        measures: Measures,
        /// Seconds since it started.
        seconds: f64,
    },
    /// A trial is complete.
    Done {
        /// Identity of the trial.
        trial: String,
        /// Number of the attempt.
        #[serde(default)]
        attempt: u64,
        /// All measurements.
        measures: Measures,
        /// Seconds since it started.
        seconds: f64,
    },
    /// A trial ended with an error.
    Failed {
        /// Identity of the trial.
        trial: String,
        /// Number of the attempt.
        #[serde(default)]
        attempt: u64,
        /// Error.
        reason: String,
    },
    /// A failed trial may run again.
    Retry {
        /// Identity of the trial.
        trial: String,
        /// The last attempt that the retry is for.
        #[serde(default)]
        attempt: u64,
    },
}

/// Journal of one worker.
pub struct Journal {
    file: File,
    path: PathBuf,
}

impl Journal {
    /// Creates a file with a name that no other worker has.
    ///
    /// # Errors
    /// If the folder or the file cannot be created.
    pub fn create(folder: &Path) -> Result<Self> {
        fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
        let host: String = host.trim().chars().filter(|c| c.is_ascii_alphanumeric() || *c == '-').collect();
        let started = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos();
        for number in 0.. {
            let path = folder.join(format!("{started:x}-{host}-{}-{number}.jsonl", std::process::id()));
            match OpenOptions::new().append(true).create_new(true).open(&path) {
                Ok(file) => return Ok(Self { file, path }),
                // After a clock was set back.
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error).with_context(|| path.display().to_string()),
            }
        }
        unreachable!("there is always another number")
    }

    /// Writes a complete line and flushes it to disk.
    ///
    /// # Errors
    /// If the write fails.
    pub fn add(&mut self, event: Event) -> Result<()> {
        let line = serde_json::to_string(&Line { time: now(), event })? + "\n";
        let written = self.file.write_all(line.as_bytes()).and_then(|()| self.file.sync_data());
        written.with_context(|| self.path.display().to_string())
    }
}

/// Seconds since 1970.
pub fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64()
}

/// All journals of a folder, merged. The order of files, and of lines of different files, does not matter.
#[derive(Debug, Default)]
pub struct Ledger {
    folder: PathBuf,
    /// Number of bytes read of each file.
    read: HashMap<PathBuf, u64>,
    /// Records by the trials' identities.
    pub records: HashMap<String, Record>,
    suggested: BTreeMap<u64, Assignment>,
}

impl Ledger {
    /// Reads all journals.
    ///
    /// # Errors
    /// If an existing file cannot be read.
    pub fn open(folder: &Path) -> Result<Self> {
        let mut ledger = Self { folder: folder.to_owned(), ..Self::default() };
        ledger.refresh()?;
        Ok(ledger)
    }

    /// Reads lines added since the last call.
    ///
    /// # Errors
    /// If an existing file cannot be read.
    pub fn refresh(&mut self) -> Result<()> {
        let Ok(entries) = fs::read_dir(&self.folder) else { return Ok(()) };
        for entry in entries.filter_map(std::result::Result::ok) {
            let path = entry.path();
            if path.extension().is_some_and(|extension| extension == "jsonl") {
                self.read_on(&path).with_context(|| path.display().to_string())?;
            }
        }
        Ok(())
    }

    /// Reads the new complete lines of a file; a line without its end is still being written, or was torn by
    /// a kill.
    fn read_on(&mut self, path: &Path) -> std::io::Result<()> {
        let offset = self.read.get(path).copied().unwrap_or(0);
        let mut file = File::open(path)?;
        if file.metadata()?.len() <= offset {
            return Ok(());
        }
        file.seek(SeekFrom::Start(offset))?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes)?;
        let whole = bytes.iter().rposition(|&byte| byte == b'\n').map_or(0, |end| end + 1);
        for line in bytes[..whole].split(|&byte| byte == b'\n') {
            // Skips lines of other versions.
            if let Ok(line) = serde_json::from_slice::<Line>(line) {
                self.add(line);
            }
        }
        self.read.insert(path.to_owned(), offset + whole as u64);
        Ok(())
    }

    fn add(&mut self, Line { event, .. }: Line) {
        match event {
            Event::Suggested { number, assignment } => {
                self.suggested.entry(number).or_insert(assignment);
            }
            Event::Started { trial, attempt, step } => self.of(trial).start(attempt, step),
            Event::Stopped { trial, attempt, seconds, .. } => self.of(trial).end(attempt, seconds),
            Event::Rung { trial, attempt, step, measures, seconds } => {
                let record = self.of(trial);
                record.end(attempt, seconds);
                record.rungs.insert(step, measures);
            }
            Event::Done { trial, attempt, measures, seconds } => {
                let record = self.of(trial);
                record.end(attempt, seconds);
                record.done = Some(measures);
            }
            Event::Failed { trial, attempt, reason } => self.of(trial).fail(attempt, reason),
            Event::Retry { trial, attempt } => self.of(trial).retry(attempt),
        }
    }

    fn of(&mut self, trial: String) -> &mut Record {
        self.records.entry(trial).or_default()
    }

    /// Returns the record of a trial.
    pub fn record(&self, trial: &str) -> Option<&Record> {
        self.records.get(trial)
    }

    /// Returns the suggested configurations in order.
    pub fn suggested(&self) -> Vec<Assignment> {
        self.suggested.values().cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A line with a clock that is wrong by `clock` seconds.
    fn event(clock: f64, event: Event) -> Line {
        Line { time: now() + clock, event }
    }

    fn started(attempt: u64, step: usize) -> Line {
        event(0.0, Event::Started { trial: "a".into(), attempt, step })
    }

    fn failed(attempt: u64, reason: &str) -> Event {
        Event::Failed { trial: "a".into(), attempt, reason: reason.into() }
    }

    fn ledger(lines: impl IntoIterator<Item = Line>) -> Ledger {
        let mut ledger = Ledger::default();
        lines.into_iter().for_each(|line| ledger.add(line));
        ledger
    }

    #[test]
    fn torn_lines_are_skipped_and_hide_no_others() {
        let folder = tempfile::tempdir().unwrap();
        let mut journal = Journal::create(folder.path()).unwrap();
        journal.add(Event::Started { trial: "a".into(), attempt: 1, step: 0 }).unwrap();
        let path = journal.path.clone();
        let torn = "{\"time\":1.0,\"event\":\"done\",\"trial\":\"a\",\"measu";
        journal.file.write_all(torn.as_bytes()).unwrap();
        let mut ledger = Ledger::open(folder.path()).unwrap();
        assert!(ledger.records["a"].done.is_none() && ledger.records["a"].is_open());
        // The worker that follows a kill has a file of its own.
        let mut other = Journal::create(folder.path()).unwrap();
        other.add(Event::Done { trial: "a".into(), attempt: 2, measures: Measures::new(), seconds: 2.0 }).unwrap();
        ledger.refresh().unwrap();
        assert!(ledger.records["a"].done.is_some());
        // A line whose end is late is read once it is complete.
        let rest = &torn.replace("measu", "measures\":{},\"seconds\":3.0}\n")[torn.len()..];
        OpenOptions::new().append(true).open(path).unwrap().write_all(rest.as_bytes()).unwrap();
        ledger.refresh().unwrap();
        assert_eq!(ledger.records["a"].seconds, 5.0);
    }

    #[test]
    fn neither_clocks_nor_the_order_of_files_matter() {
        for clock in [-600.0, 0.0, 600.0] {
            let failure = event(clock, failed(1, "no"));
            let retry = event(0.0, Event::Retry { trial: "a".into(), attempt: 1 });
            let again = event(clock, failed(2, "still"));
            for lines in [[failure.clone(), retry.clone()], [retry.clone(), failure.clone()]] {
                assert_eq!(ledger(lines).records["a"].failure(), None, "{clock}");
            }
            for lines in [[again.clone(), retry.clone(), failure.clone()], [failure, retry, again]] {
                let ledger = ledger(lines);
                let record = &ledger.records["a"];
                assert_eq!((record.failure().as_deref(), record.attempt()), (Some("still"), 2), "{clock}");
            }
        }
    }

    #[test]
    fn work_is_open_from_a_start_to_the_end_of_its_attempt() {
        for clock in [-600.0, 600.0] {
            let stopped =
                |attempt: u64| event(clock, Event::Stopped { trial: "a".into(), attempt, step: 0, seconds: 1.0 });
            assert!(ledger([started(1, 0)]).records["a"].is_open());
            assert!(!ledger([stopped(1), started(1, 0)]).records["a"].is_open());
            assert!(ledger([started(2, 0), stopped(1), started(1, 0)]).records["a"].is_open());
            assert!(!ledger([event(clock, failed(2, "no")), started(2, 0), started(1, 0)]).records["a"].is_open());
        }
    }

    /// As written by versions without numbers of attempts.
    #[test]
    fn journals_without_attempts_are_read() {
        let line = |event: &str| {
            let text = format!("{{\"time\":9e9,\"event\":{event},\"trial\":\"a\"}}");
            serde_json::from_str::<Line>(&text).unwrap()
        };
        let [start, failure] = [line("\"started\",\"step\":0"), line("\"failed\",\"reason\":\"no\"")];
        let retry = line("\"retry\"");
        let old = ledger([start.clone(), failure.clone()]);
        assert_eq!(old.records["a"].failure().as_deref(), Some("no"));
        let mut old = ledger([retry, failure, start]);
        assert_eq!((old.records["a"].failure(), old.records["a"].attempt()), (None, 0));
        old.add(event(0.0, failed(1, "still")));
        assert_eq!(old.records["a"].failure().as_deref(), Some("still"));
    }

    #[test]
    fn repeated_starts_without_an_end_count_as_failure() {
        let starts = |steps: &[usize]| ledger((1..).zip(steps).map(|(attempt, &step)| started(attempt, step)));
        assert!(starts(&[0; 5]).records["a"].failure().is_none());
        let mut lost = starts(&[7; 6]);
        assert!(lost.records["a"].failure().unwrap().contains("after step 7"));
        assert!(starts(&[0, 0, 0, 5, 5, 5, 9, 9]).records["a"].failure().is_none(), "it gets on");
        let stopped = event(0.0, Event::Stopped { trial: "a".into(), attempt: 9, step: 0, seconds: 1.0 });
        assert!(ledger((1..=9).map(|k| started(k, 0)).chain([stopped])).records["a"].failure().is_none());
        lost.add(event(0.0, Event::Retry { trial: "a".into(), attempt: 6 }));
        assert!(lost.records["a"].failure().is_none());
    }
}
