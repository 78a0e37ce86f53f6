//! The error type of this crate.

use std::path::PathBuf;

/// Why something could not be measured.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The renderer's error.
    #[error(transparent)]
    Render(#[from] headtail_render::Error),
    /// A file of an experiment or of its data is wrong.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A value is unusable.
    #[error("{what}: {reason}")]
    Argument {
        /// The name of the value.
        what: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A device failed.
    #[error("{0}")]
    Device(String),
    /// A graphics device does not have a part of a scene, or a sampler.
    #[error("{0}")]
    NotOnDevice(String),
    /// The stop flag was set.
    #[error("interrupted {0}")]
    Interrupted(&'static str),
}

/// `Result` with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// An [`Error::File`].
    pub fn file(path: &std::path::Path, reason: impl std::fmt::Display) -> Self {
        Self::File { path: path.to_owned(), reason: reason.to_string() }
    }

    /// An [`Error::Argument`].
    pub fn argument(what: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Argument { what: what.into(), reason: reason.into() }
    }
}
