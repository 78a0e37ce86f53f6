//! Properties of every command: closed readers, unwritable outputs, endless inputs, second writers, announced
//! long work. A new command that is in none of the lists fails these tests.

use std::{
    collections::BTreeSet,
    fs,
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Output, Stdio},
    time::{Duration, Instant},
};

use super::{SMALL, command, documentation::commands_of_the_help, folder, headtail, lost_work::refused, succeed, text};

/// The commands in the help.
fn commands() -> BTreeSet<String> {
    commands_of_the_help().into_iter().map(|(name, _)| name).collect()
}

/// The first word of each command.
fn first_words<'a>(commands: impl Iterator<Item = &'a str>) -> BTreeSet<String> {
    commands.map(|command| command.split(' ').next().unwrap_or_default().to_owned()).collect()
}

/// Runs a command whose standard output is closed before the program starts.
fn unread(folder: &Path, arguments: &str) -> Output {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let child = command(folder, arguments).stdout(writer).stderr(Stdio::piped()).spawn().unwrap();
    child.wait_with_output().unwrap()
}

/// A sweep space with one short trial.
const SPACE: &str = "objectives = ['relative_variance']\n[run]\nenv = 'overcast'\nmaterial = 'lambert'\nsteps = 2\nconditions = 4\n[axes.seed]\nvalues = [1]\n";

