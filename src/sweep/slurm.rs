//! A sweep on a Slurm cluster: one array job, whose tasks work like other workers.

use std::{
    fs::OpenOptions,
    io::Write,
    path::Path,
    process::{Command, Output},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use headtail_render::path_text::{path_of, text_of};

use super::{
    Sweep, jobs,
    location::{Checkpoints, SweepLocation},
    queue::{JOBS_FILE, SubmittedJob, job_number, plain_lines},
    worker::{self, Manner},
};
use crate::terminal::{note, out};
use crate::{
    output::{check_output, make_folder},
    progress,
};

/// Submit one array job to Slurm, print its number and return.
#[derive(Args)]
pub struct Arguments {
    #[command(flatten)]
    location: SweepLocation,
    #[command(flatten)]
    checkpoints: Checkpoints,
    /// Tasks of the array. Default: one per open trial, up to 1000.
    /// Each task takes trials until none is left.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    tasks: Option<u32>,
    /// Maximum number of simultaneous tasks. Default: no limit.
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..))]
    at_once: Option<u32>,
    /// Pass an option to sbatch, as in --sbatch=--time=4:00:00.
    /// May be repeated. Lines of SPACE.toml that begin with #SBATCH are passed on, too.
    #[arg(long, value_name = "OPTION", allow_hyphen_values = true)]
    sbatch: Vec<String>,
    /// Write the job's script without submitting it.
    #[arg(long)]
    dry_run: bool,
}

const SCRIPT: &str = "slurm.sh";
/// Default maximum of tasks: the size of an array in Slurm's usual settings.
const MOST_TASKS: usize = 1000;

/// Writes the script and submits it.
pub fn submit(arguments: &Arguments) -> Result<()> {
    let sweep = arguments.location.open()?;
    let open = (0..sweep.plan.trials.len()).filter(|&trial| !jobs::is_over(&sweep.plan, &sweep.ledger, trial)).count();
    let open = if sweep.wants_suggestions() { open.max(8) } else { open };
    ensure!(open > 0, "no trial is left to do");
    let tasks = arguments.tasks.unwrap_or(open.min(MOST_TASKS) as u32);
    make_folder(&sweep.folder.logs())?;
    let script = sweep.folder.path().join(SCRIPT);
    check_output(&script)?;
    // Decodes the file names in it.
    let text = path_of(&text(arguments, &sweep, tasks)?);
    headtail_render::file::replace(&script, text.as_os_str().as_encoded_bytes())?;
    if arguments.dry_run {
        out!("{} written", script.display());
        return Ok(());
    }
    let output = Command::new("sbatch").arg("--parsable").arg(&script).output();
    let output = output.context("sbatch: Slurm's client is not to be found on this machine")?;
    ensure!(output.status.success(), "sbatch: {}", String::from_utf8_lossy(&output.stderr).trim());
    let job = job_number(&String::from_utf8_lossy(&output.stdout)).with_context(|| {
        let said = [&output.stdout, &output.stderr].map(|said| String::from_utf8_lossy(said).trim().to_owned());
        format!(
            "sbatch: no job number is found in its output, {:?}; squeue --me lists the job if it was submitted",
            said.join("\n")
        )
    })?;
    let mut list = OpenOptions::new().create(true).append(true).open(sweep.folder.path().join(JOBS_FILE))?;
    list.write_all((serde_json::to_string(&SubmittedJob { job: job.clone(), tasks })? + "\n").as_bytes())?;
    out!("{job}");
    Ok(())
}

