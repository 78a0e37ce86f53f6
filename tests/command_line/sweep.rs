//! Sweeps: trials run once, and survive kills, failures and signals.

use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    process::{Child, Command, Stdio},
    thread::sleep,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use super::{fail, folder, headtail, names, succeed, text};

/// Eight trials: four configurations, two seeds.
pub const SPACE: &str = r#"
objectives = ["relative_variance", "weights"]
[run]
env = "studio"
steps = 400
conditions = 8
validate_every = 100
validation_conditions = 8
validation_strata = 8
[axes]
head.bins = [4, 8]
learning_rate = { log = [4e-3, 1.6e-2], points = 2 }
seed = [0, 1]
[aggregate]
over = ["seed"]
"#;

/// Returns the rows of a table by trial, without columns of times.
pub fn rows(here: &Path, out: &str) -> BTreeMap<String, Vec<String>> {
    succeed(here, &format!("sweep collect space.toml --out {out}"));
    let mut reader = csv::Reader::from_path(here.join(out).join("trials.csv")).unwrap();
    let heads: Vec<String> = reader.headers().unwrap().iter().map(str::to_owned).collect();
    let records = reader.records().map(Result::unwrap);
    let row = |record: csv::StringRecord| {
        let cells = heads.iter().zip(&record).filter(|(head, _)| !head.contains("seconds") && *head != "folder");
        (record[0].to_owned(), cells.map(|(head, cell)| format!("{head}={cell}")).collect())
    };
    records.map(row).collect()
}

/// Returns all journals concatenated; empty if there are none.
fn journals(sweep: &Path) -> String {
    let entries = fs::read_dir(sweep.join("journal")).into_iter().flatten();
    // A kill can leave an incomplete line.
    entries.map(|entry| fs::read_to_string(entry.unwrap().path()).unwrap_or_default() + "\n").collect()
}

/// Returns the number of journal lines with this event.
pub fn events(sweep: &Path, event: &str) -> usize {
    journals(sweep).matches(&format!("\"event\":\"{event}\"")).count()
}

fn start(here: &Path, out: &str) -> Child {
    let arguments = format!("sweep run space.toml --out {out} --jobs 2 --threads 1 --checkpoint-every 20");
    let mut command = Command::new("env");
    command.args(["--default-signal", env!("CARGO_BIN_EXE_headtail")]).args(arguments.split_whitespace());
    let messages = fs::File::create(here.join("messages")).unwrap();
    command.current_dir(here).stdin(Stdio::null()).stdout(Stdio::null()).stderr(messages).spawn().unwrap()
}

#[cfg(target_os = "linux")]
fn signal(process: u32, name: &str) {
    // The process may have ended.
    let _ = Command::new("kill").args([name, &process.to_string()]).stderr(Stdio::null()).status().unwrap();
}

#[cfg(target_os = "linux")]
fn children(process: u32) -> Vec<u32> {
    let text = fs::read_to_string(format!("/proc/{process}/task/{process}/children")).unwrap_or_default();
    text.split_whitespace().filter_map(|id| id.parse().ok()).collect()
}

/// Pseudorandom numbers from a seed.
struct Numbers(u64);

impl Numbers {
    fn below(&mut self, bound: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % bound
    }
}

/// No machine has as many, and most builds have none.
#[test]
fn graphics_cards_that_are_not_there_are_refused_before_workers_start() {
    let here = folder();
    fs::write(here.path().join("space.toml"), SPACE).unwrap();
    assert!(fail(here.path(), "sweep run space.toml --gpus 1000").contains("--gpus"));
    assert!(!here.path().join("space.sweep").exists());
}