/// A command, the replacement that turns it into another command with the same output, and its files.
type Writing<'a> = (String, (&'a str, &'a str), &'a [&'a str]);

/// Commands that end within seconds; each needs those before it.
fn writing<'a>() -> Vec<Writing<'a>> {
    let view = format!("--scene sphere --env overcast {SMALL}");
    let fit = "fit --env overcast --material lambert --steps 2";
    let fabric = "fit-material --source lacquer --side 8 --steps 1 --batch 256";
    let seed = (" --out", " --seed 5 --out");
    vec![
        (format!("{fit} --set conditions=4 --out fit"), seed, &["fit/sampler.safetensors", "fit/metrics.jsonl"]),
        (format!("{fit} --tail flow --set flow.steps=4 --set flow.cells=16 --out flow"), seed, &["flow/sampler.safetensors"]),
        (format!("{fabric} --out fabric.safetensors"), seed, &["fabric.safetensors"]),
        ("fit-rival --kind lobes --material neural:fabric.safetensors --steps 1 --out rival.safetensors".into(), seed, &["rival.safetensors"]),
        ("check-material --source lacquer --material fabric.safetensors --paths 1 --questions 16 --out check.png".into(), ("16", "17"), &["check.png"]),
        ("material raw.f32 --names a --out one.safetensors".into(), ("--names a ", ""), &["one.safetensors"]),
        ("bake --direct --env overcast --normals 4x6 --cells 4x4 --out bake/table".into(), ("4x4", "4x5"), &["bake/table"]),
        (format!("bake --visibility {view} --spp 1 --out bake/seen"), seed, &["bake/seen"]),
        (format!("render {view} --sampler mis --spp 1 --timings --aovs --out render.exr"), seed, &["render.exr", "render.png", "render.aovs.exr"]),
        (format!("compare {view} --samplers mis --runs 1 --spp 1 --reference-spp 1 --out compare"), seed, &["compare/report.html", "compare/results.csv"]),
        (format!("live {view} --samplers mis --out live.html"), ("mis --out", "brdf --out"), &["live.html"]),
        ("chart compare --out chart.html".into(), ("compare", "./compare"), &["chart.html"]),
        ("inspect bake/table --out inspect.svg".into(), (" --out", " --normal 1,0,0 --out"), &["inspect.svg"]),
        ("export bake/table --target wgsl --out shader".into(), ("bake", "./bake"), &["shader/headtail.wgsl", "shader/layout.json", "shader/floats.bin"]),
        ("conformance --out kit".into(), ("", ""), &["kit/kit.json", "kit/map.f32", "kit/table.f32"]),
        ("autosize --env overcast --scene sphere --width 16 --height 12 --prepare-seconds 1 --render-seconds 2 --out auto".into(), ("seconds 2", "seconds 3"), &["auto/autosize.html"]),
        ("sweep run space.toml --threads 1".into(), ("", ""), &["space.sweep/journal"]),
        ("sweep collect space.toml --file trials.csv".into(), ("space.", "./space."), &["trials.csv"]),
        ("sweep report space.toml --file report.html".into(), ("space.", "./space."), &["report.html"]),
        ("view --env overcast --width 16 --height 16 --out view.exr".into(), ("overcast", "studio"), &["view.exr", "view.png", "view.fspy"]),
        ("scenes --out scenes --spp 1 --width 16".into(), ("spp 1", "spp 2"), &["scenes/temple.png", "scenes/droid.png"]),
        ("stability --quick --only constant --out suite".into(), ("constant", "rough"), &["suite/stability.csv", "suite/regimes.svg"]),
        ("composite --photo view.exr --camera view.fspy --env overcast --scene sphere --spp 1 --out both".into(), seed, &["both/composite.exr", "both/composite.png", "both/composite.html"]),
    ]
}

/// Writes the inputs of the commands in [`writing`].
fn write_inputs(folder: &Path) {
    fs::write(folder.join("space.toml"), SPACE).unwrap();
    let weights = |k: usize| ((k * 37) % 19) as f32 * 0.01 - 0.09;
    fs::write(folder.join("raw.f32"), (0..2 * 675).flat_map(|k| weights(k).to_le_bytes()).collect::<Vec<u8>>())
        .unwrap();
    fs::write(folder.join("raw.names.txt"), "a\nb\n").unwrap();
}

/// Asserts that foreign files are kept, whichever output they replace.
fn files_of_others_stay(folder: &Path, arguments: &str, files: &[&str]) {
    for file in files.iter().map(|name| folder.join(name)) {
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(&file, "of somebody").unwrap();
        let said = refused(folder, arguments);
        assert!(said.contains("--force"), "{arguments}: {said}");
        assert_eq!(fs::read_to_string(&file).unwrap(), "of somebody", "{arguments}");
        fs::remove_file(&file).unwrap();
    }
}

#[test]
fn closed_readers_lose_nothing_and_only_the_same_command_replaces() {
    let here = folder();
    let path = here.path();
    write_inputs(path);
    let cases = writing();
    let others =
        ["backends --steps 1 --conditions 4 --samples 16 --backend ndarray", "info bake/table", "completions bash"];
    let without_reader = |arguments: &str| {
        let output = unread(path, arguments);
        let said = text(&output.stderr);
        assert!(output.status.success() && !said.contains("panicked"), "{arguments}: {}: {said}", output.status);
    };
    for (arguments, (from, to), files) in &cases {
        let is_guarded = from != to;
        if is_guarded {
            files_of_others_stay(path, arguments, files);
        }
        without_reader(arguments);
        let bytes = || files.iter().map(|name| fs::read(path.join(name)).unwrap()).collect::<Vec<_>>();
        if is_guarded {
            let before = bytes();
            let said = refused(path, &arguments.replacen(from, to, 1));
            assert!(said.contains("--force"), "{arguments}: {said}");
            assert_eq!(bytes(), before, "{arguments}");
            let again = command(path, arguments).output().unwrap();
            assert!(again.status.success(), "{arguments}: {}", text(&again.stderr));
        }
    }
    others.into_iter().for_each(without_reader);
    // `demo` takes minutes and only runs other commands.
    files_of_others_stay(path, "demo --out demo", &["demo/head.safetensors", "demo/report.html"]);
    let mut done = first_words(cases.iter().map(|(arguments, ..)| arguments.as_str()).chain(others));
    done.insert("demo".into());
    assert_eq!(done, commands());
    // A reader that takes one line and closes.
    let script = format!("{} scenes | head -n 1", env!("CARGO_BIN_EXE_headtail"));
    let output = Command::new("bash").args(["-o", "pipefail", "-c", &script]).output().unwrap();
    assert!(output.status.success() && text(&output.stderr).is_empty(), "{}", text(&output.stderr));
}

/// Each command would take minutes if its output were not checked first, or fails at once.
#[test]
#[cfg(target_os = "linux")]
fn unwritable_outputs_are_reported_before_the_work() {
    let here = folder();
    let path = here.path();
    fs::write(path.join("file"), "in the way").unwrap();
    fs::write(path.join("space.toml"), SPACE.replace("steps = 2", "steps = 1000000")).unwrap();
    succeed(path, "bake --direct --env overcast --normals 4x6 --cells 4x4 --out table");
    succeed(path, "view --env overcast --width 16 --height 16 --out view.exr");
    succeed(
        path,
        &format!(
            "compare --scene sphere --env overcast {SMALL} --samplers mis --runs 1 --spp 1 --reference-spp 1 --out compare"
        ),
    );
    succeed(path, "fit-material --source lacquer --side 8 --steps 1 --batch 256 --out fabric.safetensors");
    let cases = [
        "demo --out file",
        "fit --env overcast --material lambert --steps 1000000 --out file",
        "fit --env overcast --material lambert --steps 1000000 --out fit --pictures file",
        "fit --env overcast --material lambert --steps 1000000 --out fit --checkpoint-dir file",
        "fit-material --source welt --steps 1000000 --out file/a",
        "fit-rival --kind flow --material neural:fabric.safetensors --steps 1000000 --out file/a",
        "check-material --source lacquer --material fabric.safetensors --paths 1000 --out file/a.png",
        "bake --direct --env overcast --normals 128x256 --cells 64x64 --out file/a",
        "bake --visibility --scene temple --env overcast --spp 1000000 --out file/a",
        "render --scene temple --env overcast --sampler mis --spp 1000000 --out file/a.exr",
        "render --scene temple --env overcast --sampler mis --spp 1000000 --out /proc/a.exr",
        "compare --scene temple --env overcast --samplers mis --spp 100000 --out file",
        "chart compare --out file/a.html",
        "export patches --env overcast --target wgsl --out file",
        "conformance --out file",
        "inspect table --out file/a.svg",
        "autosize --env overcast --scene temple --out file",
        "sweep run space.toml --out file",
        "stability --out file",
        "composite --photo view.exr --camera view.fspy --env overcast --scene temple --spp 100000 --out file",
        "view --env overcast --width 16384 --height 8192 --out file/a.exr",
        "live --scene temple --env overcast --samplers mis --out file/a.html",
        "scenes --spp 10000 --out file",
    ];
    for arguments in cases {
        let start = Instant::now();
        let said = refused(path, arguments);
        assert!(start.elapsed() < Duration::from_secs(20), "{arguments}: {said}");
        assert!(said.contains("file") || said.contains("/proc"), "{arguments}: {said}");
    }
    assert_eq!(fs::read_to_string(path.join("file")).unwrap(), "in the way");
    let writes = |name: &String| text(&headtail(path, &format!("{name} --help")).stdout).contains("--out");
    let mut writing: BTreeSet<String> = commands().into_iter().filter(writes).collect();
    // Its subcommands have the option.
    writing.insert("sweep".into());
    // See above.
    writing.remove("material");
    assert_eq!(first_words(cases.into_iter()), writing);
}

#[test]
#[cfg(target_os = "linux")]
fn endless_inputs_are_rejected() {
    let here = folder();
    let path = here.path();
    fs::create_dir(path.join("results")).unwrap();
    for name in ["pipe", "pipe.f32", "results/results.csv"] {
        assert!(Command::new("mkfifo").arg(path.join(name)).status().unwrap().success());
    }
    succeed(path, "view --env overcast --width 16 --height 16 --out view.exr");
    let render = format!("render --scene sphere --env overcast --spp 1 {SMALL} --out a.exr --sampler");
    let composite = "composite --env overcast --scene sphere --spp 1 --out both";
    for arguments in [
        format!("{render} head:pipe"),
        format!("{render} head:/dev/zero"),
        format!("{render} head+patches:pipe"),
        format!("{render} patches+vis:pipe"),
        format!("{render} neusample:pipe"),
        format!("{render} mis --material neural:pipe"),
        format!("{render} mis --material nbrdf:pipe.f32#a"),
        format!("{render} mis").replace("overcast", "pipe"),
        format!("{render} mis").replace("sphere", "pipe"),
        format!("compare --scene sphere --env overcast {SMALL} --samplers mis --spp 1 --reference pipe --out c"),
        format!("{composite} --photo pipe --camera view.fspy"),
        format!("{composite} --photo view.exr --camera pipe"),
        "chart results --out chart.html".into(),
        "bake --from pipe --out table".into(),
        "inspect pipe --out a.svg".into(),
        "export pipe --target wgsl --out shader".into(),
        "material pipe.f32".into(),
        "check-material --source lacquer --material pipe --out a.png".into(),
        "fit --config pipe --out f".into(),
        "fit --config /dev/zero --out f".into(),
        "sweep plan pipe".into(),
        "info pipe".into(),
    ] {
        let said = refused(path, &arguments);
        assert!(said.contains("pipe or a device"), "{arguments}: {said}");
    }
}

/// A process that is killed at the end of the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

fn start(folder: &Path, arguments: &str) -> Running {
    let mut process = command(folder, arguments);
    // One thread, so that long work takes minutes on any machine.
    process.env("RAYON_NUM_THREADS", "1");
    Running(process.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap())
}

#[test]
fn second_writers_are_rejected() {
    let here = folder();
    let path = here.path();
    let view = "--scene sphere --env overcast --width 64 --height 48";
    for (first, taken, second) in [
        (
            format!("render {view} --sampler mis --spp 400000000 --out a.exr"),
            ".a.exr.lock",
            "view --env overcast --out a.exr",
        ),
        (
            format!("compare {view} --samplers mis --spp 1 --reference-spp 400000000 --out both"),
            "both/.headtail",
            "fit --env overcast --material lambert --steps 2 --out both",
        ),
    ] {
        let _first = start(path, &first);
        let begun = Instant::now();
        while !path.join(taken).exists() {
            assert!(begun.elapsed() < Duration::from_secs(60), "{first} did not begin");
            std::thread::sleep(Duration::from_millis(20));
        }
        for arguments in [second, first.as_str()] {
            let said = text(&command(path, arguments).arg("--force").output().unwrap().stderr);
            assert!(said.contains("another headtail"), "{arguments}: {said}");
        }
    }
}

/// Long work announces its estimated time within its first seconds, on one thread.
#[test]
fn long_work_is_announced() {
    let here = folder();
    let path = here.path();
    fs::write(
        path.join("space.toml"),
        SPACE.replace("steps = 2", "steps = 1000000").replace("conditions = 4", "conditions = 64"),
    )
    .unwrap();
    succeed(path, "view --env overcast --width 240 --height 160 --out view.exr");
    succeed(path, "fit-material --source lacquer --side 8 --steps 1 --batch 256 --out cloth");
    let view = "--scene temple --env overcast";
    let cases = [
        "fit --env overcast --material lambert --steps 1000000 --out fit".to_owned(),
        "fit-material --source lacquer --steps 1000000 --out fabric.safetensors".into(),
        "fit-rival --kind flow --material neural:cloth --steps 1000000 --out rival".into(),
        "check-material --source lacquer --material cloth --paths 65536 --questions 1048576 --out check.png".into(),
        "scenes --spp 65536 --width 960 --out scenes".into(),
        "bake --direct --env overcast --normals 256x512 --cells 64x64 --out table".into(),
        format!("bake --visibility {view} --spp 1000000 --out seen"),
        format!("render {view} --sampler mis --spp 100000 --out a.exr"),
        format!("compare {view} --samplers mis,patches --spp 1,100000 --runs 2 --reference-spp 1 --out c"),
        "stability --out suite".into(),
        "backends --steps 100000 --backend ndarray".into(),
        "sweep run space.toml --threads 1".into(),
        "composite --photo view.exr --camera view.fspy --env overcast --scene sphere --size 0.8 --spp 100000 --out both".into(),
    ];
    // Commands that take seconds or a given time; the help of `demo` states its two minutes.
    let short = [
        "autosize",
        "chart",
        "completions",
        "conformance",
        "demo",
        "export",
        "info",
        "inspect",
        "live",
        "material",
        "view",
    ];
    let mut listed = first_words(cases.iter().map(String::as_str));
    listed.extend(short.map(str::to_owned));
    assert_eq!(listed, commands());
    for arguments in cases {
        let mut process = start(path, &arguments);
        let lines = BufReader::new(process.0.stderr.take().unwrap()).lines();
        let mut said = Vec::new();
        for line in lines.map_while(Result::ok) {
            said.push(line);
            let last = said.last().unwrap();
            if last.contains("will take about") || last.contains("to be made") && last.contains("about") {
                break;
            }
            // The first progress line comes after ten seconds.
            assert!(!last.contains(" done, ") || !last.contains("left"), "{arguments}: {said:?}");
        }
        let announced =
            said.last().is_some_and(|line| line.contains(" about ") && (line.contains(" min") || line.contains(" h")));
        assert!(announced, "{arguments}: {said:?}");
    }
}
