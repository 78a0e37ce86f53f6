//! The folder of a sweep: its journals, and a folder with a lock per trial.

use std::{
    fs::{self, File, TryLockError},
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};

use crate::output::{self, Claim};

/// The folder of a sweep.
#[derive(Clone, Debug)]
pub struct SweepFolder(PathBuf);

/// An exclusive right, held until it is dropped or the process ends.
#[derive(Debug)]
pub enum Lock {
    /// A lock of the file system.
    File(#[expect(dead_code, reason = "held, never read")] File),
    /// A file that only one process can create, if there are no locks.
    Claim(#[expect(dead_code, reason = "held, never read")] Claim),
}

impl SweepFolder {
    /// Returns the folder at this path, which need not exist yet.
    pub fn new(path: PathBuf) -> Self {
        Self(path)
    }

    /// Returns its path.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Returns the folder of journals.
    pub fn journals(&self) -> PathBuf {
        self.0.join("journal")
    }

    /// Returns the folder of workers' messages.
    pub fn logs(&self) -> PathBuf {
        self.0.join("logs")
    }

    /// Returns the folder of references of measured views.
    pub fn references(&self) -> PathBuf {
        self.0.join("references")
    }

    /// Returns the folder of the trials' folders.
    pub fn trials(&self) -> PathBuf {
        self.0.join("trials")
    }

    /// Returns the folder of a trial.
    pub fn trial(&self, id: &str) -> PathBuf {
        self.trials().join(id)
    }

    /// Locks a trial; `None` if a worker holds it. The system releases the lock of a killed process.
    ///
    /// # Errors
    /// If the trial's folder cannot be created.
    pub fn lock(&self, id: &str) -> Result<Option<Lock>> {
        try_lock(&self.trial(id).join("lock"))
    }

    /// Whether a worker holds a trial.
    pub fn is_locked(&self, id: &str) -> bool {
        let path = self.trial(id).join("lock");
        File::open(&path).is_ok_and(|file| match file.try_lock_shared() {
            Ok(()) => false,
            Err(TryLockError::WouldBlock) => true,
            Err(TryLockError::Error(error)) => output::has_no_locks(&error) && Claim::is_taken(&claim_beside(&path)),
        })
    }

    /// Whether the file system has no locks and there is a claim of a trial, possibly of a process that is
    /// gone.
    pub fn is_claimed(&self, id: &str) -> bool {
        claim_beside(&self.trial(id).join("lock")).exists()
    }

    /// Locks the creation of the next configuration of adaptive search.
    ///
    /// # Errors
    /// As [`Self::lock`].
    pub fn lock_search(&self) -> Result<Option<Lock>> {
        try_lock(&self.0.join("search.lock"))
    }
}

fn try_lock(path: &Path) -> Result<Option<Lock>> {
    let made = fs::create_dir_all(path.parent().unwrap_or(Path::new(".")));
    let file = made.and_then(|()| output::lock_or_open(path)).with_context(|| path.display().to_string())?;
    match file {
        Some((file, true)) => Ok(Some(Lock::File(file))),
        Some((_, false)) => {
            let path = claim_beside(path);
            let claim = Claim::take(&path).with_context(|| path.display().to_string())?;
            Ok(claim.map(Lock::Claim))
        }
        None => Ok(None),
    }
}

fn claim_beside(path: &Path) -> PathBuf {
    path.with_extension("claim")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_worker_at_a_time_holds_a_trial() {
        let here = tempfile::tempdir().unwrap();
        let folder = SweepFolder::new(here.path().to_owned());
        assert!(!folder.is_locked("a"));
        let lock = folder.lock("a").unwrap();
        assert!(lock.is_some() && folder.lock("a").unwrap().is_none() && folder.is_locked("a"));
        assert!(folder.lock("b").unwrap().is_some());
        drop(lock);
        assert!(!folder.is_locked("a") && folder.lock("a").unwrap().is_some());
    }
}
