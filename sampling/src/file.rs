//! Checked reading of input files, and atomic writing of result files.

use std::fs::{self, File, Metadata};
use std::io::{Error as IoError, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use crate::error::{Error, Result};

static WATCH: OnceLock<fn(&Path) -> std::io::Result<()>> = OnceLock::new();

/// Sets a function that is called with the path of every input file before it is opened; an error of it
/// prevents the opening. A program can thus keep its outputs apart from its inputs. Only the first call
/// has an effect.
pub fn watch_inputs(watch: fn(&Path) -> std::io::Result<()>) {
    WATCH.get_or_init(|| watch);
}

/// Whether two paths lead to one existing file, through any links and spellings.
pub fn is_same(a: &Path, b: &Path) -> bool {
    #[cfg(unix)]
    let identity = |path: &Path| {
        use std::os::unix::fs::MetadataExt;
        fs::metadata(path).map(|found| (found.dev(), found.ino())).ok()
    };
    #[cfg(not(unix))]
    let identity = |path: &Path| fs::canonicalize(path).ok();
    identity(a).is_some_and(|a| identity(b) == Some(a))
}

/// Opens a file for reading; returns it and its size in bytes.
///
/// # Errors
/// The file cannot be opened, or `path` is not a regular file: opening a pipe may block, and a device
/// may have no end. The error of the function of [`watch_inputs`].
pub fn open_regular(path: &Path) -> std::io::Result<(File, u64)> {
    let check = |metadata: Metadata| {
        let kind = metadata.file_type();
        match (kind.is_file(), kind.is_dir()) {
            (true, _) => Ok(metadata.len()),
            (_, true) => Err(IoError::other("it is a folder, not a file")),
            _ => Err(IoError::other("it is a pipe or a device, not a regular file")),
        }
    };
    // Check before opening, since opening a pipe blocks, and after, since the path may have been replaced.
    check(fs::metadata(path)?)?;
    WATCH.get().map_or(Ok(()), |watch| watch(path))?;
    let file = File::open(path)?;
    let size = check(file.metadata()?)?;
    Ok((file, size))
}

/// Reads a regular file of at most `most` bytes.
///
/// # Errors
/// As [`open_regular`], or if the file is larger.
pub fn read(path: &Path, most: u64) -> std::io::Result<Vec<u8>> {
    let (file, size) = open_regular(path)?;
    let too_large = || IoError::other(format!("it has {size} bytes; at most {most} are read"));
    if size > most {
        return Err(too_large());
    }
    let mut bytes = Vec::with_capacity(size as usize);
    // The file may grow while it is read.
    file.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most { Err(too_large()) } else { Ok(bytes) }
}

/// The largest text that [`read_text`] reads.
const LARGEST_TEXT: u64 = 1 << 26;

/// Reads a regular text file of at most 64 MiB.
///
/// # Errors
/// As [`read`], or if it is not UTF-8.
pub fn read_text(path: &Path) -> std::io::Result<String> {
    String::from_utf8(read(path, LARGEST_TEXT)?).map_err(|_| IoError::other("not UTF-8 text"))
}

/// Returns the path that writing to `path` creates or replaces: symbolic links are followed, dangling
/// ones too.
///
/// # Errors
/// [`Error::Io`] with `path` if it is a folder, a device, a pipe or a socket, which must not be replaced by a
/// file; if links form a cycle; or if the system cannot read its metadata.
pub fn target(path: &Path) -> Result<PathBuf> {
    let failed = |source| Error::io(path, source);
    let mut place = path.to_owned();
    // Linux's limit.
    for _ in 0..40 {
        let found = match fs::symlink_metadata(&place) {
            Ok(found) => found,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(place),
            Err(error) => return Err(failed(error)),
        };
        let kind = found.file_type();
        if kind.is_symlink() {
            let next = fs::read_link(&place).map_err(failed)?;
            place = place.parent().unwrap_or(Path::new("")).join(next);
        } else if kind.is_file() {
            return Ok(place);
        } else if kind.is_dir() {
            return Err(failed(IoError::other("it is a folder, not a file")));
        } else {
            return Err(failed(IoError::other("it is a pipe or a device, not a regular file")));
        }
    }
    Err(failed(IoError::other("links lead in a circle")))
}

/// Writes `bytes` to `path` atomically, through a temporary file in the same folder that is then renamed.
///
/// Links are followed (see [`target`]). Other processes see the old file or the new one, never a part;
/// after an error the old file is unchanged.
///
/// # Errors
/// [`Error::Io`] with `path` if the folder does not exist, `path` is not a regular file, or the system
/// fails to write or rename.
pub fn replace(path: &Path, bytes: &[u8]) -> Result<()> {
    let place = target(path)?;
    let folder = match place.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let failed = |source| Error::io(path, source);
    let mut builder = tempfile::Builder::new();
    builder.prefix(".headtail-");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Temporary files are private by default; results get the usual mode of new files (the umask
        // applies).
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let mut file = builder.tempfile_in(folder).map_err(failed)?;
    file.write_all(bytes).map_err(failed)?;
    file.as_file().sync_all().map_err(failed)?;
    file.persist(&place).map_err(|error| failed(error.error))?;
    Ok(())
}
