//! How calls end: a code, and a sentence for the thread that called.

use std::{
    any::Any,
    cell::RefCell,
    ffi::CString,
    panic::{AssertUnwindSafe, catch_unwind},
};

/// How a call ended.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeadtailStatus {
    /// All is well.
    Ok = 0,
    /// An argument or the content of a file cannot be used.
    Invalid = 1,
    /// The system refused to read a file.
    Io = 2,
    /// A fault of the library itself. Objects stay usable.
    Internal = 3,
}

/// A code with its sentence.
pub struct Failure(HeadtailStatus, String);

impl Failure {
    /// An argument that cannot be used.
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

/// The sentence of the last call of this thread that failed; it stays until the next failure.
pub fn last() -> *const std::ffi::c_char {
    LAST.with_borrow(|sentence| sentence.as_ptr())
}

/// Runs the body of a call: failures become codes, and no panic leaves it.
pub fn call(body: impl FnOnce() -> Result<(), Failure>) -> HeadtailStatus {
    let Failure(status, sentence) = match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(())) => return HeadtailStatus::Ok,
        Ok(Err(failure)) => failure,
        Err(panic) => Failure(HeadtailStatus::Internal, format!("the library failed: {}", message(&*panic))),
    };
    // A zero byte would end the text early.
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
        // SAFETY: the text of this thread, which no call changes meanwhile.
        let text = unsafe { std::ffi::CStr::from_ptr(last()) };
        assert_eq!(text.to_str(), Ok("the library failed: on purpose"));
    }
}
