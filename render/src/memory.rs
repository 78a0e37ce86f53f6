//! How much memory there is, so that what is too large is refused by a sentence instead of by the system.

use std::fs;

use crate::error::{Error, Result};

/// The variable that says how many MB of 2^20 bytes are to be taken at most.
const VARIABLE: &str = "HEADTAIL_MEMORY";
/// What a pixel takes while it is rendered and written: sums, three images, and what they are encoded in.
const BYTES_PER_PIXEL: u64 = 200;
/// What a pixel of a finished picture takes, and of what is drawn of it.
const BYTES_PER_KEPT_PIXEL: u64 = 40;

/// Refuses work that needs more memory than there is, or than `HEADTAIL_MEMORY` (in MB of 2^20 bytes) allows. `what` names it.
///
/// # Errors
/// [`Error::Argument`] with both numbers, or if `HEADTAIL_MEMORY` is no number. Where neither it nor the system says what is available, nothing
/// is refused.
pub fn require(bytes: u64, what: impl FnOnce() -> String) -> Result<()> {
    let available = [available(), allowed(std::env::var(VARIABLE).ok().as_deref())?].into_iter().flatten().min();
    match available {
        Some(available) if bytes > available => {
            let reason = format!("takes about {}; {} of memory are available", gigabytes(bytes), gigabytes(available));
            Err(Error::argument(what(), reason))
        }
        _ => Ok(()),
    }
}

/// Refuses pictures that need more memory than there is: one that is rendered and written, and `kept` finished ones of its size in pixels.
///
/// # Errors
/// As [`require`].
pub fn require_pictures(width: usize, height: usize, kept: usize) -> Result<()> {
    let bytes = BYTES_PER_PIXEL + BYTES_PER_KEPT_PIXEL * kept as u64;
    require((width as u64 * height as u64).saturating_mul(bytes), || match kept {
        0 => format!("a picture of {width} x {height} pixels"),
        _ => format!("a picture of {width} x {height} pixels and {kept} more of that size"),
    })
}

/// What the variable allows, in bytes.
fn allowed(variable: Option<&str>) -> Result<Option<u64>> {
    let megabytes = |text: &str| text.parse::<u64>().ok().filter(|megabytes| *megabytes < 1 << 44);
    let wrong = || Error::argument(VARIABLE, "is a whole number of MB");
    variable.map(|text| Ok(megabytes(text).ok_or_else(wrong)? << 20)).transpose()
}

/// Bytes that this process can still take: the lesser of what the machine has and what its control groups and limits leave; `None` where the
/// system does not say.
pub fn available() -> Option<u64> {
    let of_machine =
        fs::read_to_string("/proc/meminfo").ok().and_then(|text| field(&text, "MemAvailable:")).map(|kib| kib << 10);
    [of_machine, of_control_group(), of_address_space()].into_iter().flatten().min()
}

/// What the control group leaves, of version 2 or 1.
fn of_control_group() -> Option<u64> {
    let number = |name: &str| fs::read_to_string(format!("/sys/fs/cgroup/{name}")).ok()?.trim().parse::<u64>().ok();
    let left = |limit: &str, used: &str| Some(number(limit)?.saturating_sub(number(used)?));
    left("memory.max", "memory.current")
        .or_else(|| left("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes"))
}

/// What `ulimit -v` leaves.
fn of_address_space() -> Option<u64> {
    let limits = fs::read_to_string("/proc/self/limits").ok()?;
    let limit = limits
        .lines()
        .find_map(|line| line.strip_prefix("Max address space")?.split_whitespace().next()?.parse::<u64>().ok())?;
    let used = fs::read_to_string("/proc/self/status").ok().and_then(|text| field(&text, "VmSize:"))? << 10;
    Some(limit.saturating_sub(used))
}

/// The number after a name at the start of a line.
fn field(text: &str, name: &str) -> Option<u64> {
    text.lines().find_map(|line| line.strip_prefix(name)?.split_whitespace().next()?.parse().ok())
}

fn gigabytes(bytes: u64) -> String {
    format!("{:.1} GB", bytes as f64 / 1e9)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_os = "linux")]
    fn what_is_more_than_there_is_is_refused_in_words() {
        assert!(available().is_some_and(|bytes| bytes > 1 << 20));
        require(1, || unreachable!()).unwrap();
        let refused = require(1 << 60, || "a batch".into()).unwrap_err().to_string();
        assert!(refused.starts_with("a batch: takes about 1152921504.6 GB; "), "{refused}");
        let refused = require_pictures(1 << 24, 1 << 24, 3).unwrap_err().to_string();
        assert!(refused.contains("16777216 x 16777216 pixels and 3 more of that size: takes about 90071"), "{refused}");
    }

    #[test]
    fn the_variable_is_in_megabytes() {
        assert_eq!((allowed(None).unwrap(), allowed(Some("3")).unwrap()), (None, Some(3 << 20)));
        for wrong in ["", "3G", "-1", "99999999999999999"] {
            assert!(allowed(Some(wrong)).is_err(), "{wrong}");
        }
    }
}
