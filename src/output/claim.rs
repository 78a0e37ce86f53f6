//! Exclusive claims on file systems without locks: a file that only one process can create.
//!
//! The holder touches the file every [`BEAT`]. A claim whose process is gone from this machine, or that
//! another machine was seen not to touch for [`Claim::DEAD`], may be taken over: by one process at a time,
//! which a second claim ensures. Only this process's monotonic clock measures time, since wall clocks of
//! machines differ.

use std::{
    collections::BTreeMap,
    fs::{self, File, FileTimes, OpenOptions},
    io::{ErrorKind, Result, Write},
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{self, RecvTimeoutError, Sender},
    },
    thread,
    time::{Duration, Instant, SystemTime},
};

/// Interval at which a holder touches its file.
const BEAT: Duration = Duration::from_secs(20);

/// Times of change of other holders' files, and when this process first saw them.
static SEEN: Mutex<BTreeMap<PathBuf, (SystemTime, Instant)>> = Mutex::new(BTreeMap::new());

/// An exclusive claim, held until it is dropped.
#[derive(Debug)]
pub struct Claim {
    path: PathBuf,
    /// Dropping it ends the touching.
    _beat: Sender<()>,
}

impl Claim {
    /// Time without a touch after which a holder on another machine counts as gone: caches of network file
    /// systems show changes within a minute.
    pub const DEAD: Duration = Duration::from_secs(300);

    /// Takes the claim; `None` if another process holds it.
    ///
    /// # Errors
    /// If the file cannot be created for any reason other than that it exists.
    pub fn take(path: &Path) -> Result<Option<Self>> {
        if let Some(claim) = Self::create(path)? {
            return Ok(Some(claim));
        }
        if !is_abandoned(path) {
            return Ok(None);
        }
        let takeover = with_ending(path, ".takeover");
        if is_abandoned(&takeover) {
            drop(fs::remove_file(&takeover));
        }
        let Some(_alone) = Self::create(&takeover)? else { return Ok(None) };
        // Another process may have taken it over in the meantime.
        if is_abandoned(path) {
            drop(fs::remove_file(path));
        }
        Self::create(path)
    }

    /// Whether a process holds the claim.
    pub fn is_taken(path: &Path) -> bool {
        path.exists() && !is_abandoned(path)
    }

    fn create(path: &Path) -> Result<Option<Self>> {
        let mut file = match OpenOptions::new().write(true).create_new(true).open(path) {
            Ok(file) => file,
            Err(error) if error.kind() == ErrorKind::AlreadyExists => return Ok(None),
            Err(error) => return Err(error),
        };
        file.write_all(own_name().as_bytes())?;
        let (beat, end) = mpsc::channel();
        let file = Arc::new(file);
        thread::spawn(move || {
            while end.recv_timeout(BEAT) == Err(RecvTimeoutError::Timeout) {
                drop(touch(&file));
            }
        });
        Ok(Some(Self { path: path.to_owned(), _beat: beat }))
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        // Unless it was taken over while this process was suspended.
        if fs::read_to_string(&self.path).is_ok_and(|holder| holder == own_name()) {
            drop(fs::remove_file(&self.path));
        }
    }
}

fn touch(file: &File) -> Result<()> {
    file.set_times(FileTimes::new().set_modified(SystemTime::now()))
}

fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    name.into()
}

/// Returns the names of this machine and this process.
fn own_name() -> String {
    format!("{}\n{}\n", machine(), std::process::id())
}

/// Returns the names of the machine and of its current boot, without which process numbers are ambiguous.
fn machine() -> String {
    let read = |path: &str| fs::read_to_string(path).unwrap_or_default().trim().to_owned();
    format!("{} {}", read("/proc/sys/kernel/hostname"), read("/proc/sys/kernel/random/boot_id"))
}

/// Whether the holder of a file is gone. A file without a readable holder may not be written yet, and counts
/// as one of another machine.
fn is_abandoned(path: &Path) -> bool {
    let Ok(metadata) = fs::metadata(path) else { return false };
    let holder = fs::read_to_string(path).unwrap_or_default();
    let mut lines = holder.lines();
    match (lines.next(), lines.next().and_then(|number| number.parse::<u32>().ok())) {
        (Some(name), Some(number)) if name == machine() && Path::new("/proc/self").exists() => {
            !Path::new(&format!("/proc/{number}")).exists()
        }
        _ => metadata.modified().is_ok_and(|touched| unchanged_for(path, touched) > Claim::DEAD),
    }
}

/// Returns how long this process has seen a file with this time of change.
fn unchanged_for(path: &Path, touched: SystemTime) -> Duration {
    let mut seen = SEEN.lock().unwrap_or_else(PoisonError::into_inner);
    let (known, since) = seen.entry(path.to_owned()).or_insert_with(|| (touched, Instant::now()));
    if *known != touched {
        (*known, *since) = (touched, Instant::now());
    }
    since.elapsed()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_one_of_many_holds_the_claim() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("claim");
        let taken: usize = thread::scope(|scope| {
            let takers: Vec<_> = (0..16).map(|_| scope.spawn(|| Claim::take(&path).unwrap())).collect();
            let claims: Vec<_> = takers.into_iter().map(|taker| taker.join().unwrap()).collect();
            assert!(Claim::is_taken(&path));
            claims.iter().flatten().count()
        });
        assert_eq!(taken, 1);
        assert!(!path.exists() && Claim::take(&path).unwrap().is_some());
    }

    #[test]
    fn abandoned_claims_are_taken_over() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("claim");
        // No process has this number.
        fs::write(&path, format!("{}\n{}\n", machine(), u32::MAX)).unwrap();
        assert!(!Claim::is_taken(&path));
        let claim = Claim::take(&path).unwrap();
        assert!(claim.is_some() && Claim::take(&path).unwrap().is_none());
        drop(claim);

        // From another machine, whose clock may be days off: only the time without a change counts.
        fs::write(&path, "elsewhere 1\n1\n").unwrap();
        let touch = |time: SystemTime| {
            let file = OpenOptions::new().write(true).open(&path).unwrap();
            file.set_times(FileTimes::new().set_modified(time)).unwrap();
        };
        let days = Duration::from_secs(200_000);
        let long_ago = |seen: Duration| {
            let begun = Instant::now().checked_sub(seen).expect("the machine runs for longer");
            SEEN.lock().unwrap().get_mut(&path).unwrap().1 = begun;
        };
        for time in [SystemTime::now() - days, SystemTime::now() + days] {
            touch(time);
            assert!(Claim::take(&path).unwrap().is_none() && Claim::is_taken(&path));
            long_ago(Claim::DEAD / 2);
            assert!(Claim::is_taken(&path));
            long_ago(2 * Claim::DEAD);
            assert!(!Claim::is_taken(&path));
            touch(time + Duration::from_secs(1));
            assert!(Claim::is_taken(&path), "it was touched");
        }
        long_ago(2 * Claim::DEAD);
        assert!(Claim::take(&path).unwrap().is_some());
    }
}
