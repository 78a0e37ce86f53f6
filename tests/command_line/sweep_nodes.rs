//! Sweeps on several nodes: clocks that differ, and the programs of Slurm.

use std::{fs, path::Path, process::Command};

use super::{
    fail, folder, radiance_file, succeed,
    sweep::{SPACE, events, rows},
    text,
};

/// Journals of nodes whose clocks are ten minutes ahead or behind: the times in them are changed, nothing else.
#[test]
fn wrong_clocks_lose_no_retry_and_repeat_no_trial() {
    for offset in [-600.0, 600.0] {
        let here = folder();
        let path = here.path();
        let sweep = path.join("space.sweep");
        let move_clock = || {
            for entry in fs::read_dir(sweep.join("journal")).unwrap() {
                let file = entry.unwrap().path();
                let moved = |line: &str| {
                    let mut line: serde_json::Value = serde_json::from_str(line).unwrap();
                    line["time"] = (line["time"].as_f64().unwrap() + offset).into();
                    line.to_string() + "\n"
                };
                let lines: String = fs::read_to_string(&file).unwrap().lines().map(moved).collect();
                fs::write(file, lines).unwrap();
            }
        };
        let space = SPACE.replace("head.bins = [4, 8]", "env = ['none.hdr']").replace("steps = 400", "steps = 4");
        fs::write(path.join("space.toml"), space).unwrap();
        let trials = rows(path, "space.sweep").len();
        fail(path, "sweep run space.toml --quiet");
        move_clock();
        assert!(succeed(path, "sweep retry space.toml").starts_with(&format!("{trials} trials")));
        // Each trial fails once more, and only once.
        fail(path, "sweep run space.toml --quiet");
        assert_eq!(events(&sweep, "failed"), 2 * trials, "{offset}");
        move_clock();
        fail(path, "sweep run space.toml --quiet");
        assert_eq!(events(&sweep, "started"), 2 * trials, "{offset}");
        assert!(succeed(path, "sweep retry space.toml").starts_with(&format!("{trials} trials")));
        move_clock();
        fs::write(path.join("none.hdr"), radiance_file(8, 4, 128, 128)).unwrap();
        succeed(path, "sweep run space.toml");
        let done = rows(path, "space.sweep").values().all(|row| row.contains(&"state=done".to_owned()));
        assert!(done && events(&sweep, "started") == 3 * trials, "{offset}");
    }
}

#[cfg(unix)]
#[test]
fn job_numbers_are_found_in_what_sbatch_prints() {
    let here = folder();
    let path = here.path();
    fs::write(path.join("space.toml"), format!("#SBATCH\t--partition=long\n#SBATCH --mem=1G\n#SBATCHX\n{SPACE}"))
        .unwrap();
    let programs = folder();
    let submit = |prints: &str| {
        program(programs.path(), "sbatch", prints);
        let mut command = Command::new(env!("CARGO_BIN_EXE_headtail"));
        let known = std::env::var("PATH").unwrap_or_default();
        command.env("PATH", format!("{}:{known}", programs.path().display())).current_dir(path);
        command.args(["sweep", "submit", "space.toml"]).output().unwrap()
    };
    let said = submit("Sun Jul  7 03:08:22 2030 [INFO4] auks_krb5_cred: 3 tickets\n519605;north\n12 jobs wait");
    assert_eq!(text(&said.stdout), "519605\n", "{}", text(&said.stderr));
    let said = submit("Welcome to node 7, 2030");
    assert_eq!(said.status.code(), Some(1));
    assert!(text(&said.stderr).contains("Welcome to node 7, 2030"), "{}", text(&said.stderr));
    let list = fs::read_to_string(path.join("space.sweep/slurm.jsonl")).unwrap();
    assert!(list.lines().count() == 1 && list.contains("\"519605\""), "{list}");
    let script = fs::read_to_string(path.join("space.sweep/slurm.sh")).unwrap();
    assert!(script.contains("#SBATCH --partition=long\n#SBATCH --mem=1G\n") && !script.contains("SBATCHX"), "{script}");
}

/// A program that prints a text.
#[cfg(unix)]
fn program(folder: &Path, name: &str, prints: &str) {
    use std::os::unix::fs::PermissionsExt;
    let file = folder.join(name);
    fs::write(&file, format!("#!/bin/sh\ncat <<'TEXT'\n{prints}\nTEXT\n")).unwrap();
    fs::set_permissions(&file, fs::Permissions::from_mode(0o755)).unwrap();
}

#[cfg(unix)]
#[test]
fn status_of_submitted_sweeps_reports_slurm_states() {
    let here = folder();
    let path = here.path();
    fs::write(path.join("space.toml"), SPACE).unwrap();
    fs::create_dir_all(path.join("space.sweep")).unwrap();
    fs::write(path.join("space.sweep/slurm.jsonl"), "{\"job\":\"31\",\"tasks\":4}\n").unwrap();
    let programs = folder();
    program(programs.path(), "squeue", "31_2|RUNNING\n31_3|PENDING");
    // In the format of `sacct`: pending tasks are one line.
    program(programs.path(), "sacct", "31_0|COMPLETED|0:0\n31_1|TIMEOUT|0:1\n31_[2-3%2]|PENDING|0:0");
    let status = |options: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_headtail"));
        let known = std::env::var("PATH").unwrap_or_default();
        command.env("PATH", format!("{}:{known}", programs.path().display()));
        let output = command.args(["sweep", "status", "space.toml"]).args(options).current_dir(path).output().unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let said = status(&[]);
    let expected = "Slurm: jobs 31: 1 COMPLETED, 1 PENDING, 1 RUNNING, 1 TIMEOUT (sacct, squeue)\n\
                    Slurm: task 31_1: TIMEOUT, exit 0:1\n";
    assert!(said.starts_with("8 trials: 8 waiting") && said.ends_with(expected), "{said}");
    let json: serde_json::Value = serde_json::from_str(&status(&["--json"])).unwrap();
    assert_eq!(json["states"]["waiting"], 8);
    assert_eq!(json["slurm"]["tasks"]["31_1"]["exit"], "0:1");
}
