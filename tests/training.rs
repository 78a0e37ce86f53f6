//! `headtail fit`: settings, metrics, checkpoints after kills, event files.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use headtail_render::random::{Purpose, Stream};
use tempfile::TempDir;

fn command(folder: &Path, arguments: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_headtail"));
    command.current_dir(folder).args(arguments.split_whitespace());
    command
}

fn run(folder: &Path, arguments: &str) -> Output {
    command(folder, arguments).output().expect("the program starts")
}

/// Runs a command that must succeed; returns standard output and standard error.
fn succeed(folder: &Path, arguments: &str) -> (String, String) {
    let output = run(folder, arguments);
    let [said, warned] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8(bytes.clone()).unwrap());
    assert!(output.status.success(), "{arguments}: {}\n{warned}", output.status);
    (said, warned)
}

/// Runs a command that must fail with one line; returns the line.
fn fail(folder: &Path, arguments: &str) -> String {
    let output = run(folder, arguments);
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{arguments}: {message}");
    assert_eq!(message.trim_end().lines().count(), 1, "{arguments}: {message}");
    message.strip_prefix("error: ").unwrap_or_else(|| panic!("{arguments}: {message}")).trim_end().to_owned()
}

fn folder() -> TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// Returns the lines of a run's metrics.
fn metrics(folder: &Path) -> Vec<serde_json::Value> {
    let text = fs::read_to_string(folder.join("metrics.jsonl")).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn steps(rows: &[serde_json::Value]) -> Vec<u64> {
    rows.iter().map(|row| row["step"].as_u64().unwrap()).collect()
}

#[test]
fn settings_are_printed_and_read_back() {
    let here = folder();
    let path = here.path();
    for preset in ["paper-cosine", "paper-ggx", "fast-cosine", "fast-ggx", "over-patches"] {
        let (printed, _) = succeed(path, &format!("fit --preset {preset} --print-config"));
        fs::write(path.join("run.toml"), &printed).unwrap();
        let (again, _) = succeed(path, "fit --config run.toml --print-config");
        assert_eq!(printed, again);
    }
    // The file overrides the preset, --set the file, and flags override all.
    fs::write(path.join("run.toml"), "steps = 7\nseed = 3\nconditions = 9\n[head]\nbins = 6\n").unwrap();
    let (printed, _) =
        succeed(path, "fit --preset paper-ggx --config run.toml --set seed=4 --set strata=5 --seed 5 --print-config");
    for line in ["steps = 7", "seed = 5", "conditions = 9", "strata = 5", "bins = 6", "learning_rate = 0.001"] {
        assert!(printed.lines().any(|printed| printed == line), "{line}: {printed}");
    }
    let (printed, _) = succeed(path, "fit --material ggx:alpha=0.2..0.8 --print-config");
    assert!(printed.contains("ggx-roughness") && printed.contains("share = true"), "{printed}");
}

#[test]
fn wrong_settings_name_file_and_key() {
    let here = folder();
    let path = here.path();
    fs::write(path.join("run.toml"), "stepz = 7\n").unwrap();
    let sentence = fail(path, "fit --preset fast-cosine --config run.toml --print-config");
    assert!(sentence.starts_with("run.toml: ") && sentence.contains("`stepz`"), "{sentence}");
    for (arguments, named) in [
        ("--set head.binz=3", "`head.binz`"),
        ("--set steps=0", "steps = 0"),
        ("--set steps", "KEY=VALUE"),
        ("--set head.bins=1", "bins = 1"),
        ("--config nowhere.toml", "nowhere.toml"),
        ("--learning-rate -1", "learning_rate"),
        ("--over patches --tail row-column", "hierarchical"),
        ("--set over=leaves", "over"),
    ] {
        let arguments = arguments.replace("--learning-rate ", "--learning-rate=");
        let sentence = fail(path, &format!("fit --preset fast-cosine {arguments} --print-config"));
        assert!(sentence.contains(named), "{arguments}: {sentence}");
    }
    let camera = "fit --env overcast --material lambert --look-from 0,1,2 --look-at 0,0,0 --out a";
    assert!(fail(path, camera).contains("--conditions-from"));
}

#[test]
fn every_kind_of_target_is_trained() {
    let here = folder();
    let path = here.path();
    let small =
        "--steps 25 --set conditions=6 --set validation_conditions=6 --set validate_every=10 --env studio --out out";
    for (kind, improves) in [
        ("--material lambert", true),
        ("--material lambert --conditions-from sphere", true),
        ("--material lambert --target tabulated --set strata=16 --steps 4", false),
        ("--material lambert --naive", true),
        ("--material ggx:alpha=0.4 --no-export", true),
        ("--material ggx:alpha=0.2..0.8 --no-export --loss forward-kl --set ema_decay=0.5", true),
        ("--material ggx:alpha=0.3 --no-export --naive --loss reverse-kl", false),
        ("--preset paper-ggx --no-export --set strata=6 --set brdf_samples=9", true),
        ("--material lambert --over patches", false),
        ("--material ggx:alpha=0.1 --over fine-patches", false),
    ] {
        let small = if kind.contains("--steps") { small.replace("--steps 25", "") } else { small.into() };
        let (said, _) = succeed(path, &format!("fit {small} {kind} --force --pictures pictures"));
        for picture in 0..4 {
            let picture = path.join(format!("pictures/condition-{picture}.svg"));
            assert!(fs::read(&picture).unwrap().starts_with(b"<"), "{kind}");
            fs::remove_file(picture).unwrap();
        }
        let rows = metrics(&path.join("out"));
        let kl = |row: &serde_json::Value| row["kl"].as_f64().unwrap();
        let (first, last) = (kl(&rows[0]), kl(&rows[rows.len() - 1]));
        assert!(!improves || last < first, "{kind}: {first} {last}");
        assert!(said.contains("KL "), "{said}");
    }
    let rows = metrics(&path.join("out"));
    assert_eq!(steps(&rows), [0, 10, 20, 25]);
    for key in ["loss", "log_chi_square", "relative_variance", "learning_rate", "samples_per_second", "seconds"] {
        assert!(rows[3][key].as_f64().unwrap() > 0.0, "{key}: {}", rows[3]);
    }
    assert_eq!(rows[3]["version"], env!("CARGO_PKG_VERSION"));
}

const RUN: &str = "fit --env overcast --material lambert --steps 60 --seed 9 --reproducible --set validate_every=20 \
                   --set conditions=16 --checkpoint-dir kept --checkpoint-every 5 --resume --out out";

fn checkpoints(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(folder.join("kept")) else { return Vec::new() };
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.file_name().unwrap().to_string_lossy().starts_with("step-"));
    paths.sort();
    paths
}