#[test]
fn sweeps_run_each_trial_once_and_changed_sweeps_only_new_ones() {
    let here = folder();
    let path = here.path();
    fs::write(path.join("space.toml"), SPACE).unwrap();
    assert!(succeed(path, "sweep plan space.toml").starts_with("8 trials of 4 configurations"));
    succeed(path, "sweep run space.toml --jobs 2 --threads 1");
    let sweep = path.join("space.sweep");
    assert_eq!((events(&sweep, "started"), events(&sweep, "done")), (8, 8));
    succeed(path, "sweep run space.toml");
    assert_eq!(events(&sweep, "started"), 8, "nothing twice");
    fs::write(path.join("space.toml"), SPACE.replace("seed = [0, 1]", "seed = [1, 2]")).unwrap();
    succeed(path, "sweep run space.toml --jobs 2 --threads 1");
    assert_eq!((events(&sweep, "started"), names(&sweep.join("trials")).len()), (12, 12));
    assert!(succeed(path, "sweep status space.toml").starts_with("8 trials: 8 done"));
    let collected: serde_json::Value = serde_json::from_str(&succeed(path, "sweep collect space.toml --json")).unwrap();
    assert_eq!(collected.as_array().unwrap().len(), 8);
    let row = &collected[0];
    assert!(row["state"] == "done" && row["measures"]["relative_variance"].as_f64().is_some(), "{row}");

    // A trial equals the run of its command.
    let id = rows(path, "space.sweep").into_keys().next().unwrap();
    succeed(path, &format!("fit --config space.sweep/trials/{id}/resolved.toml --out again"));
    let bytes = |file: &Path| fs::read(file.join("sampler.safetensors")).unwrap();
    assert_eq!(bytes(&path.join("again")), bytes(&sweep.join("trials").join(id)));
}

#[test]
fn failed_trials_are_named_and_retried_on_request() {
    let here = folder();
    let path = here.path();
    fs::write(path.join("space.toml"), SPACE.replace("head.bins = [4, 8]", "env = ['studio', 'none.hdr']")).unwrap();
    let error = fail(path, "sweep run space.toml --quiet");
    assert!(error.starts_with("4 of 8 trials failed"), "{error}");
    let status = succeed(path, "sweep status space.toml");
    assert!(status.starts_with("8 trials: 4 done, 4 failed") && status.contains("none.hdr"), "{status}");
    fail(path, "sweep run space.toml --quiet");
    assert_eq!(events(&path.join("space.sweep"), "failed"), 4, "not without being asked");
    assert!(succeed(path, "sweep retry space.toml").starts_with("4 trials"));
    fs::write(path.join("none.hdr"), super::radiance_file(8, 4, 128, 128)).unwrap();
    succeed(path, "sweep run space.toml");
    assert!(rows(path, "space.sweep").values().all(|row| row.contains(&"state=done".to_owned())));
}

#[test]
fn trials_are_identified_by_map_contents() {
    let here = folder();
    let path = here.path();
    let map = |name: &str, value: u8| fs::write(path.join(name), super::radiance_file(8, 4, value, value)).unwrap();
    let plan = |file: &str| {
        let space = SPACE.replace("env = \"studio\"", &format!("env = \"{file}\""));
        fs::write(path.join("space.toml"), space).unwrap();
        let trials: serde_json::Value = serde_json::from_str(&succeed(path, "sweep plan space.toml --json")).unwrap();
        let ids = trials.as_array().unwrap().iter().map(|trial| trial["id"].as_str().unwrap().to_owned());
        ids.collect::<Vec<_>>()
    };
    map("a.hdr", 100);
    map("same.hdr", 100);
    let first = plan("a.hdr");
    assert_eq!(first.len(), 8);
    assert_eq!(plan("same.hdr"), first);
    map("a.hdr", 101);
    assert!(plan("a.hdr").iter().all(|id| !first.contains(id)));
}

