//! State of a sweep's jobs in Slurm.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
    process::Command,
};

use anyhow::{Result, ensure};
use serde::{Deserialize, Serialize};

/// A submitted job, as a line of the folder's list.
#[derive(Serialize, Deserialize)]
pub struct SubmittedJob {
    /// Number of the job.
    pub job: String,
    /// Number of tasks in its array.
    pub tasks: u32,
}

/// File that lists submitted jobs, in the folder of a sweep.
pub const JOBS_FILE: &str = "slurm.jsonl";

/// Answers of Slurm.
#[derive(Debug, PartialEq, Serialize)]
pub struct Queue {
    /// Submitted jobs.
    pub jobs: Vec<String>,
    /// Programs that answered.
    pub asked: Vec<&'static str>,
    /// Tasks by name, `JOB_TASK`.
    pub tasks: BTreeMap<String, Task>,
}

/// State of a task of an array.
#[derive(Debug, PartialEq, Eq, Serialize)]
pub struct Task {
    /// Slurm's name of the state: `PENDING`, `RUNNING`, `COMPLETED`, ...
    pub state: String,
    /// Exit code and signal, `0:0`, if accounts are kept.
    pub exit: Option<String>,
}

impl Queue {
    /// Asks `squeue`, and `sacct` if Slurm keeps accounts; `None` if nothing was submitted from this folder.
    ///
    /// # Errors
    /// If the folder's list of jobs cannot be read.
    pub fn ask(folder: &Path) -> Result<Option<Self>> {
        let list = folder.join(JOBS_FILE);
        let Ok(text) = fs::read_to_string(&list) else { return Ok(None) };
        let jobs: Vec<String> = text
            .lines()
            .filter_map(|line| serde_json::from_str::<SubmittedJob>(line).ok())
            .filter_map(|submitted| job_number(&submitted.job))
            .collect();
        ensure!(!jobs.is_empty(), "{}: no line of it names a job", list.display());
        let names = jobs.join(",");
        let format = ["--format", "JobID,State,ExitCode"];
        let accounts =
            answer("sacct", &[&["--noheader", "--allocations", "--parsable2", "--jobs", &names], &format[..]].concat());
        let queue = answer("squeue", &["--noheader", "--array", "--jobs", &names, "--format", "%i|%T"]);
        let mut found = Self { jobs, asked: Vec::new(), tasks: BTreeMap::new() };
        // In this order, since the queue is more recent on waiting and running tasks.
        for (program, answer) in [("sacct", accounts), ("squeue", queue)] {
            let Some(answer) = answer else { continue };
            found.asked.push(program);
            plain_lines(&answer).for_each(|line| found.add(&line));
        }
        Ok(Some(found))
    }

    /// Adds a line of an answer: `JOB_TASK|STATE` and possibly `|EXIT`. Other lines are messages.
    fn add(&mut self, line: &str) {
        let mut fields = line.split('|').map(str::trim);
        let (Some(task), Some(state)) = (fields.next(), fields.next()) else { return };
        if !self.jobs.iter().any(|job| task.split('_').next() == Some(job)) {
            return;
        }
        // "CANCELLED by 1000"
        let state = state.split(' ').next().unwrap_or_default().to_owned();
        let exit = fields.next().map(str::to_owned);
        for task in expanded(task) {
            self.tasks.insert(task, Task { state: state.clone(), exit: exit.clone() });
        }
    }

    /// Summarises the answers in a few lines: the number of tasks per state, and the tasks that failed.
    pub fn lines(&self) -> Vec<String> {
        let jobs = self.jobs.join(", ");
        if self.asked.is_empty() {
            return vec![format!("Slurm: jobs {jobs} were sent; neither squeue nor sacct says anything of them here")];
        }
        let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
        self.tasks.values().for_each(|task| *counts.entry(&task.state).or_default() += 1);
        let counts: Vec<String> = counts.iter().map(|(state, count)| format!("{count} {state}")).collect();
        let counts = if counts.is_empty() { "no task waits or runs".to_owned() } else { counts.join(", ") };
        let mut lines = vec![format!("Slurm: jobs {jobs}: {counts} ({})", self.asked.join(", "))];
        const SHOWN: usize = 20;
        let bad = || self.tasks.iter().filter(|(_, task)| task.is_bad());
        lines.extend(bad().take(SHOWN).map(|(name, Task { state, exit })| {
            let exit = exit.as_deref().map_or(String::new(), |exit| format!(", exit {exit}"));
            format!("Slurm: task {name}: {state}{exit}")
        }));
        let more = bad().count().saturating_sub(SHOWN);
        lines.extend((more > 0).then(|| format!("... and {more} more tasks that ended badly")));
        lines
    }
}

impl Task {
    /// Whether the task ended, neither regularly nor to be queued again.
    fn is_bad(&self) -> bool {
        const GOOD: [&str; 8] =
            ["PENDING", "CONFIGURING", "RUNNING", "COMPLETING", "COMPLETED", "REQUEUED", "REQUEUE_HOLD", "SUSPENDED"];
        !GOOD.contains(&self.state.as_str())
    }
}

