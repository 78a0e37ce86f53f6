//! The one error type of this crate: every message is a sentence that names the file, the field and what to do.

use std::path::{Path, PathBuf};

/// What can go wrong when something from outside is read or a result is written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system refused to read or write a file.
    #[error("{}: {reason}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        reason: std::io::Error,
    },
    /// A file or a field in it does not hold what it must.
    #[error("{}: {field}: {reason}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// The field (or the part of the file) that is wrong.
        field: String,
        /// What is wrong with it, and what would be right.
        reason: String,
    },
    /// A value given by the caller (not from a file) is unusable.
    #[error("{what}: {reason}")]
    Argument {
        /// The name of the value.
        what: String,
        /// What is wrong with it, and what would be right.
        reason: String,
    },
}

impl Error {
    /// An [`Error::Io`] for `path`.
    pub fn io(path: &Path, reason: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), reason }
    }

    /// An [`Error::Invalid`] for `field` of `path`.
    pub fn invalid(path: &Path, field: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Invalid { path: path.to_owned(), field: field.into(), reason: reason.into() }
    }

    /// An [`Error::Argument`] for the value called `what`.
    pub fn argument(what: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Argument { what: what.into(), reason: reason.into() }
    }

    /// An argument's error as one of a field of the file that it came from; others as they are.
    #[must_use]
    pub fn in_file(self, path: &Path) -> Self {
        match self {
            Self::Argument { what, reason } => Self::invalid(path, what, reason),
            other => other,
        }
    }
}

/// `Result` with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;
