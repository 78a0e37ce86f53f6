//! Where results go: those of another command are not overwritten, and nobody else writes there at the same time.
//!
//! A folder of results holds a file [`RECORD`], with the command that made them and the names of its files. Its lock excludes other
//! writers; the system takes it back from a process that is killed.

use std::{
    fs::{self, File, OpenOptions, TryLockError},
    io::{BufRead, BufReader, ErrorKind, Write},
    path::{Path, PathBuf},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};

use anyhow::{Context, Result, bail, ensure};
use headtail_render::{file, image::text_attribute};

/// The file of a folder of results that says what made them.
const RECORD: &str = ".headtail";
/// The attribute of OpenEXR results that tells one command from another.
pub const REQUEST: &str = "headtail.request";

static FORCE: AtomicBool = AtomicBool::new(false);

/// Removes what was kept to go on with, if it is there: the results are.
///
/// # Errors
/// It cannot be removed.
pub fn remove_kept(file: &Path) -> Result<()> {
    if file.exists() {
        fs::remove_file(file).with_context(|| file.display().to_string())?;
    }
    Ok(())
}

/// Lets results of other commands be replaced.
pub fn force(force: bool) {
    FORCE.store(force, Ordering::Relaxed);
}

/// A folder of results that only this process writes to.
#[derive(Debug)]
pub struct OutputFolder {
    path: PathBuf,
    record: File,
    /// What the record says: a request, and a file that it made.
    known: Mutex<Vec<(String, String)>>,
    results: Vec<String>,
    was_made: bool,
}

impl OutputFolder {
    /// Takes a folder, which is made if it is missing. `results` are names of files that a command leaves here in any case.
    ///
    /// # Errors
    /// If it cannot be written to, if another process writes there, or if there are results of another command and `--force` was not
    /// given.
    pub fn take(path: &Path, results: &[&str]) -> Result<Self> {
        let mut folder = Self::share(path)?;
        folder.results = results.iter().map(|&name| name.to_owned()).collect();
        let request = request();
        let is_ours = |name: &str| {
            let known = folder.known.lock().unwrap_or_else(PoisonError::into_inner);
            known.iter().any(|(by, file)| *by == request && file == name)
        };
        let other = results.iter().find(|name| path.join(name).exists() && !is_ours(name));
        match other {
            Some(name) if !FORCE.load(Ordering::Relaxed) => bail!(
                "{}: there is {name} of another command; name another folder, or replace it by --force",
                path.display()
            ),
            _ => Ok(folder),
        }
    }

    /// Takes a folder whatever is there.
    ///
    /// # Errors
    /// As [`Self::take`], but for results of other commands.
    pub fn share(path: &Path) -> Result<Self> {
        let cannot = || format!("{}: the folder cannot be written to", path.display());
        let was_made = !path.exists();
        fs::create_dir_all(path).with_context(|| format!("{}: the folder cannot be made", path.display()))?;
        // Even one who may read the record may lack the right to make new files.
        tempfile::tempfile_in(path).with_context(cannot)?;
        let lock = lock_file(&path.join(RECORD)).with_context(cannot)?;
        let Some(record) = lock else { bail!("{}: another headtail is writing there", path.display()) };
        let lines = BufReader::new(&record).lines().map_while(Result::ok);
        let entry = |line: String| line.split_once(' ').map(|(request, name)| (request.to_owned(), name.to_owned()));
        let known = Mutex::new(lines.filter_map(entry).collect());
        Ok(Self { path: path.to_owned(), record, known, results: Vec::new(), was_made })
    }

    /// Begins to write: all files of the commands whose results are replaced go, but those in `inputs`.
    ///
    /// # Errors
    /// If a file cannot be removed or the record cannot be written.
    pub fn begin(&self, inputs: &[&Path]) -> Result<()> {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let own = request();
        let replaced: Vec<String> = known
            .iter()
            .filter(|(by, name)| *by != own && self.results.contains(name))
            .map(|(by, _)| by.clone())
            .collect();
        let inputs: Vec<PathBuf> = inputs.iter().filter_map(|input| input.canonicalize().ok()).collect();
        let (old, kept): (Vec<_>, Vec<_>) = known.drain(..).partition(|(by, _)| replaced.contains(by));
        *known = kept;
        for (_, name) in &old {
            let file = self.path.join(name);
            // Only names, so that a record from elsewhere cannot lead out of the folder.
            let is_name = Path::new(name).file_name().is_some_and(|only| only == name.as_str());
            let is_input = file.canonicalize().is_ok_and(|file| inputs.contains(&file));
            if is_name
                && !is_input
                && let Err(error) = fs::remove_file(&file)
                && error.kind() != ErrorKind::NotFound
            {
                return Err(error).with_context(|| file.display().to_string());
            }
        }
        let write = || {
            self.record.set_len(0)?;
            known.iter().try_for_each(|(request, name)| writeln!(&self.record, "{request} {name}"))
        };
        write().with_context(|| self.path.join(RECORD).display().to_string())
    }