/// Returns the job's script, a text in which paths keep every byte (see [`headtail_render::path_text`]).
fn text(arguments: &Arguments, sweep: &Sweep, tasks: u32) -> Result<String> {
    let absolute = |path: &Path| -> Result<String> {
        let path = std::path::absolute(path).with_context(|| path.display().to_string())?;
        Ok(text_of(&path).into_owned())
    };
    let here = std::env::current_dir().context("the working folder")?;
    let program = std::env::current_exe().context("the program's own file")?;
    let limit = arguments.at_once.map_or(String::new(), |at_once| format!("%{at_once}"));
    let name = text_of(Path::new(arguments.location.space.file_stem().unwrap_or_default()));
    // In names of logs, Slurm's numbers begin with a percent sign.
    let log = format!("{}/slurm-%A_%a.log", absolute(&sweep.folder.logs())?.replace('%', "%%"));
    let mut text = String::from("#!/bin/bash\n");
    let own = [
        format!("--job-name={}", quoted(&name)),
        format!("--array=0-{}{limit}", tasks - 1),
        "--requeue".into(),
        "--open-mode=append".into(),
        // Two minutes before the time limit, and to the program itself, which replaces the shell.
        "--signal=B:USR1@120".into(),
        format!("--output={}", quoted(&log)),
    ];
    let file = headtail_render::file::read_text(&arguments.location.space)
        .with_context(|| arguments.location.space.display().to_string())?;
    let lines = file.lines().filter_map(|line| line.strip_prefix("#SBATCH"));
    let lines = lines.filter(|line| line.starts_with([' ', '\t'])).map(str::trim);
    let given =
        lines.chain(arguments.sbatch.iter().map(String::as_str)).map(|line| text_of(Path::new(line)).into_owned());
    // If an option is given twice, the last one counts.
    for option in own.into_iter().chain(given) {
        ensure!(!option.contains('\n'), "--sbatch: an option is one line");
        text += &format!("#SBATCH {option}\n");
    }
    text += &format!("cd {}\n", quoted(&absolute(&here)?));
    text += "export RAYON_NUM_THREADS=\"${SLURM_CPUS_PER_TASK:-1}\"\n";
    text += &format!(
        "exec {} sweep work {} --out {} --task --checkpoint-every {}\n",
        quoted(&absolute(&program)?),
        quoted(&absolute(&arguments.location.space)?),
        quoted(&absolute(sweep.folder.path())?),
        arguments.checkpoints.checkpoint_every
    );
    Ok(text)
}

/// Quotes a word for the shell.
pub fn quoted(text: &str) -> String {
    let plain = text.chars().all(|c| c.is_ascii_alphanumeric() || "-_./:,=+%".contains(c));
    if plain && !text.is_empty() { text.to_owned() } else { format!("'{}'", text.replace('\'', "'\\''")) }
}

/// Returns the job of this process, `JOB_TASK`: the number of an array's last task alone would mean the whole
/// array.
fn own_job() -> Option<String> {
    let of = |name| std::env::var(name).ok();
    of("SLURM_ARRAY_JOB_ID")
        .zip(of("SLURM_ARRAY_TASK_ID"))
        .map(|(job, task)| format!("{job}_{task}"))
        .or_else(|| of("SLURM_JOB_ID"))
}

/// Whether Slurm has ended this job, as by `scancel`: requeuing would then act against the user. The signal
/// before the time limit is not such an end: it arrives while the job runs, however long the last checkpoint
/// takes.
fn is_cancelled(job: &str) -> bool {
    const ENDS: [&str; 2] = ["COMPLETING", "CANCELLED"];
    let output = Command::new("squeue").args(["--noheader", "--jobs", job, "--format", "%T"]).output();
    !progress::is_user_signal()
        && output.is_ok_and(|output| {
            plain_lines(&String::from_utf8_lossy(&output.stdout)).any(|line| ENDS.contains(&&*line))
        })
}

fn queue_again(job: &str) {
    // Before the request, because Slurm ends the job when it requeues it.
    note!("job {job} asks to be queued again");
    match Command::new("scontrol").args(["requeue", job]).output() {
        Ok(output) if output.status.success() => {}
        Ok(Output { stderr, .. }) => {
            note!("job {job} is not queued again: {}", String::from_utf8_lossy(&stderr).trim());
        }
        Err(error) => note!("job {job} is not queued again: scontrol: {error}"),
    }
}

/// Runs a task of the array: a worker that asks to be requeued when it is told to stop.
pub fn task(sweep: &mut Sweep, manner: Manner, stop: &Arc<AtomicBool>) -> Result<()> {
    progress::stop_at_user_signal()?;
    let ended = worker::work(sweep, manner, stop);
    if stop.load(Ordering::Relaxed)
        && let Some(job) = own_job()
    {
        if is_cancelled(&job) {
            note!("job {job} was cancelled, and is not queued again");
        } else {
            queue_again(&job);
        }
    }
    ended?;
    let failed = sweep
        .plan
        .trials
        .iter()
        .filter_map(|trial| sweep.ledger.record(&trial.id))
        .filter(|record| record.failure().is_some())
        .count();
    if failed > 0 {
        bail!("{failed} trials of the sweep failed");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_for_the_shell_are_quoted() {
        assert_eq!(quoted("/a/b-c.toml"), "/a/b-c.toml");
        assert_eq!(quoted("it's here"), "'it'\\''s here'");
        assert_eq!(quoted("$(rm)"), "'$(rm)'");
    }
}
