//! Available memory, so that oversized work fails with an error instead of being killed by the system.

use std::{fs, path::Path};

use crate::error::{Error, Result};

/// The environment variable that limits memory, in MB of 2^20 bytes.
const VARIABLE: &str = "HEADTAIL_MEMORY";
/// Bytes of a pixel during rendering and writing: sums, three images and their encoded form.
const BYTES_PER_PIXEL: u64 = 200;
/// Bytes of a pixel of a finished picture, with the images derived from it.
const BYTES_PER_KEPT_PIXEL: u64 = 40;

/// Rejects work that needs more memory than is available or `HEADTAIL_MEMORY` (in MB of 2^20 bytes) allows.
///
/// `what` names the work. If neither the variable nor the system gives a limit, all work is accepted.
///
/// # Errors
/// [`Error::Argument`] with both numbers, or if `HEADTAIL_MEMORY` is not a number.
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

/// Rejects pictures that need more memory than is available: one to render and write, and `kept`
/// finished ones of the same size in pixels.
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

/// The limit of the environment variable, in bytes.
fn allowed(variable: Option<&str>) -> Result<Option<u64>> {
    let megabytes = |text: &str| text.parse::<u64>().ok().filter(|megabytes| *megabytes < 1 << 44);
    let wrong = || Error::argument(VARIABLE, "is a whole number of MB");
    variable.map(|text| Ok(megabytes(text).ok_or_else(wrong)? << 20)).transpose()
}

/// Returns the bytes that this process can still allocate: the least that the machine, its control
/// groups and its limits leave; `None` where the system gives none of these.
pub fn available() -> Option<u64> {
    let of_machine =
        fs::read_to_string("/proc/meminfo").ok().and_then(|text| field(&text, "MemAvailable:")).map(|kib| kib << 10);
    [of_machine, of_control_group(), of_address_space()].into_iter().flatten().min()
}

/// Bytes left by the process's control groups (versions 2 and 1) and their ancestors.
fn of_control_group() -> Option<u64> {
    let own = fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    left_by_groups(&own, Path::new("/sys/fs/cgroup"))
}

/// The least that a group leaves: `own` is the content of `/proc/self/cgroup`, with lines
/// `number:controllers:path`; groups are folders below `root`.
fn left_by_groups(own: &str, root: &Path) -> Option<u64> {
    // In a container, paths may differ from those in `own`; there the root is the process's own group.
    let mut least = [left_by(root, V2), left_by(&root.join("memory"), V1)].into_iter().flatten().min();
    for line in own.lines() {
        let mut parts = line.splitn(3, ':');
        let (Some(_), Some(controllers), Some(path)) = (parts.next(), parts.next(), parts.next()) else { continue };
        let (root, files) = match controllers {
            "" => (root.to_owned(), V2),
            _ if controllers.split(',').any(|name| name == "memory") => (root.join("memory"), V1),
            _ => continue,
        };
        let group = Path::new(path.trim_start_matches('/'));
        let left = group.ancestors().filter_map(|group| left_by(&root.join(group), files)).min();
        least = [least, left].into_iter().flatten().min();
    }
    least
}

/// Names of the files of a group's limit and usage, and of the field of `memory.stat` with the
/// reclaimable cache.
type Files = [&'static str; 3];
const V2: Files = ["memory.max", "memory.current", "inactive_file"];
const V1: Files = ["memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"];

/// Bytes left by a group's own limit, if it has one.
fn left_by(group: &Path, [limit, used, cached]: Files) -> Option<u64> {
    let number = |name: &str| fs::read_to_string(group.join(name)).ok()?.trim().parse::<u64>().ok();
    let limit = number(limit)?;
    let statistics = fs::read_to_string(group.join("memory.stat")).unwrap_or_default();
    let cached = field(&statistics, cached).unwrap_or(0);
    Some(limit.saturating_sub(number(used)?.saturating_sub(cached)))
}

/// Bytes left by `ulimit -v`.
fn of_address_space() -> Option<u64> {
    let limits = fs::read_to_string("/proc/self/limits").ok()?;
    let limit = limits
        .lines()
        .find_map(|line| line.strip_prefix("Max address space")?.split_whitespace().next()?.parse::<u64>().ok())?;
    let used = fs::read_to_string("/proc/self/status").ok().and_then(|text| field(&text, "VmSize:"))? << 10;
    Some(limit.saturating_sub(used))
}

/// Parses the number after a name at the start of a line.
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
    fn oversized_work_is_rejected_with_both_sizes() {
        assert!(available().is_some_and(|bytes| bytes > 1 << 20));
        require(1, || unreachable!()).unwrap();
        let refused = require(1 << 60, || "a batch".into()).unwrap_err().to_string();
        assert!(refused.starts_with("a batch: takes about 1152921504.6 GB; "), "{refused}");
        let refused = require_pictures(1 << 24, 1 << 24, 3).unwrap_err().to_string();
        assert!(refused.contains("16777216 x 16777216 pixels and 3 more of that size: takes about 90071"), "{refused}");
    }

    /// Groups as folders: (path, limit, use).
    fn groups(files: Files, groups: &[(&str, &str, u64)]) -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        for (path, limit, used) in groups {
            let folder = root.path().join(path);
            fs::create_dir_all(&folder).unwrap();
            fs::write(folder.join(files[0]), format!("{limit}\n")).unwrap();
            fs::write(folder.join(files[1]), format!("{used}\n")).unwrap();
        }
        root
    }

    #[test]
    fn limits_of_ancestor_groups_apply() {
        let step = "system.slice/slurmstepd.scope/job_1/step_0/user/task_0";
        let job = "system.slice/slurmstepd.scope/job_1";
        let root = groups(V2, &[(step, "max", 1000), (job, "5000", 2000)]);
        let own = format!("0::/{step}\n");
        assert_eq!(left_by_groups(&own, root.path()), Some(3000));
        // Inactive cache is reclaimable.
        fs::write(root.path().join(job).join("memory.stat"), "anon 900\ninactive_file 1100\n").unwrap();
        assert_eq!(left_by_groups(&own, root.path()), Some(4100));
        assert_eq!(left_by_groups("0::/elsewhere\n", root.path()), None);

        let root = groups(V1, &[("memory/slurm/uid_0/job_7", "700", 100), ("memory", "9000", 0)]);
        let own = "11:cpu,cpuacct:/slurm\n10:memory:/slurm/uid_0/job_7/step_0\n0::/\n";
        assert_eq!(left_by_groups(own, root.path()), Some(600));
        // The path differs inside a container.
        assert_eq!(left_by_groups("10:memory:/docker/abc\n", root.path()), Some(9000));
    }

    #[test]
    fn the_variable_is_in_megabytes() {
        assert_eq!((allowed(None).unwrap(), allowed(Some("3")).unwrap()), (None, Some(3 << 20)));
        for wrong in ["", "3G", "-1", "99999999999999999"] {
            assert!(allowed(Some(wrong)).is_err(), "{wrong}");
        }
    }
}
