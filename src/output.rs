//! Output files: protects the results of other commands and excludes concurrent writers.
//!
//! A folder with results holds a record of the commands that made them and of the names of their files. A
//! lock on the record excludes others that write the whole folder; the system releases the lock of a killed
//! process.
//!
//! | file | concept |
//! | --- | --- |
//! | `output/file.rs` | single files |
//! | `output/inputs.rs` | no output is an input |
//! | `output/record.rs` | the record of a folder |
//! | `output/lock.rs` | locks of files |
//! | `output/claim.rs` | exclusion on file systems without locks |

mod claim;
mod file;
mod inputs;
mod lock;
mod record;

use std::{
    ffi::OsString,
    fs::{self, File},
    io::ErrorKind,
    path::{Path, PathBuf},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};

use anyhow::{Context, Result, bail};

pub use claim::Claim;
pub use file::OutputFile;
use inputs::Planned;
pub use inputs::{check_output, watch};
pub use lock::{has_no_locks, lock_or_open};
use record::{Entry, RECORD};

static FORCE: AtomicBool = AtomicBool::new(false);

/// Removes a saved state, if there is one, once the results are written.
///
/// # Errors
/// If it cannot be removed.
pub fn remove_kept(file: &Path) -> Result<()> {
    if file.exists() {
        fs::remove_file(file).with_context(|| file.display().to_string())?;
    }
    Ok(())
}

/// Allows results of other commands to be replaced.
pub fn force(force: bool) {
    FORCE.store(force, Ordering::Relaxed);
}

/// A folder of results that only this process writes to.
#[derive(Debug)]
pub struct OutputFolder {
    path: PathBuf,
    record: File,
    known: Mutex<Vec<Entry>>,
    /// Identifies this command, see [`request_of`].
    request: String,
    results: Vec<String>,
    /// Files that will be replaced and were not yet begun.
    planned: Mutex<Vec<(String, Planned)>>,
    /// Names of files that this process writes.
    begun: Mutex<Vec<String>>,
    was_made: bool,
}

impl OutputFolder {
    /// Takes a folder, creating it if it is missing. `results` are the files that a command always writes
    /// there.
    ///
    /// # Errors
    /// If it cannot be written to, if another process writes there, if one of `results` is an input, or if the
    /// folder holds results of another command and `--force` was not given.
    pub fn take(path: &Path, results: &[&str]) -> Result<Self> {
        Self::take_for(path, results, request())
    }

    /// [`Self::take`] for a command that continues the results of other commands with the same
    /// [`request_of`].
    ///
    /// # Errors
    /// As [`Self::take`].
    pub fn take_for(path: &Path, results: &[&str], request: String) -> Result<Self> {
        let mut folder = Self::take_any(path)?;
        folder.results = results.iter().map(|&name| name.to_owned()).collect();
        folder.plan(&folder.results)?;
        folder.request = request;
        let is_ours = |name: &str| {
            let known = folder.known.lock().unwrap_or_else(PoisonError::into_inner);
            // Any entry counts, not only the latest: a command that resumes a run and is rejected has already
            // added its files.
            known.iter().any(|entry| entry.name == name && entry.request == folder.request)
        };
        let other = results.iter().find(|name| path.join(name).exists() && !is_ours(name));
        match other {
            Some(name) if !FORCE.load(Ordering::Relaxed) => {
                bail!("{}: there is {name} of another command; {}", path.display(), inputs::advice(&path.join(name)))
            }
            _ => Ok(folder),
        }
    }

    /// Rejects inputs that are these files of the folder, which this command may write.
    ///
    /// # Errors
    /// If one of them is already open.
    pub fn plan(&self, names: &[String]) -> Result<()> {
        let planned = names.iter().map(|name| Ok((name.clone(), Planned::new(&self.path.join(name))?)));
        let planned: Vec<_> = planned.collect::<Result<_>>()?;
        self.planned.lock().unwrap_or_else(PoisonError::into_inner).extend(planned);
        Ok(())
    }

