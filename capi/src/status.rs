//! The results of calls: a code, and an error message for the calling thread.

use std::{
    any::Any,
    cell::RefCell,
    ffi::CString,
    panic::{AssertUnwindSafe, catch_unwind},
};

/// The result of a call.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeadtailStatus {
    /// The call succeeded.
    Ok = 0,
    /// An argument or the content of a file is invalid.
    Invalid = 1,
    /// A file cannot be read.
    Io = 2,
    /// An internal error of the library. Objects stay usable.
    Internal = 3,
}

/// A code with its error message.
pub struct Failure(HeadtailStatus, String);

impl Failure {
    /// Returns the failure of an invalid argument.
    pub fn argument(sentence: impl Into<String>) -> Self {
        Self(HeadtailStatus::Invalid, sentence.into())
    }
}

impl From<headtail_sampling::Error> for Failure {
    fn from(error: headtail_sampling::Error) -> Self {
        let is_io = matches!(error, headtail_sampling::Error::Io { .. });
        Self(if is_io { HeadtailStatus::Io } else { HeadtailStatus::Invalid }, error.to_string())
    }
}

thread_local! {
    static LAST: RefCell<CString> = RefCell::default();
}

/// Returns the message of this thread's last failed call; it stays until the next failure.
pub fn last() -> *const std::ffi::c_char {
    LAST.with_borrow(|sentence| sentence.as_ptr())
}

/// Runs the body of a call: failures become codes, and panics are caught.
pub fn call(body: impl FnOnce() -> Result<(), Failure>) -> HeadtailStatus {
    let Failure(status, sentence) = match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(())) => return HeadtailStatus::Ok,
        Ok(Err(failure)) => failure,
        Err(panic) => Failure(HeadtailStatus::Internal, format!("the library failed: {}", message(&*panic))),
    };
    // A zero byte would truncate the message.
    let sentence = CString::new(sentence.replace('\0', " ")).unwrap_or_default();
    LAST.with_borrow_mut(|last| *last = sentence);
    status
}

fn message(panic: &(dyn Any + Send)) -> &str {
    panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("?")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_a_code_with_its_message() {
        assert_eq!(call(|| panic!("on purpose")), HeadtailStatus::Internal);
        // SAFETY: the message of this thread, which no call changes meanwhile.
        let text = unsafe { std::ffi::CStr::from_ptr(last()) };
        assert_eq!(text.to_str(), Ok("the library failed: on purpose"));
    }
}