    /// The path of a result, of which the record is told.
    ///
    /// # Errors
    /// If the record cannot be written.
    pub fn file(&self, name: &str) -> Result<PathBuf> {
        let path = self.path.join(name);
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let entry = (request(), name.to_owned());
        if !known.contains(&entry) {
            writeln!(&self.record, "{} {name}", entry.0).with_context(|| path.display().to_string())?;
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
    /// Leaves nothing behind where nothing was written.
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

/// A file that only this process writes.
#[derive(Debug)]
pub struct OutputFile {
    lock: PathBuf,
    _held: File,
}

impl OutputFile {
    /// Takes a file that is to be written; its folder is made if it is missing. `is_same` says of the file that is there whether the same
    /// command made it.
    ///
    /// # Errors
    /// If it cannot be written, if another process writes it, or if another command's result is there and `--force` was not given.
    pub fn take(path: &Path, is_same: impl Fn(&Path) -> bool) -> Result<Self> {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        fs::create_dir_all(folder).with_context(|| format!("{}: the folder cannot be made", folder.display()))?;
        let target = file::target(path)?;
        let exists = target.exists();
        let may_replace = !exists || FORCE.load(Ordering::Relaxed) || is_same(&target);
        ensure!(
            may_replace,
            "{}: the file is there, of another command; name another, or replace it by --force",
            path.display()
        );
        let cannot = || format!("{}: it cannot be written", path.display());
        let Some(name) = target.file_name() else { bail!("{}: it is no name of a file", path.display()) };
        let mut lock_name = std::ffi::OsString::from(".");
        lock_name.push(name);
        lock_name.push(".lock");
        let lock = target.with_file_name(lock_name);
        let Some(held) = lock_file(&lock).with_context(cannot)? else {
            bail!("{}: another headtail is writing it", path.display());
        };
        Ok(Self { lock, _held: held })
    }

    /// [`Self::take`] of an OpenEXR result, which holds its command's request.
    ///
    /// # Errors
    /// As [`Self::take`].
    pub fn take_exr(path: &Path) -> Result<Self> {
        Self::take(path, |there| text_attribute(there, REQUEST).is_ok_and(|found| found == Some(request())))
    }
}

impl Drop for OutputFile {
    fn drop(&mut self) {
        // While it is locked: who opened it meanwhile finds that it has no name any more.
        drop(fs::remove_file(&self.lock));
    }
}

/// The right to write something, if nobody has it: a file with a lock that lasts until it is dropped or the process ends, however it ends. A
/// file system without locks excludes nobody.
///
/// # Errors
/// If the file cannot be opened.
pub fn lock_file(path: &Path) -> std::io::Result<Option<File>> {
    loop {
        let file = OpenOptions::new().create(true).truncate(false).read(true).append(true).open(path)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Ok(None),
            Err(TryLockError::Error(error)) if error.kind() == ErrorKind::Unsupported => return Ok(Some(file)),
            Err(TryLockError::Error(error)) => return Err(error),
        }
        if is_still_there(path, &file) {
            return Ok(Some(file));
        }
    }
}

/// Whether a name still leads to an open file: its last holder may have removed it.
#[cfg(unix)]
fn is_still_there(path: &Path, file: &File) -> bool {
    use std::os::unix::fs::MetadataExt;
    let identity = |metadata: fs::Metadata| (metadata.dev(), metadata.ino());
    let opened = file.metadata().map(identity).ok();
    opened.is_some() && fs::metadata(path).map(identity).ok() == opened
}

/// Open files cannot be removed on this system.
#[cfg(not(unix))]
fn is_still_there(_: &Path, _: &File) -> bool {
    true
}

/// What tells this command from others, as hexadecimal digits: the arguments, without those that change no result.
pub fn request() -> String {
    request_of(std::env::args_os().skip(1).map(|argument| argument.to_string_lossy().into_owned()))
}

fn request_of(arguments: impl Iterator<Item = String>) -> String {
    const SWITCHES: [&str; 6] = ["--force", "--resume", "-q", "--quiet", "-v", "--verbose"];
    const WITH_VALUE: [&str; 3] = ["--log", "--threads", "--out"];
    let mut hasher = blake3::Hasher::new();
    let mut skips_next = false;
    for argument in arguments {
        if std::mem::take(&mut skips_next) || SWITCHES.contains(&&*argument) {
            continue;
        }
        let (name, has_value) = argument.split_once('=').map_or((&*argument, false), |(name, _)| (name, true));
        if WITH_VALUE.contains(&name) {
            skips_next = !has_value;
            continue;
        }
        hasher.update(&(argument.len() as u64).to_le_bytes());
        hasher.update(argument.as_bytes());
    }
    hasher.finalize().to_hex()[..32].to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request_of(arguments: &str) -> String {
        super::request_of(arguments.split(' ').map(str::to_owned))
    }

    #[test]
    fn a_command_is_known_by_what_changes_results() {
        let same = request_of("render --spp 4 --out a.exr");
        for other in ["render --spp 4 --out b.exr --force", "-q render --log l --spp 4 --threads=3"] {
            assert_eq!(request_of(other), same, "{other}");
        }
        for other in
            ["render --spp 5 --out a.exr", "compare --spp 4 --out a.exr", "render --spp 4 --seed 1 --out a.exr"]
        {
            assert_ne!(request_of(other), same, "{other}");
        }
    }

    #[test]
    fn one_at_a_time_writes() {
        let here = tempfile::tempdir().unwrap();
        let (path, file) = (here.path().join("results"), here.path().join("a.exr"));
        let folder = OutputFolder::take(&path, &[]).unwrap();
        assert!(OutputFolder::take(&path, &[]).unwrap_err().to_string().contains("another headtail"));
        drop(folder);
        assert!(!path.exists());
        let taken = OutputFile::take(&file, |_| false).unwrap();
        assert!(OutputFile::take(&file, |_| false).unwrap_err().to_string().contains("another headtail"));
        drop(taken);
        fs::write(&file, "x").unwrap();
        assert!(OutputFile::take(&file, |_| true).is_ok());
        assert!(OutputFile::take(&file, |_| false).unwrap_err().to_string().contains("--force"));
        assert_eq!(fs::read_dir(here.path()).unwrap().count(), 1);
    }

    #[test]
    fn files_of_another_command_go_and_others_stay() {
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
        // As `--force` lets it.
        let mut folder = OutputFolder::share(&inner).unwrap();
        folder.results.push("table.csv".into());
        folder.begin(&[&inner.join("in.exr")]).unwrap();
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