    /// Takes a folder regardless of its contents.
    ///
    /// # Errors
    /// As [`Self::take`], except for results of other commands.
    pub fn take_any(path: &Path) -> Result<Self> {
        let cannot = || format!("{}: the folder cannot be written to", path.display());
        let was_made = !path.exists();
        make_folder(path)?;
        // Access to the record does not imply the right to create files.
        tempfile::tempfile_in(path).with_context(cannot)?;
        let lock = record::lock(path).with_context(cannot)?;
        let Some(record) = lock else { bail!("{}: another headtail is writing there", path.display()) };
        let known = Mutex::new(record::entries(&record));
        let (request, results) = (request(), Vec::new());
        let (planned, begun) = (Mutex::default(), Mutex::default());
        Ok(Self { path: path.to_owned(), record, known, request, results, planned, begun, was_made })
    }

    /// Begins to write: removes all files of the commands whose results are replaced, except the inputs that
    /// are open; all inputs must be.
    ///
    /// # Errors
    /// If a file cannot be removed or the record cannot be written.
    pub fn begin(&self) -> Result<()> {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let others = known.iter().filter(|entry| entry.request != self.request && self.results.contains(&entry.name));
        let replaced: Vec<String> = others.map(|entry| entry.request.clone()).collect();
        let (old, kept): (Vec<_>, Vec<_>) = known.drain(..).partition(|entry| replaced.contains(&entry.request));
        *known = kept;
        for Entry { name, .. } in &old {
            let file = self.path.join(name);
            // Plain names only, so that a foreign record cannot lead out of the folder.
            let is_name = Path::new(name).file_name().is_some_and(|only| only == name.as_str());
            if is_name
                && !inputs::is_input(&file)
                && let Err(error) = fs::remove_file(&file)
                && error.kind() != ErrorKind::NotFound
            {
                return Err(error).with_context(|| file.display().to_string());
            }
        }
        record::write(&self.record, &known).with_context(|| self.path.join(RECORD).display().to_string())
    }

