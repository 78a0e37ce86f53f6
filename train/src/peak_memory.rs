//! The most memory that this process has had resident, where the system says (Linux).

use std::fs;

/// Starts to measure anew, if the system lets us.
pub fn reset() {
    // "5" resets the peak (proc(5), clear_refs). Without it the peak is that of the whole process: larger, not wrong.
    let _ = fs::write("/proc/self/clear_refs", "5");
}

/// The peak since the last [`reset`].
pub fn bytes() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? * 1024)
}
