//! State of a sweep's jobs in Slurm.

use std::{collections::BTreeMap, fs, path::Path, process::Command};

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
            .map(|submitted| submitted.job)
            .collect();
        ensure!(!jobs.is_empty(), "{}: no line of it can be read", list.display());
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
            answer.lines().for_each(|line| found.add(line));
        }
        Ok(Some(found))
    }

    /// Adds a line of an answer: `JOB_TASK|STATE` and possibly `|EXIT`.
    fn add(&mut self, line: &str) {
        let mut fields = line.split('|').map(str::trim);
        let (Some(task), Some(state)) = (fields.next(), fields.next()) else { return };
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
