//! Nothing that was computed is lost: not by closed or full outputs, not by another comparison, not by an output that cannot be written.

use std::{
    fs::{self, OpenOptions},
    path::Path,
    process::{Output, Stdio},
};

use super::{SMALL, command, folder, names, succeed, text};

/// Runs a command whose standard output nobody reads: the reading end is closed before the program starts.
fn unread(folder: &Path, arguments: &str) -> Output {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let child = command(folder, arguments).stdout(writer).stderr(Stdio::piped()).spawn().unwrap();
    child.wait_with_output().unwrap()
}

#[test]
fn closed_outputs_lose_nothing() {
    let here = folder();
    let path = here.path();
    succeed(path, "bake --direct --env overcast --normals 4x6 --cells 4x4 --out table");
    let view = format!("--scene sphere --env overcast {SMALL}");
    for (arguments, results) in [
        ("fit --env overcast --material lambert --steps 2 --set conditions=4 --out fit".to_owned(), "fit/sampler.safetensors"),
        ("fit --env overcast --material lambert --steps 2 --tail flow --set flow.steps=4 --set flow.cells=16 --out flow".into(), "flow/sampler.safetensors"),
        ("bake --direct --env overcast --normals 4x6 --cells 4x4 --out bake/table".into(), "bake/table"),
        (format!("render {view} --sampler mis --spp 1 --timings --out render.exr"), "render.png"),
        (format!("compare {view} --samplers mis --runs 1 --spp 1 --reference-spp 1 --out compare"), "compare/report.html"),
        ("chart compare --out chart.html".into(), "chart.html"),
        ("inspect table --out inspect.png".into(), "inspect.png"),
        ("export table --target wgsl --out shader".into(), "shader/layout.json"),
        ("view --env overcast --width 16 --height 16 --out view.exr".into(), "view.fspy"),
        ("scenes --out scenes --spp 1 --width 16".into(), "scenes/temple.png"),
        ("stability --quick --only constant --out suite".into(), "suite/stability.html"),
        ("backends --steps 1 --conditions 4 --samples 16 --backend flex".into(), "."),
        ("composite --photo view.exr --camera view.fspy --env overcast --scene sphere --spp 1 --out both".into(), "both/composite.html"),
    ] {
        let output = unread(path, &arguments);
        let said = text(&output.stderr);
        assert!(output.status.success() && !said.contains("panicked"), "{arguments}: {}: {said}", output.status);
        assert!(path.join(results).exists(), "{arguments}");
    }
    // A reader that takes one line and goes.
    let script = format!("{} scenes | head -n 1", env!("CARGO_BIN_EXE_headtail"));
    let output = std::process::Command::new("bash").args(["-o", "pipefail", "-c", &script]).output().unwrap();
    assert!(output.status.success() && text(&output.stderr).is_empty(), "{}", text(&output.stderr));
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_output_is_said_when_all_is_written() {
    let here = folder();
    let path = here.path();
    let arguments = "fit --env overcast --material lambert --steps 2 --set conditions=4 --out fit";
    let full = OpenOptions::new().write(true).open("/dev/full").unwrap();
    let child = command(path, arguments).stdout(full).stderr(Stdio::piped()).spawn().unwrap();
    let output = child.wait_with_output().unwrap();
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("standard output is incomplete") && said.contains("No space left"), "{said}");
    assert_eq!(names(&path.join("fit")), ["measures.json", "metrics.jsonl", "resolved.toml", "sampler.safetensors"]);
    // Nobody can be told, and nothing is lost.
    let full = || OpenOptions::new().write(true).open("/dev/full").unwrap();
    let mut process = command(path, &arguments.replace("--out fit", "--out again"));
    assert!(process.stdout(full()).stderr(full()).status().unwrap().code() == Some(1));
    assert!(path.join("again/sampler.safetensors").exists());
}

#[test]
fn quiet_verbose_and_log() {
    let here = folder();
    let path = here.path();
    let render = format!("render --scene sphere --env overcast --sampler mis --spp 1 {SMALL} --out a.exr");
    assert_eq!(succeed(path, &format!("{render} --quiet --log log")), "");
    let log = fs::read_to_string(path.join("log")).unwrap();
    assert!(
        log.contains("headtail render --scene sphere")
            && log.contains("1 spp of sobol")
            && log.contains(" pixels, hash "),
        "{log}"
    );
    let output = command(path, &format!("-v {render}")).output().unwrap();
    assert!(text(&output.stderr).starts_with("detail: overcast: "), "{}", text(&output.stderr));
    // Data is not silenced.
    assert!(succeed(path, "scenes -q").contains("temple"));
}