    /// Returns the path of a result and adds it to the record.
    ///
    /// # Errors
    /// If the file is an input, or the record cannot be written.
    pub fn file(&self, name: &str) -> Result<PathBuf> {
        let path = self.path.join(name);
        let mut begun = self.begun.lock().unwrap_or_else(PoisonError::into_inner);
        if !begun.iter().any(|known| known == name) {
            check_output(&path)?;
            begun.push(name.to_owned());
            // From now on, this process may read its own result.
            self.planned.lock().unwrap_or_else(PoisonError::into_inner).retain(|(planned, _)| planned != name);
        }
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let entry = Entry { request: self.request.clone(), digest: None, name: name.to_owned() };
        if record::latest(&known, name) != Some(&entry) {
            record::add(&self.record, &entry).with_context(|| path.display().to_string())?;
            known.push(entry);
        }
        Ok(path)
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for OutputFolder {
    /// Leaves nothing behind if nothing was written.
    fn drop(&mut self) {
        let is_empty = fs::read_dir(&self.path)
            .is_ok_and(|mut entries| entries.all(|entry| entry.is_ok_and(|entry| entry.file_name() == RECORD)));
        if is_empty {
            drop(fs::remove_file(self.path.join(RECORD)));
            if self.was_made {
                drop(fs::remove_dir(&self.path));
            }
        }
    }
}

/// Creates a folder and its parents if they are missing.
///
/// # Errors
/// If it cannot be created.
pub fn make_folder(folder: &Path) -> Result<()> {
    fs::create_dir_all(folder).with_context(|| format!("{}: the folder cannot be made", folder.display()))
}

/// Returns [`request_of`] the arguments of this command.
fn request() -> String {
    request_of(std::env::args_os().skip(1))
}

/// Returns a hash, in hexadecimal digits, of the arguments that change results. Arguments are hashed as
/// bytes, UTF-8 or not.
pub fn request_of(arguments: impl Iterator<Item = OsString>) -> String {
    const SWITCHES: [&[u8]; 7] = [b"--force", b"--resume", b"-q", b"--quiet", b"-v", b"--verbose", b"--json"];
    const WITH_VALUE: [&[u8]; 3] = [b"--log", b"--threads", b"--out"];
    let mut hasher = blake3::Hasher::new();
    let mut skips_next = false;
    for argument in arguments {
        let argument = argument.as_encoded_bytes();
        if std::mem::take(&mut skips_next) || SWITCHES.contains(&argument) {
            continue;
        }
        let name = argument.split(|byte| *byte == b'=').next().unwrap_or_default();
        if WITH_VALUE.contains(&name) {
            skips_next = name.len() == argument.len();
            continue;
        }
        hasher.update(&(argument.len() as u64).to_le_bytes());
        hasher.update(argument);
    }
    digits(&hasher)
}

/// Returns the first 32 hexadecimal digits of a hash.
fn digits(hasher: &blake3::Hasher) -> String {
    hasher.finalize().to_hex()[..32].to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request_of(arguments: &str) -> String {
        super::request_of(arguments.split(' ').map(OsString::from))
    }

    #[test]
    fn request_depends_only_on_arguments_that_change_results() {
        let same = request_of("render --spp 4 --out a.exr");
        for other in ["render --spp 4 --out b.exr --force", "-q render --log l --spp 4 --threads=3 --json"] {
            assert_eq!(request_of(other), same, "{other}");
        }
        for other in
            ["render --spp 5 --out a.exr", "compare --spp 4 --out a.exr", "render --spp 4 --seed 1 --out a.exr"]
        {
            assert_ne!(request_of(other), same, "{other}");
        }
    }

    #[test]
    #[cfg(unix)]
    fn non_utf8_arguments_give_different_requests() {
        use std::os::unix::ffi::OsStringExt;
        let [e, f] = [b"\xe9".to_vec(), b"\xea".to_vec()].map(|name| [OsString::from_vec(name)].into_iter());
        assert_ne!(super::request_of(e), super::request_of(f));
    }

    #[test]
    fn concurrent_writers_are_excluded() {
        let here = tempfile::tempdir().unwrap();
        let (path, file) = (here.path().join("results"), here.path().join("a.exr"));
        let folder = OutputFolder::take(&path, &[]).unwrap();
        assert!(OutputFolder::take(&path, &[]).unwrap_err().to_string().contains("another headtail"));
        drop(folder);
        assert!(!path.exists());
        let taken = OutputFile::take(&file).unwrap();
        assert!(OutputFile::take(&file).unwrap_err().to_string().contains("another headtail"));
        drop(taken);
        assert_eq!(fs::read_dir(here.path()).unwrap().count(), 0);
    }

    #[test]
    fn only_files_of_the_replaced_command_are_removed() {
        let here = tempfile::tempdir().unwrap();
        let path = here.path();
        let inner = path.join("results");
        fs::create_dir(&inner).unwrap();
        fs::write(inner.join(RECORD), "a table.csv\na old.exr\na in.exr\na ../outside\nb head\n").unwrap();
        for name in
            ["results/table.csv", "results/old.exr", "results/in.exr", "outside", "results/head", "results/own.txt"]
        {
            fs::write(path.join(name), "x").unwrap();
        }
        let refused = OutputFolder::take(&inner, &["table.csv"]).unwrap_err().to_string();
        assert!(refused.contains("table.csv of another command"), "{refused}");
        // As with `--force`.
        let mut folder = OutputFolder::take_any(&inner).unwrap();
        folder.results.push("table.csv".into());
        watch();
        headtail_render::file::open_regular(&inner.join("in.exr")).unwrap();
        folder.begin().unwrap();
        assert!(folder.file("in.exr").unwrap_err().to_string().contains("also an input"));
        assert_eq!(folder.file("new.exr").unwrap(), inner.join("new.exr"));
        drop(folder);
        for (name, stays) in
            [("table.csv", false), ("old.exr", false), ("in.exr", true), ("head", true), ("own.txt", true)]
        {
            assert_eq!(inner.join(name).exists(), stays, "{name}");
        }
        assert!(path.join("outside").exists());
        assert_eq!(fs::read_to_string(inner.join(RECORD)).unwrap(), format!("b head\n{} new.exr\n", request()));
    }
}
