//! Peak resident memory of this process, where the system reports it (Linux).

use std::fs;

/// Resets the peak, if the system permits it.
pub fn reset() {
    // "5" resets the peak (proc(5), clear_refs). If this fails, the peak is that of the whole process.
    let _ = fs::write("/proc/self/clear_refs", "5");
}

/// Returns the peak in bytes since the last [`reset`].
pub fn bytes() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? * 1024)
}