/// Returns the job number in the output of `sbatch`, among any messages of its wrappers and plugins: after
/// `Submitted batch job`, else on a line of its own, with or without `;CLUSTER`. `None` if there is none or
/// if several differ.
pub fn job_number(output: &str) -> Option<String> {
    let lines: Vec<String> = plain_lines(output).collect();
    let submitted = lines.iter().filter_map(|line| line.split_once("Submitted batch job ")?.1.split(' ').next());
    let alone =
        |has_cluster: bool| lines.iter().map(String::as_str).filter(move |line| line.contains(';') == has_cluster);
    let number = |text: &str| {
        let (number, cluster) = text.split_once(';').unwrap_or((text, "_"));
        let is_number =
            number.bytes().all(|byte| byte.is_ascii_digit()) && !number.is_empty() && !number.starts_with('0');
        let is_cluster = !cluster.is_empty() && cluster.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c));
        (is_number && is_cluster).then(|| number.to_owned())
    };
    let forms: [Vec<&str>; 3] = [submitted.collect(), alone(true).collect(), alone(false).collect()];
    let numbers = forms.map(|form| form.into_iter().filter_map(number).collect::<BTreeSet<String>>());
    let mut found = numbers.into_iter().find(|numbers| !numbers.is_empty())?;
    found.pop_first().filter(|_| found.is_empty())
}

/// Returns the lines of a program's output without colours and surrounding space.
pub fn plain_lines(output: &str) -> impl Iterator<Item = String> {
    let plain = console::strip_ansi_codes(output).replace('\r', "\n");
    plain.lines().map(|line| line.trim().to_owned()).collect::<Vec<_>>().into_iter()
}

/// Maximum number of tasks in one name.
const MOST_TASKS: usize = 100_000;

/// Expands a name to its tasks: `sacct` lists waiting tasks in one line, as in `31_[2-4,7%2]`. Names without
/// a list are returned unchanged.
fn expanded(name: &str) -> Vec<String> {
    let list = name.split_once("_[").and_then(|(job, list)| Some((job, list.strip_suffix(']')?)));
    let Some((job, list)) = list else { return vec![name.to_owned()] };
    let list = list.split('%').next().unwrap_or_default();
    let range = |part: &str| {
        // "0-12:4": every fourth task.
        let (range, step) = part.split_once(':').unwrap_or((part, "1"));
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        Some((first.parse::<u32>().ok()?, last.parse::<u32>().ok()?, step.parse::<u32>().ok()?.max(1)))
    };
    let Some(ranges) = list.split(',').map(range).collect::<Option<Vec<_>>>() else { return vec![name.to_owned()] };
    let tasks = ranges.into_iter().flat_map(|(first, last, step)| (first..=last).step_by(step as usize));
    tasks.take(MOST_TASKS).map(|task| format!("{job}_{task}")).collect()
}

/// Returns the output of a command, if it succeeds.
fn answer(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failed_tasks_are_named() {
        let mut queue = Queue { jobs: vec!["7".into()], asked: vec!["sacct"], tasks: BTreeMap::new() };
        for line in ["7_0|COMPLETED|0:0", "7_1|FAILED|1:0", "7_2|CANCELLED by 12|0:15", "7_3|RUNNING|0:0", "torn"] {
            queue.add(line);
        }
        assert_eq!(
            queue.lines(),
            [
                "Slurm: jobs 7: 1 CANCELLED, 1 COMPLETED, 1 FAILED, 1 RUNNING (sacct)",
                "Slurm: task 7_1: FAILED, exit 1:0",
                "Slurm: task 7_2: CANCELLED, exit 0:15",
            ]
        );
    }

    #[test]
    fn messages_are_not_tasks() {
        let mut queue = Queue { jobs: vec!["7".into()], asked: vec!["squeue"], tasks: BTreeMap::new() };
        let answer = "\x1b[1m| Welcome | to cluster 7 |\x1b[0m\r\n2030|NEWS\r\n\x1b[32m7_0|RUNNING\x1b[0m\r\n70_1|FAILED\r\nBye | bye\r\n";
        plain_lines(answer).for_each(|line| queue.add(&line));
        assert_eq!(queue.lines(), ["Slurm: jobs 7: 1 RUNNING (squeue)"]);
    }

    #[test]
    fn job_numbers_are_found_among_messages() {
        for (output, expected) in [
            ("519605\n", Some("519605")),
            ("519605;north-1\n", Some("519605")),
            ("Sun Jul  7 03:08:22 2030 [INFO4] auks_krb5_cred: cred of 12 bytes\n519605\n", Some("519605")),
            ("519605\nsbatch: 3 of 10 jobs used\n2030-07-07 done\n", Some("519605")),
            ("Submitted batch job 519605 on cluster north\n", Some("519605")),
            ("100\nsbatch: Submitted batch job 519605\n100 hours are left\n", Some("519605")),
            ("12\n519605;north\n", Some("519605")),
            ("\x1b[33mQuota: 12 of 40\x1b[0m\r\n\x1b[1;32m519605\x1b[0m\r\n", Some("519605")),
            ("loading 10 %\rloading 100 %\r519605\n", Some("519605")),
            ("519605\n519605\n", Some("519605")),
            ("", None),
            ("sbatch: queued as 519605 of 2030\n", None),
            ("12\n519605\n", None),
            ("0\n-5\n1.5\n12;\n12;a b\n", None),
        ] {
            assert_eq!(job_number(output).as_deref(), expected, "{output:?}");
        }
    }

    #[test]
    fn lists_of_waiting_tasks_are_expanded() {
        let names = |name: &str| expanded(name).join(" ");
        assert_eq!(names("7_[2-4,9%2]"), "7_2 7_3 7_4 7_9");
        assert_eq!(names("7_[0-8:4]"), "7_0 7_4 7_8");
        // Names without a list are unchanged, and long lists are limited.
        for name in ["7_3", "7", "7_[", "7_[]", "7_[a-b]", "7_[1-2"] {
            assert_eq!(names(name), name);
        }
        assert_eq!(expanded("7_[0-4294967295]").len(), MOST_TASKS);
    }
}
