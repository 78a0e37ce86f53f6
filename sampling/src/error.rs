//! The error type of this crate. Messages name the file, the field and what to do.

use std::path::{Path, PathBuf};

/// An error of reading input or writing a result.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system failed to read or write a file.
    #[error("{}: {reason}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        reason: std::io::Error,
    },
    /// A file, or a field in it, is invalid.
    #[error("{}: {field}: {reason}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// The field (or the part of the file) that is wrong.
        field: String,
        /// What is wrong, and what is valid.
        reason: String,
    },
    /// A value given by the caller (not from a file) is invalid.
    #[error("{what}: {reason}")]
    Argument {
        /// The name of the value.
        what: String,
        /// What is wrong, and what is valid.
        reason: String,
    },
}

impl Error {
    /// Makes an [`Error::Io`] for `path`.
    pub fn io(path: &Path, reason: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), reason }
    }

    /// Makes an [`Error::Invalid`] for `field` of `path`.
    pub fn invalid(path: &Path, field: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Invalid { path: path.to_owned(), field: field.into(), reason: reason.into() }
    }

    /// Makes an [`Error::Argument`] for the value called `what`.
    pub fn argument(what: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Argument { what: what.into(), reason: reason.into() }
    }

    /// Converts an [`Error::Argument`] to an [`Error::Invalid`] of the file that the value came from.
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