#[test]
fn halving_resumes_checkpoints_and_search_runs_its_count() {
    let here = folder();
    let path = here.path();
    let space = SPACE.replace("steps = 400\n", "").replace("head.bins = [4, 8]\n", "head.bins = [4, 6, 8]\n")
        + "[halving]\nrungs = [40, 80, 160]\nkeep = 2\n";
    fs::write(path.join("space.toml"), &space).unwrap();
    succeed(path, "sweep run space.toml --jobs 2 --threads 1");
    let done = rows(path, "space.sweep").values().filter(|row| row.contains(&"state=done".to_owned())).count();
    // Six configurations of two seeds, of which at least three and one are promoted. Promotion does not wait,
    // so others can be promoted early.
    assert!((2..=6).contains(&done), "{done}");
    let sweep = path.join("space.sweep");
    let lines = journals(&sweep);
    assert_eq!(lines.matches("\"step\":0}").count(), 12, "each trial begins once");
    assert!(lines.contains("\"step\":40}") && lines.contains("\"step\":80}"), "and goes on from its rungs");

    let space = SPACE.replace("points = 2 ", "") + "[search]\nmethod = 'tpe'\nn = 13\n";
    fs::write(path.join("space.toml"), space.replace("steps = 400", "steps = 20")).unwrap();
    succeed(path, "sweep run space.toml --out tpe --jobs 2 --threads 1");
    assert_eq!(events(&path.join("tpe"), "suggested"), 13);
    assert_eq!(rows(path, "tpe").len(), 26);

    // Both: configurations are generated during the sweep, and only some are promoted.
    let both = space.replace("steps = 400\n", "") + "[halving]\nrungs = [10, 20, 40]\nkeep = 3\n";
    fs::write(path.join("space.toml"), both).unwrap();
    succeed(path, "sweep run space.toml --out both --jobs 2 --threads 1");
    let sweep = path.join("both");
    assert_eq!((events(&sweep, "suggested"), events(&sweep, "failed")), (13, 0));
    let rungs = |step: usize| journals(&sweep).matches(&format!("\"step\":{step},\"measures\"")).count();
    // Two seeds each. One in three is promoted; those promoted early may no longer be in the best third.
    assert!(rungs(10) == 26 && (8..26).contains(&rungs(20)), "{} {}", rungs(10), rungs(20));
    assert!((2..=rungs(20)).contains(&events(&sweep, "done")), "{}", events(&sweep, "done"));
    succeed(path, "sweep run space.toml --out both");
    assert_eq!(events(&sweep, "suggested"), 13, "nothing twice");
}