/// Returns the sampler of an uninterrupted run and the duration.
fn whole_run() -> (Vec<u8>, Duration) {
    let here = folder();
    let start = Instant::now();
    succeed(here.path(), RUN);
    (fs::read(here.path().join("out/sampler.safetensors")).unwrap(), start.elapsed())
}

/// Kills up to `kills` runs at random moments, then completes one. Returns the number of killed runs.
fn kill_and_resume(path: &Path, kills: usize, typical: Duration, seed: u64) -> usize {
    let mut stream = Stream::new(seed, Purpose::Test, 0);
    let mut killed = 0;
    for _ in 0..kills {
        let mut process = command(path, RUN).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        sleep(typical.mul_f32(0.05 + 0.5 * stream.uniform()));
        // SIGKILL on Unix, unless the process has ended.
        if process.try_wait().unwrap().is_none() {
            process.kill().unwrap();
            killed += 1;
        }
        process.wait().unwrap();
    }
    let (_, warned) = succeed(path, RUN);
    assert!(warned.is_empty(), "a kill damages no checkpoint: {warned}");
    killed
}

#[test]
fn killed_runs_resume_to_identical_bytes() {
    let (expected, typical) = whole_run();
    let here = folder();
    let killed = kill_and_resume(here.path(), 5, typical, 1);
    assert!(killed >= 2, "{killed} kills test little");
    assert!(fs::read(here.path().join("out/sampler.safetensors")).unwrap() == expected);
    assert_eq!(steps(&metrics(&here.path().join("out"))), [0, 20, 40, 60]);
    assert!(checkpoints(here.path()).len() <= 3);
    let entries = fs::read_dir(here.path().join("kept")).unwrap();
    // The record of the output folder stays.
    let left = entries.filter(|entry| entry.as_ref().unwrap().file_name() != ".headtail").count();
    assert_eq!(left, checkpoints(here.path()).len(), "nothing half done is left");
}

/// Run manually: `cargo test --release --test training -- --ignored --nocapture twenty`.
#[test]
#[ignore = "takes minutes"]
fn twenty_kills_leave_the_result_unchanged() {
    let (expected, typical) = whole_run();
    let (mut killed, mut runs) = (0, 0);
    while killed < 20 {
        let here = folder();
        killed += kill_and_resume(here.path(), 5, typical, 100 + runs);
        runs += 1;
        assert!(fs::read(here.path().join("out/sampler.safetensors")).unwrap() == expected);
    }
    println!("{killed} kills in {runs} runs; every run ended with the same bytes");
}

