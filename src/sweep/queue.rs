//! What Slurm says of the jobs that a sweep was sent as.

use std::{collections::BTreeMap, fs, path::Path, process::Command};

use anyhow::{Result, ensure};
use serde::{Deserialize, Serialize};

/// A job that was sent, as a line of the folder's list.
#[derive(Serialize, Deserialize)]
pub struct Sent {
    /// Its number.
    pub job: String,
    /// Tasks of its array.
    pub tasks: u32,
}

/// The list of jobs that were sent, in the folder of a sweep.
pub const SENT: &str = "slurm.jsonl";

/// Slurm's answers.
#[derive(Debug, PartialEq, Serialize)]
pub struct Queue {
    /// The jobs that were sent.
    pub jobs: Vec<String>,
    /// Programs that said something of them.
    pub asked: Vec<&'static str>,
    /// Tasks by their names, `JOB_TASK`.
    pub tasks: BTreeMap<String, Task>,
}

/// Where a task of an array is.
#[derive(Debug, PartialEq, Eq, Serialize)]
pub struct Task {
    /// Slurm's word: `PENDING`, `RUNNING`, `COMPLETED`, ...
    pub state: String,
    /// Exit code and signal, `0:0`, where accounts are kept.
    pub exit: Option<String>,
}

impl Queue {
    /// Asks `squeue`, and `sacct` where Slurm keeps accounts; `None` if nothing was sent from this folder.
    ///
    /// # Errors
    /// If the folder's list of jobs cannot be read.
    pub fn ask(folder: &Path) -> Result<Option<Self>> {
        let list = folder.join(SENT);
        let Ok(text) = fs::read_to_string(&list) else { return Ok(None) };
        let jobs: Vec<String> =
            text.lines().filter_map(|line| serde_json::from_str::<Sent>(line).ok()).map(|sent| sent.job).collect();
        ensure!(!jobs.is_empty(), "{}: no line of it can be read", list.display());
        let names = jobs.join(",");
        let format = ["--format", "JobID,State,ExitCode"];
        let accounts =
            answer("sacct", &[&["--noheader", "--allocations", "--parsable2", "--jobs", &names], &format[..]].concat());
        let queue = answer("squeue", &["--noheader", "--array", "--jobs", &names, "--format", "%i|%T"]);
        let mut found = Self { jobs, asked: Vec::new(), tasks: BTreeMap::new() };
        // What waits and runs is known to the queue first.
        for (program, answer) in [("sacct", accounts), ("squeue", queue)] {
            let Some(answer) = answer else { continue };
            found.asked.push(program);
            answer.lines().for_each(|line| found.add(line));
        }
        Ok(Some(found))
    }

    /// A line of an answer: `JOB_TASK|STATE` and maybe `|EXIT`.
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

    /// The answers in a few lines: how many tasks are in which state, and those that ended badly.
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
    /// Whether it ended, and neither in order nor to be queued again.
    fn is_bad(&self) -> bool {
        const GOOD: [&str; 8] =
            ["PENDING", "CONFIGURING", "RUNNING", "COMPLETING", "COMPLETED", "REQUEUED", "REQUEUE_HOLD", "SUSPENDED"];
        !GOOD.contains(&self.state.as_str())
    }
}

/// Most tasks that one name stands for.
const MOST_TASKS: usize = 100_000;

/// The tasks that a name stands for: `sacct` has those that wait in one line, as in `31_[2-4,7%2]`. A name that is no list stands for itself.
fn expanded(name: &str) -> Vec<String> {
    let list = name.split_once("_[").and_then(|(job, list)| Some((job, list.strip_suffix(']')?)));
    let Some((job, list)) = list else { return vec![name.to_owned()] };
    let list = list.split('%').next().unwrap_or_default();
    let range = |part: &str| {
        // "0-12:4": every fourth.
        let (range, step) = part.split_once(':').unwrap_or((part, "1"));
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        Some((first.parse::<u32>().ok()?, last.parse::<u32>().ok()?, step.parse::<u32>().ok()?.max(1)))
    };
    let Some(ranges) = list.split(',').map(range).collect::<Option<Vec<_>>>() else { return vec![name.to_owned()] };
    let tasks = ranges.into_iter().flat_map(|(first, last, step)| (first..=last).step_by(step as usize));
    tasks.take(MOST_TASKS).map(|task| format!("{job}_{task}")).collect()
}

/// The output of a command that succeeds.
fn answer(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tasks_that_ended_badly_are_named() {
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
    fn tasks_that_wait_are_told_apart() {
        let names = |name: &str| expanded(name).join(" ");
        assert_eq!(names("7_[2-4,9%2]"), "7_2 7_3 7_4 7_9");
        assert_eq!(names("7_[0-8:4]"), "7_0 7_4 7_8");
        // What is no list is left as it is, and a list is no reason to run out of memory.
        for name in ["7_3", "7", "7_[", "7_[]", "7_[a-b]", "7_[1-2"] {
            assert_eq!(names(name), name);
        }
        assert_eq!(expanded("7_[0-4294967295]").len(), MOST_TASKS);
    }
}