#[test]
fn sweep_errors_are_one_line() {
    let here = folder();
    let path = here.path();
    assert!(fail(path, "sweep plan space.toml").contains("space.toml"));
    for (from, to, named) in [
        ("[run]", "[run]\nfast = true", "`fast`"),
        ("head.bins = [4, 8]", "head.bins = [4, 0]", "head.bins = 0"),
        ("seed = [0, 1]", "seed = 0", "`seed`"),
        ("over = [\"seed\"]", "over = [\"map\"]", "'map'"),
    ] {
        fs::write(path.join("space.toml"), SPACE.replace(from, to)).unwrap();
        let error = fail(path, "sweep plan space.toml");
        assert!(error.contains(named), "{error}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn an_interrupted_sweep_leaves_checkpoints_and_its_exit_status() {
    let here = folder();
    let path = here.path();
    fs::write(path.join("space.toml"), SPACE.replace("steps = 400", "steps = 100000")).unwrap();
    for (name, status) in [("-INT", 130), ("-TERM", 143)] {
        let mut process = start(path, "out");
        wait(|| !children(process.id()).is_empty() && checkpoints(&path.join("out")) > 0);
        if name == "-INT" {
            // Without a terminal, a progress line is printed; workers are stopped meanwhile.
            let workers = children(process.id());
            workers.iter().for_each(|&worker| signal(worker, "-STOP"));
            let said = || fs::read_to_string(path.join("messages")).unwrap();
            wait(|| said().contains("sweep: 0 %, "));
            assert!(said().contains("; 2 running, 6 waiting"), "{}", said());
            workers.iter().for_each(|&worker| signal(worker, "-CONT"));
        }
        let asked = Instant::now();
        signal(process.id(), name);
        assert_eq!(process.wait().unwrap().code(), Some(status));
        assert!(asked.elapsed() < Duration::from_secs(20), "{:?}", asked.elapsed());
    }
    let status = succeed(path, "sweep status space.toml --out out");
    assert!(status.contains("2 stopped") && status.contains("6 waiting"), "{status}");
    assert_eq!(events(&path.join("out"), "stopped"), 4);
}

#[cfg(target_os = "linux")]
fn checkpoints(sweep: &Path) -> usize {
    let Ok(trials) = fs::read_dir(sweep.join("trials")) else { return 0 };
    let of = |trial: fs::DirEntry| fs::read_dir(trial.path().join("checkpoints")).map_or(0, Iterator::count);
    trials.map(|trial| of(trial.unwrap())).sum()
}

#[cfg(target_os = "linux")]
fn wait(until: impl Fn() -> bool) {
    let start = Instant::now();
    while !until() {
        assert!(start.elapsed() < Duration::from_secs(120), "it did not come");
        sleep(Duration::from_millis(10));
    }
}

#[cfg(target_os = "linux")]
#[test]
fn twenty_kills_of_workers_and_of_the_parent_change_nothing() {
    let here = folder();
    let path = here.path();
    fs::write(path.join("space.toml"), SPACE.replace("steps = 400", "steps = 1500")).unwrap();
    succeed(path, "sweep run space.toml --out whole --jobs 2 --threads 1");
    let (mut numbers, mut kills, mut parents) = (Numbers(7), 0, 0);
    let mut process = start(path, "killed");
    let mut saved = Vec::new();
    let steps = || last_checkpoints(&path.join("killed")).iter().map(|(_, step)| step).sum::<u64>();
    while kills < 20 {
        sleep(Duration::from_millis(10 + numbers.below(60)));
        // Every fifth time, waits for a checkpoint to resume from on slow machines.
        let (before, since) = (steps(), Instant::now());
        while kills % 5 == 4 && steps() <= before && process.try_wait().unwrap().is_none() {
            let messages = fs::read_to_string(path.join("messages")).unwrap();
            assert!(since.elapsed() < Duration::from_secs(120), "no step in two minutes: {messages}");
            sleep(Duration::from_millis(10));
        }
        if process.try_wait().unwrap().is_some() {
            break;
        }
        let seen = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64();
        saved.extend(last_checkpoints(&path.join("killed")).into_iter().map(|(trial, step)| (trial, step, seen)));
        if numbers.below(3) == 0 {
            process.kill().unwrap();
            process.wait().unwrap();
            parents += 1;
            kills += 1;
            process = start(path, "killed");
        } else if let Some(&worker) = children(process.id()).first() {
            signal(worker, "-KILL");
            kills += 1;
        }
    }
    process.wait().unwrap();
    assert!(
        kills == 20 && parents >= 2,
        "the sweep was over after {kills} kills, {parents} of the parent: {}",
        fs::read_to_string(path.join("messages")).unwrap()
    );
    let left = headtail(path, "sweep retry space.toml --out killed");
    assert!(left.status.success(), "{}", text(&left.stderr));
    succeed(path, "sweep run space.toml --out killed --jobs 2 --threads 1");
    assert_eq!(rows(path, "whole"), rows(path, "killed"));
    // Resumed trials continue from their last checkpoint or a later one.
    let lines = journals(&path.join("killed"));
    let starts = lines.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
    let starts: Vec<_> = starts.filter(|line| line["event"] == "started").collect();
    assert!(starts.len() > 8);
    let mut resumed = 0;
    for (trial, step, seen) in &saved {
        for start in starts.iter().filter(|start| start["trial"] == **trial && start["time"].as_f64().unwrap() > *seen)
        {
            assert!(start["step"].as_u64().unwrap() >= *step, "{start} after a checkpoint at {step}");
            resumed += 1;
        }
    }
    assert!(resumed > 0, "no trial was taken up again");
}

/// Returns the step of the last checkpoint of each trial that has one.
#[cfg(target_os = "linux")]
fn last_checkpoints(sweep: &Path) -> Vec<(String, u64)> {
    let step = |entry: &fs::DirEntry| entry.file_name().to_str()?.strip_prefix("step-")?.parse::<u64>().ok();
    let last = |trial: &fs::DirEntry| {
        let entries = fs::read_dir(trial.path().join("checkpoints")).ok()?;
        // Old ones are removed concurrently.
        entries.filter_map(|entry| step(&entry.ok()?)).max()
    };
    let trials = fs::read_dir(sweep.join("trials")).into_iter().flatten().map(Result::unwrap);
    trials.filter_map(|trial| Some((trial.file_name().into_string().unwrap(), last(&trial)?))).collect()
}
