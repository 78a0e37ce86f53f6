//! Maps errors of the crates to Python exceptions with the same messages.

use pyo3::{
    create_exception,
    exceptions::{PyOSError, PyValueError},
    prelude::*,
};

create_exception!(headtail, HeadtailError, PyValueError, "What a file holds or a caller gave cannot be used.");

/// Converts an error of the renderer: `OSError` for failed file access, else `headtail.HeadtailError`.
pub fn of_render(error: headtail_render::Error) -> PyErr {
    match error {
        headtail_render::Error::Io { .. } => PyOSError::new_err(error.to_string()),
        _ => refused(error.to_string()),
    }
}

/// Converts an error of a measurement.
pub fn of_eval(error: headtail_eval::Error) -> PyErr {
    match error {
        headtail_eval::Error::Render(error) => of_render(error),
        _ => refused(error.to_string()),
    }
}

/// Converts an error of training.
#[cfg(feature = "fit")]
pub fn of_train(error: headtail_train::Error) -> PyErr {
    refused(error.to_string())
}

/// An exception with a custom message.
pub fn refused(sentence: impl Into<String>) -> PyErr {
    HeadtailError::new_err(sentence.into())
}
