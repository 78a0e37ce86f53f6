//! Results of commands that are interrupted, killed, or cannot write.

use std::{
    fs,
    path::Path,
    process::{Child, Command, Output, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use headtail_render::statistics::ErrorMetrics;

use super::{SMALL, after_header, command, fail, folder, mean, names, picture, succeed, text};

/// Starts the program with default signal handlers: shells can ignore some.
fn start(folder: &Path, arguments: &str) -> Child {
    let mut command = Command::new("env");
    command.args(["--default-signal", env!("CARGO_BIN_EXE_headtail")]).args(arguments.split_whitespace());
    command.current_dir(folder).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

fn signal(process: &Child, name: &str) {
    assert!(Command::new("kill").args([name, &process.id().to_string()]).status().unwrap().success());
}

/// Returns the output of a process that must end within a time.
fn end(process: Child, within: Duration) -> Output {
    let start = Instant::now();
    let output = process.wait_with_output().unwrap();
    assert!(start.elapsed() < within, "it ended only after {:?}", start.elapsed());
    output
}

/// Returns (sampler, budget) of the runs in a table of results; empty without a table. Panics if it is
/// damaged.
fn runs(results: &Path) -> Vec<(String, String)> {
    let Ok(bytes) = fs::read(results.join("results.csv")) else { return Vec::new() };
    let mut reader = csv::Reader::from_reader(bytes.as_slice());
    let records: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    let runs = records.iter().filter(|record| &record[4] != "mean");
    runs.map(|record| (record[2].to_owned(), record[3].to_owned())).collect()
}

fn wait_for_runs(results: &Path, count: usize) {
    let start = Instant::now();
    while runs(results).len() < count {
        assert!(start.elapsed() < Duration::from_secs(60), "{count} runs did not come");
        sleep(Duration::from_millis(5));
    }
}

/// Waits until the page of a comparison contains a text.
fn wait_for_page(results: &Path, text: &str) {
    let start = Instant::now();
    while !fs::read_to_string(results.join("report.html")).is_ok_and(|page| page.contains(text)) {
        assert!(start.elapsed() < Duration::from_secs(60), "no page says '{text}'");
        sleep(Duration::from_millis(5));
    }
}

const COMPARE: &str = "compare --scene sphere --env overcast --reference-spp 4 --samplers mis,ris:2";

/// Asserts that numbers of runs differ by at most one between samplers.
fn assert_fair(runs: &[(String, String)]) {
    let count = |sampler: &str| runs.iter().filter(|run| run.0 == sampler).count();
    assert!(count("mis") - count("ris:2") <= 1, "{runs:?}");
}

#[test]
fn killed_comparisons_keep_finished_runs() {
    let here = folder();
    let results = here.path().join("results");
    let mut process = start(here.path(), &format!("{COMPARE} {SMALL} --spp 1,2 --runs 10000 --out results"));
    wait_for_runs(&results, 9);
    process.kill().unwrap();
    process.wait().unwrap();
    assert!(runs(&results).len() >= 9);
    let page = fs::read_to_string(results.join("report.html")).unwrap();
    assert!(page.contains("was running when the page was written") && page.ends_with("</html>\n"));
    for sampler in ["mis", "ris-2"] {
        for budget in ["1spp", "2spp"] {
            assert!(mean(&picture(&results.join(format!("{sampler}_{budget}.exr")))) > 0.0);
        }
    }
}

#[test]
fn interrupted_comparisons_are_marked_and_balanced() {
    for (name, status) in [("-INT", 130), ("-TERM", 143), ("-HUP", 143)] {
        let here = folder();
        let results = here.path().join("results");
        let process = start(here.path(), &format!("{COMPARE} {SMALL} --spp 1 --runs 10000 --out results"));
        wait_for_runs(&results, 5);
        signal(&process, name);
        // Time for the current run (samples of two pixels) and the files.
        let output = end(process, Duration::from_secs(20));
        let (said, warned) = (text(&output.stdout), text(&output.stderr));
        assert_eq!(output.status.code(), Some(status), "{name}: {warned}");
        let runs = runs(&results);
        assert!((5..20_000).contains(&runs.len()));
        assert_fair(&runs);
        assert!(warned.starts_with(&format!("interrupted: {} of 20000 runs are done", runs.len())), "{warned}");
        let of_mis = runs.iter().filter(|run| run.0 == "mis").count();
        let line = said.lines().find(|line| line.starts_with("1spp       mis ")).unwrap_or_else(|| panic!("{said}"));
        assert_eq!(line.split_whitespace().nth(2), Some(of_mis.to_string().as_str()));
        let page = fs::read_to_string(results.join("report.html")).unwrap();
        assert!(page.contains(&format!("This comparison was interrupted: {} of 20000 runs are done", runs.len())));
    }
}

#[test]
fn signals_skip_calibration() {
    let here = folder();
    let results = here.path().join("results");
    let process = start(here.path(), &format!("{COMPARE} {SMALL} --spp 1 --seconds 20,21 --runs 1 --out results"));
    wait_for_runs(&results, 2);
    signal(&process, "-INT");
    // All calibrations would take 2 x 1.25 x (20 + 21) s = 102 s, the first trial 5 s.
    let output = end(process, Duration::from_secs(4));
    assert_eq!(output.status.code(), Some(130), "{}", text(&output.stderr));
    assert_eq!(runs(&results).len(), 2);
    assert!(fs::read_to_string(results.join("report.html")).unwrap().contains("interrupted: 2 of 6 runs are done"));
}

#[test]
fn second_signals_end_at_once_and_keep_runs() {
    let here = folder();
    let results = here.path().join("results");
    let process = start(here.path(), &format!("{COMPARE} {SMALL} --spp 1,400000000 --runs 1 --out results"));
    wait_for_runs(&results, 2);
    // Pages are written less often than they take: on a busy machine, that of the second run is left out.
    wait_for_page(&results, " of 4 runs are done");
    // Until the third run, which takes hours, has begun.
    sleep(Duration::from_secs(2));
    signal(&process, "-INT");
    sleep(Duration::from_millis(500));
    signal(&process, "-TERM");
    let output = end(process, Duration::from_secs(4));
    assert_eq!(output.status.code(), Some(143), "{}", text(&output.stderr));
    assert_eq!(runs(&results).len(), 2);
    assert!(fs::read_to_string(results.join("report.html")).unwrap().contains(" of 4 runs are done"));
}

#[test]
fn interrupted_references_leave_no_files() {
    let here = folder();
    let process = start(
        here.path(),
        &format!("{COMPARE} {SMALL} --reference-spp 400000000 --spp 1 --out results").replace("--reference-spp 4 ", ""),
    );
    let start = Instant::now();
    while !here.path().join("results").exists() && start.elapsed() < Duration::from_secs(20) {
        sleep(Duration::from_millis(20));
    }
    sleep(Duration::from_millis(500));
    signal(&process, "-INT");
    let output = end(process, Duration::from_secs(10));
    assert_eq!(output.status.code(), Some(130), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("no run is done") && !here.path().join("results/results.csv").exists());
}

#[test]
fn unwritable_pictures_keep_earlier_runs() {
    let here = folder();
    let results = here.path().join("results");
    fs::create_dir_all(results.join("ris-2_2spp.exr")).unwrap();
    let sentence = fail(here.path(), &format!("{COMPARE} {SMALL} --spp 1,2 --runs 2 --out results"));
    assert!(sentence.contains("ris-2_2spp.exr"), "{sentence}");
    assert_eq!(runs(&results).len(), 4);
    assert!(results.join("report.html").exists() && results.join("mis_2spp.exr").exists());
}

/// An interrupted rendering yields a picture with fewer samples.
#[test]
fn interruption_writes_the_picture_so_far() {
    let here = folder();
    let path = here.path();
    let view = "--scene sphere --env overcast --sampler mis --width 64 --height 48";
    let mut process = command(path, &format!("render {view} --spp 400000000 --out out/a.exr"));
    let process = process.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    // The folder is created before rendering begins.
    let start = Instant::now();
    while !path.join("out").exists() && start.elapsed() < Duration::from_secs(20) {
        sleep(Duration::from_millis(20));
    }
    sleep(Duration::from_millis(500));
    assert_eq!(names(&path.join("out")), [".a.exr.lock", ".a.png.lock"], "a result appears when it is complete");
    assert!(Command::new("kill").args(["-INT", &process.id().to_string()]).status().unwrap().success());
    let output = process.wait_with_output().unwrap();
    assert!(output.status.success(), "{}: {}", output.status, text(&output.stderr));
    assert_eq!(names(&path.join("out")), ["a.exr", "a.png"]);

    let said = text(&output.stdout);
    let spp: u32 =
        said.split_whitespace().nth(1).and_then(|word| word.parse().ok()).unwrap_or_else(|| panic!("{said}"));
    assert!((1..400_000_000).contains(&spp), "{said}");
    succeed(path, &format!("render {view} --spp 4 --out short.exr"));
    let (long, short) = (picture(&path.join("out/a.exr")), picture(&path.join("short.exr")));
    // The long rendering has more samples of the same picture.
    let errors = ErrorMetrics::of(&short, &long).unwrap();
    assert!(mean(&long) > 0.1 && errors.relmse < 0.5, "{} {errors:?}", mean(&long));
}

/// Waits until a file exists.
fn wait_for(path: &Path) {
    let start = Instant::now();
    while !path.exists() {
        assert!(start.elapsed() < Duration::from_secs(60), "{} did not come", path.display());
        sleep(Duration::from_millis(2));
    }
}

#[test]
fn rival_training_resumes_after_signals_and_kills() {
    let here = folder();
    let cloth = concat!(env!("CARGO_MANIFEST_DIR"), "/checkpoints/welt.safetensors");
    let fit = |name: &str| {
        format!(
            "fit-rival --kind lobes --material neural:{cloth} --steps 1000 --views 8 --directions 8 --threads 1 --out {name}"
        )
    };
    let (kept, arguments) = (here.path().join("again.state"), fit("again"));
    let process = start(here.path(), &arguments);
    wait_for(&kept);
    signal(&process, "-INT");
    let output = end(process, Duration::from_secs(10));
    let warned = text(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{warned}");
    assert!(warned.contains("of 1000 steps are done; the same command goes on from there"), "{warned}");
    let written = fs::metadata(&kept).unwrap().modified().unwrap();
    let mut process = start(here.path(), &arguments);
    // Waits until the state is written again.
    let begin = Instant::now();
    while fs::metadata(&kept).is_ok_and(|now| now.modified().unwrap() == written) {
        assert!(begin.elapsed() < Duration::from_secs(60), "no state was written");
        sleep(Duration::from_millis(2));
    }
    process.kill().unwrap();
    process.wait().unwrap();
    assert!(!here.path().join("again").exists());

    succeed(here.path(), &arguments);
    succeed(here.path(), &fit("whole"));
    assert!(!kept.exists());
    // The header contains the training time, which differs.
    let weights = |name: &str| after_header(&fs::read(here.path().join(name)).unwrap());
    assert!(weights("again") == weights("whole"), "the same sampler comes out");
}
