//! How much memory there is, so that what is too large is refused by a sentence instead of by the system.

use std::{fs, path::Path};

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

/// What the process's control group and those around it leave, of version 2 and 1.
fn of_control_group() -> Option<u64> {
    let own = fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    left_by_groups(&own, Path::new("/sys/fs/cgroup"))
}

/// The least that a group leaves: `own` is `/proc/self/cgroup`, whose lines are `number:controllers:path`, and groups are folders below `root`.
fn left_by_groups(own: &str, root: &Path) -> Option<u64> {
    // Where the process sees its groups under other names, as in a container, the outermost one is its own.
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

/// Names of a group's limit, of what it uses, and of the field of `memory.stat` that says how much of that is a cache which gives way.
type Files = [&'static str; 3];
const V2: Files = ["memory.max", "memory.current", "inactive_file"];
const V1: Files = ["memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"];

/// What a group's own limit leaves, if it has one.
fn left_by(group: &Path, [limit, used, cached]: Files) -> Option<u64> {
    let number = |name: &str| fs::read_to_string(group.join(name)).ok()?.trim().parse::<u64>().ok();
    let limit = number(limit)?;
    let statistics = fs::read_to_string(group.join("memory.stat")).unwrap_or_default();
    let cached = field(&statistics, cached).unwrap_or(0);
    Some(limit.saturating_sub(number(used)?.saturating_sub(cached)))
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
    fn limits_of_a_job_stand_in_the_groups_around_its_own() {
        let step = "system.slice/slurmstepd.scope/job_1/step_0/user/task_0";
        let job = "system.slice/slurmstepd.scope/job_1";
        let root = groups(V2, &[(step, "max", 1000), (job, "5000", 2000)]);
        let own = format!("0::/{step}\n");
        assert_eq!(left_by_groups(&own, root.path()), Some(3000));
        // What a cache takes can be had back.
        fs::write(root.path().join(job).join("memory.stat"), "anon 900\ninactive_file 1100\n").unwrap();
        assert_eq!(left_by_groups(&own, root.path()), Some(4100));
        assert_eq!(left_by_groups("0::/elsewhere\n", root.path()), None);

        let root = groups(V1, &[("memory/slurm/uid_0/job_7", "700", 100), ("memory", "9000", 0)]);
        let own = "11:cpu,cpuacct:/slurm\n10:memory:/slurm/uid_0/job_7/step_0\n0::/\n";
        assert_eq!(left_by_groups(own, root.path()), Some(600));
        // Seen under another name from within a container.
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
