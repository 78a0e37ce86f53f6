//! Calls of third-party decoders that may panic on damaged data.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Once;

thread_local! {
    /// Whether this thread is inside a decoder.
    static DECODING: Cell<bool> = const { Cell::new(false) };
}

/// Runs a decoder in this thread; `None` if it panics.
///
/// Such a panic prints nothing: the process's panic hook is wrapped, once, and panics outside decoders
/// go to the original hook. If panics abort, this one does too.
pub fn without_panic<T>(decode: impl FnOnce() -> T) -> Option<T> {
    static WRAP_HOOK: Once = Once::new();
    WRAP_HOOK.call_once(|| {
        let hook = take_hook();
        set_hook(Box::new(move |panic| {
            if !DECODING.get() {
                hook(panic);
            }
        }));
    });
    let outer = DECODING.replace(true);
    let result = catch_unwind(AssertUnwindSafe(decode));
    DECODING.set(outer);
    result.ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decoder_panics_return_none() {
        assert_eq!(without_panic(|| 3), Some(3));
        assert_eq!(without_panic::<i32>(|| panic!("of a decoder")), None);
        assert!(!DECODING.get());
    }

    /// Run by the next test in a process of its own: a silenced panic, then one that is printed.
    #[test]
    #[should_panic(expected = "of the program")]
    fn panics_of_both_kinds() {
        without_panic(|| panic!("of a decoder"));
        panic!("of the program");
    }

    #[test]
    fn only_panics_of_decoders_are_quiet() {
        let name = "image::without_panic::tests::panics_of_both_kinds";
        let mut command = std::process::Command::new(std::env::current_exe().unwrap());
        let output = command.args(["--exact", "--nocapture", name]).output().unwrap();
        let shown = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
        assert!(shown.contains("of the program") && !shown.contains("of a decoder"), "{shown}");
    }
}
