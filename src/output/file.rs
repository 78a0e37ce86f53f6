//! Single result files.

use std::{
    ffi::OsString,
    fs::{self, File},
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError, atomic::Ordering},
};

use anyhow::{Context, Result, bail, ensure};
use headtail_render::file;

use super::{
    FORCE, digits,
    inputs::{Planned, advice},
    lock::lock_file,
    make_folder,
    record::{self, Entry, RECORD},
    request,
};

/// A file that only this process writes. The folder's record says which command made it, and with which
/// content.
#[derive(Debug)]
pub struct OutputFile {
    path: PathBuf,
    folder: PathBuf,
    /// Target of symbolic links.
    target: PathBuf,
    /// Name in the record.
    name: String,
    /// Dropped once this process has written the file.
    planned: Mutex<Option<Planned>>,
    lock: PathBuf,
    _held: File,
}

impl OutputFile {
    /// Takes a file for writing, creating its folder if it is missing.
    ///
    /// # Errors
    /// If it cannot be written, if it is an input, if another process writes it, or if a file exists that this
    /// command did not make, or that was changed since, and `--force` was not given.
    pub fn take(path: &Path) -> Result<Self> {
        make_folder(&folder_of(path))?;
        let target = file::target(path)?;
        let planned = Mutex::new(Some(Planned::new(path)?));
        let cannot = || format!("{}: it cannot be written", path.display());
        let Some(name) = target.file_name() else { bail!("{}: not the name of a file", path.display()) };
        let mut lock_name = OsString::from(".");
        lock_name.push(name);
        lock_name.push(".lock");
        let lock = target.with_file_name(lock_name);
        let Some(held) = lock_file(&lock).with_context(cannot)? else {
            bail!("{}: another headtail is writing it", path.display());
        };
        let name = name.as_encoded_bytes().escape_ascii().to_string();
        let folder = folder_of(&target);
        let output = Self { path: path.to_owned(), folder, target, name, planned, lock, _held: held };
        let may_replace = !output.target.exists() || FORCE.load(Ordering::Relaxed) || output.is_ours();
        ensure!(
            may_replace,
            "{}: the file is there, of another command or changed since; {}",
            path.display(),
            advice(path)
        );
        Ok(output)
    }

    /// Whether this command made the existing file.
    fn is_ours(&self) -> bool {
        let Ok((record, _)) = file::open_regular(&self.folder.join(RECORD)) else { return false };
        record::latest(&record::entries(&record), &self.name).is_some_and(|entry| {
            let is_unchanged = |digest: &String| self.digest().is_ok_and(|found| found == *digest);
            entry.request == request() && entry.digest.as_ref().is_none_or(is_unchanged)
        })
    }

    fn digest(&self) -> std::io::Result<String> {
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(File::open(&self.target)?)?;
        Ok(digits(&hasher))
    }

    /// Calls `write` to fill the file, and records this command as its maker.
    ///
    /// # Errors
    /// Those of `write`, and if the record cannot be written.
    pub fn write<T, E: Into<anyhow::Error>>(&self, write: impl FnOnce(&Path) -> Result<T, E>) -> Result<T> {
        // Recorded first, so that a kill in between leaves no unknown file.
        self.record(None)?;
        let written = write(&self.path).map_err(Into::into)?;
        // From now on, this process may read its own result.
        drop(self.planned.lock().unwrap_or_else(PoisonError::into_inner).take());
        self.record(Some(self.digest().with_context(|| self.path.display().to_string())?))?;
        Ok(written)
    }

    fn record(&self, digest: Option<String>) -> Result<()> {
        let entry = Entry { request: request(), digest, name: self.name.clone() };
        record::replace(&self.folder, &entry).with_context(|| self.folder.join(RECORD).display().to_string())
    }
}

impl Drop for OutputFile {
    fn drop(&mut self) {
        // Removed while locked: a process that opened it in the meantime sees that its name is gone.
        drop(fs::remove_file(&self.lock));
    }
}

fn folder_of(path: &Path) -> PathBuf {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(path: &Path) -> String {
        OutputFile::take(path).unwrap_err().to_string()
    }

    #[test]
    fn a_file_is_replaced_only_by_its_own_command() {
        let here = tempfile::tempdir().unwrap();
        let path = here.path().join("a file.exr");
        fs::write(&path, "of somebody").unwrap();
        assert!(refused(&path).contains("--force"));
        fs::remove_file(&path).unwrap();
        let write = |text: &'static str| {
            let output = OutputFile::take(&path).unwrap();
            output.write(|path| fs::write(path, text)).unwrap();
        };
        write("one");
        write("two");
        let record = here.path().join(RECORD);
        let lines = fs::read_to_string(&record).unwrap();
        assert!(lines.lines().count() == 1 && lines.ends_with(" a file.exr\n"), "{lines}");
        // The file of another command, and one that was changed by hand.
        fs::write(&record, format!("x{}", &lines[1..])).unwrap();
        assert!(refused(&path).contains("of another command"));
        fs::write(&record, &lines).unwrap();
        fs::write(&path, "three").unwrap();
        assert!(refused(&path).contains("changed since"));
        // A kill left no digest: any content is accepted.
        fs::write(&record, format!("{} a file.exr\n", request())).unwrap();
        write("four");
        assert_eq!(fs::read_dir(here.path()).unwrap().count(), 2);
    }
}