#[test]
fn damaged_checkpoints_are_named_and_the_previous_one_used() {
    let (expected, _) = whole_run();
    let here = folder();
    let path = here.path();
    succeed(path, RUN);
    let kept = checkpoints(path);
    assert_eq!(kept.len(), 3);
    fs::write(&kept[2], &fs::read(&kept[2]).unwrap()[..1000]).unwrap();
    fs::write(&kept[1], "{}").unwrap();
    let (_, warned) = succeed(path, RUN);
    for (line, name) in warned.lines().zip(["step-000000060", "step-000000055"]) {
        assert!(line.starts_with("warning: ") && line.contains(name) && line.contains("checksum"), "{warned}");
    }
    assert_eq!(warned.lines().count(), 2, "{warned}");
    assert!(fs::read(path.join("out/sampler.safetensors")).unwrap() == expected);

    let sentence = fail(path, &RUN.replace("--seed 9", "--seed 8"));
    assert!(sentence.contains("`seed`") && sentence.contains("step-"), "{sentence}");
    assert!(fail(path, &RUN.replace("overcast", "studio")).contains("another target"));
    assert!(fail(path, &RUN.replace("--resume", "")).contains("earlier run"));
}

/// A finished run is extended to more steps; fewer steps are rejected.
#[test]
fn finished_runs_can_be_extended() {
    let here = folder();
    let path = here.path();
    succeed(path, RUN);
    let before = fs::read(path.join("out/sampler.safetensors")).unwrap();
    let (said, warned) = succeed(path, &RUN.replace("--steps 60", "--steps 80"));
    assert!(said.contains("80 steps") && warned.is_empty(), "{said}{warned}");
    assert_eq!(steps(&metrics(&path.join("out"))), [0, 20, 40, 60, 80]);
    assert_eq!(checkpoints(path).last().unwrap().file_name().unwrap(), "step-000000080");
    assert_ne!(fs::read(path.join("out/sampler.safetensors")).unwrap(), before);
    assert!(fail(path, &RUN.replace("--steps 60", "--steps 40")).contains("steps"));
}

/// SIGTERM and SIGINT write a checkpoint and the current sampler and exit with 0.
#[cfg(unix)]
#[test]
fn signals_save_a_checkpoint() {
    let long =
        RUN.replace("--steps 60", "--steps 1000000").replace("--checkpoint-every 5", "--checkpoint-every 1000000");
    for signal in ["-TERM", "-INT"] {
        let here = folder();
        let path = here.path();
        let process = command(path, &long).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        // The first line of the metrics is written when training begins.
        let start = Instant::now();
        while !path.join("out/metrics.jsonl").exists() && start.elapsed() < Duration::from_secs(30) {
            sleep(Duration::from_millis(20));
        }
        sleep(Duration::from_millis(300));
        assert!(Command::new("kill").args([signal, &process.id().to_string()]).status().unwrap().success());
        let output = process.wait_with_output().unwrap();
        let said = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success() && said.contains("interrupted"), "{said}");
        assert_eq!(checkpoints(path).len(), 1, "{signal}");
        assert!(path.join("out/sampler.safetensors").exists());
    }
}

/// Uses TensorBoard's own reader, which must exist if `HEADTAIL_PYTHON` names an interpreter.
#[test]
fn tensorboard_reads_the_event_files() {
    let named = std::env::var("HEADTAIL_PYTHON").ok();
    let python = named.clone().unwrap_or_else(|| "python3".into());
    let has = Command::new(&python).args(["-c", "import tensorboard"]).output().is_ok_and(|o| o.status.success());
    if !has {
        assert!(named.is_none(), "{python} has no package tensorboard");
        eprintln!("skipped: python3 has no package tensorboard (name an interpreter by HEADTAIL_PYTHON)");
        return;
    }
    let here = folder();
    let path = here.path();
    succeed(
        path,
        "fit --env overcast --material lambert --steps 12 --set validate_every=5 --tensorboard board --out out",
    );
    let script = "
import json, sys
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
board = EventAccumulator(sys.argv[1], size_guidance={'scalars': 0}).Reload()
print(json.dumps({tag: [[e.step, e.value] for e in board.Scalars(tag)] for tag in board.Tags()['scalars']}))";
    let output = Command::new(&python).current_dir(path).args(["-c", script, "board"]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let read: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let scalars = |tag: &str| -> Vec<(u64, f64)> {
        let list = read[tag].as_array().unwrap_or_else(|| panic!("{tag}: {read}"));
        list.iter().map(|pair| (pair[0].as_u64().unwrap(), pair[1].as_f64().unwrap())).collect()
    };
    assert_eq!(scalars("train/loss").iter().map(|pair| pair.0).collect::<Vec<_>>(), (1..=12).collect::<Vec<_>>());
    let rows = metrics(&path.join("out"));
    for (tag, key) in [
        ("validation/kl", "kl"),
        ("validation/log_chi_square", "log_chi_square"),
        ("validation/relative_variance", "relative_variance"),
    ] {
        let read = scalars(tag);
        assert_eq!(read.len(), rows.len(), "{tag}");
        for ((step, value), row) in read.into_iter().zip(&rows) {
            let expected = row[key].as_f64().unwrap();
            assert!(Some(step) == row["step"].as_u64() && (value - expected).abs() <= 1e-6 * expected.abs(), "{tag}");
        }
    }
}
