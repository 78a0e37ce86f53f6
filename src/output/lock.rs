//! Locks of files, which keep two programs from writing to one folder.

use std::{
    fs::{self, File, OpenOptions, TryLockError},
    io::ErrorKind,
    path::Path,
    sync::Once,
};

use crate::terminal::warning;

/// Opens and locks a file; `None` if another process holds the lock. The lock lasts until the file is dropped
/// or the process ends. On a file system without locks, no process is excluded and a warning is printed once.
///
/// # Errors
/// If the file cannot be opened.
pub fn lock_file(path: &Path) -> std::io::Result<Option<File>> {
    Ok(lock_or_open(path)?.map(|(file, _)| file))
}

/// [`lock_file`], and whether there is a lock.
///
/// # Errors
/// If the file cannot be opened.
pub fn lock_or_open(path: &Path) -> std::io::Result<Option<(File, bool)>> {
    loop {
        let file = OpenOptions::new().create(true).truncate(false).read(true).append(true).open(path)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Ok(None),
            Err(TryLockError::Error(error)) if has_no_locks(&error) => {
                static WARNED: Once = Once::new();
                let folder = path.parent().unwrap_or(Path::new(".")).display();
                WARNED.call_once(|| {
                    warning!("{folder}: the file system does not support locks ({error}); do not write to it from two commands at once");
                });
                return Ok(Some((file, false)));
            }
            Err(TryLockError::Error(error)) => return Err(error),
        }
        if is_still_there(path, &file) {
            return Ok(Some((file, true)));
        }
    }
}

/// Whether a locking error means that the file system has no locks: Lustre without `flock`, NFS without its
/// daemon, autofs.
pub fn has_no_locks(error: &std::io::Error) -> bool {
    /// `ENOLCK`, `ENOSYS` and the kernel's own `ENOTSUPP`, on Linux.
    const CODES: [i32; 3] = [37, 38, 524];
    let is_code = cfg!(target_os = "linux") && error.raw_os_error().is_some_and(|code| CODES.contains(&code));
    error.kind() == ErrorKind::Unsupported || is_code
}

/// Whether a name still leads to an open file: its last holder may have removed it.
#[cfg(unix)]
pub(super) fn is_still_there(path: &Path, file: &File) -> bool {
    use std::os::unix::fs::MetadataExt;
    let identity = |metadata: fs::Metadata| (metadata.dev(), metadata.ino());
    let opened = file.metadata().map(identity).ok();
    opened.is_some() && fs::metadata(path).map(identity).ok() == opened
}

/// Open files cannot be removed on this system.
#[cfg(not(unix))]
pub(super) fn is_still_there(_: &Path, _: &File) -> bool {
    true
}
