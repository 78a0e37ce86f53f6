//! Computed results survive closed or full outputs, other comparisons and unwritable files.

use std::{
    fs::{self, OpenOptions},
    path::Path,
    process::Stdio,
};

use headtail_render::image::{Attribute, Image, write_exr};

use super::{SMALL, command, folder, names, radiance_file, succeed, text};

#[test]
#[cfg(target_os = "linux")]
fn full_outputs_are_reported_after_files_are_written() {
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
    // The file is written whatever the command prints.
    let view = format!("--scene sphere --env overcast {SMALL}");
    for (arguments, result) in [
        ("bake --direct --env overcast --normals 4x6 --cells 4x4 --out table".to_owned(), "table"),
        ("inspect table --out picture.svg".into(), "picture.svg"),
        ("inspect table --json --out picture.json.svg".into(), "picture.json.svg"),
        (format!("render {view} --sampler mis --spp 1 --json --out a.exr"), "a.png"),
        (format!("compare {view} --samplers mis --runs 1 --spp 1 --reference-spp 1 --out c"), "c/report.html"),
        ("fit-material --source lacquer --side 8 --steps 1 --batch 256 --json --out cloth".into(), "cloth"),
        ("scenes --width 16 --spp 1 --out scenes".into(), "scenes/temple.png"),
        ("info table --json".into(), "table"),
        ("completions bash".into(), "table"),
    ] {
        let full = OpenOptions::new().write(true).open("/dev/full").unwrap();
        let output = command(path, &arguments).stdout(full).stderr(Stdio::piped()).output().unwrap();
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments}: {said}");
        assert!(said.contains("standard output is incomplete"), "{arguments}: {said}");
        assert!(path.join(result).exists(), "{arguments}");
    }
    // With both outputs full, files are still written.
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
            && log.contains("1 spp of lattice:1")
            && log.contains(" pixels, hash "),
        "{log}"
    );
    let output = command(path, &format!("-v {render}")).output().unwrap();
    assert!(text(&output.stderr).starts_with("detail: overcast: "), "{}", text(&output.stderr));
    // `--quiet` does not silence data.
    assert!(succeed(path, "scenes -q").contains("temple"));
}

/// Returns the error message of a failing command.
pub fn refused(folder: &Path, arguments: &str) -> String {
    let output = command(folder, arguments).output().unwrap();
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{arguments}: {said}");
    said
}

#[test]
fn results_of_other_commands_are_kept() {
    let here = folder();
    let path = here.path();
    let compare = |samplers: &str| {
        format!(
            "compare --scene sphere --env overcast {SMALL} --samplers {samplers} --runs 1 --spp 1 --reference-spp 1 --out c"
        )
    };
    assert!(command(path, &compare("mis,ris:2")).output().unwrap().status.success());
    let bytes = |name: &str| fs::read(path.join(name)).unwrap();
    let table = bytes("c/results.csv");
    assert!(refused(path, &compare("mis,ris:4")).contains("results.csv of another command"));
    assert_eq!(bytes("c/results.csv"), table);
    // The same command and one with `--force` replace all files of the first.
    assert!(command(path, &compare("mis,ris:2")).output().unwrap().status.success());
    succeed(path, &compare("mis,ris:4"));
    assert!(!path.join("c/ris-2_1spp.exr").exists() && path.join("c/ris-4_1spp.exr").exists());

    let render =
        |spp: u32| format!("render --scene sphere --env overcast --sampler mis --spp {spp} {SMALL} --out a.exr");
    for (spp, is_done) in [(1, true), (1, true), (2, false)] {
        assert_eq!(command(path, &render(spp)).output().unwrap().status.success(), is_done);
    }
    let bake = |cells: &str| format!("bake --direct --env overcast --normals 4x6 --cells {cells} --out table");
    for (cells, is_done) in [("4x4", true), ("4x4", true), ("4x5", false)] {
        assert_eq!(command(path, &bake(cells)).output().unwrap().status.success(), is_done);
    }
    let fit = |seed: u32| {
        format!("fit --env overcast --material lambert --steps 2 --set conditions=4 --seed {seed} --out fit")
    };
    for (seed, is_done) in [(1, true), (1, true), (2, false)] {
        assert_eq!(command(path, &fit(seed)).output().unwrap().status.success(), is_done);
    }
    assert!(
        refused(path, "fit --env overcast --material lambert --steps 2 --out c/fit --pictures a.exr").contains("a.exr")
    );
}

#[test]
fn samplers_never_share_a_file() {
    let here = folder();
    let path = here.path();
    succeed(path, "bake --direct --env overcast --normals 4x6 --cells 4x4 --out D");
    let compare =
        format!("compare --scene sphere --env overcast {SMALL} --runs 1 --spp 1 --reference-spp 1 --out c --samplers");
    succeed(path, &format!("{compare} ris:2:direct:D,ris:8:direct:D"));
    let pictures: Vec<String> = names(&path.join("c")).into_iter().filter(|name| name.ends_with("_1spp.exr")).collect();
    assert_eq!(pictures, ["ris-2-direct-D_1spp.exr", "ris-8-direct-D_1spp.exr"]);
    assert!(
        refused(path, &format!("{compare} mis,brdf,mis").replace("--out c", "--out d")).contains("mis is given twice")
    );
}

#[test]
#[cfg(target_os = "linux")]
fn devices_are_kept_and_links_followed() {
    use std::os::unix::fs::{FileTypeExt, symlink};
    let here = folder();
    let path = here.path();
    // Devices are kept; links are followed.
    assert!(refused(path, "bake --direct --env overcast --out /dev/null").contains("device"));
    assert!(fs::metadata("/dev/null").unwrap().file_type().is_char_device());
    symlink("target.exr", path.join("link.exr")).unwrap();
    let render = format!("render --scene sphere --env overcast --sampler mis --spp 1 {SMALL}");
    succeed(path, &format!("{render} --out link.exr"));
    assert!(fs::symlink_metadata(path.join("link.exr")).unwrap().is_symlink() && path.join("target.exr").exists());
    symlink("/dev/null", path.join("null.exr")).unwrap();
    assert!(refused(path, &format!("{render} --out null.exr")).contains("device"));
    succeed(path, "bake --direct --env overcast --normals 4x6 --cells 4x4 --out table");
    assert!(refused(path, "inspect table --out picture.jpg").contains(".svg"));
}

/// Work beyond a limit of 200 MB is rejected by name, on any machine.
#[test]
fn work_beyond_the_memory_limit_is_rejected() {
    let here = folder();
    let path = here.path();
    let large = "--width 16384 --height 16384";
    let view = format!("--scene sphere --env overcast {large}");
    fs::write(path.join("large.hdr"), radiance_file(2048, 1536, 128, 128)).unwrap();
    succeed(path, "view --env overcast --width 32 --height 32 --out photo.exr");
    succeed(path, "bake --direct --env overcast --normals 32x64 --cells 64x64 --out middling");
    let picture = "a picture of 16384 x 16384 pixels";
    for (arguments, what) in [
        ("fit --env overcast --material lambert --set conditions=65536 --set strata=1024 --out f".to_owned(), "conditions, strata"),
        (format!("render {view} --sampler mis --spp 1 --out a.exr"), picture),
        (format!("compare {view} --samplers mis --spp 1 --out c"), picture),
        (format!("bake --visibility {view} --spp 1 --out seen"), picture),
        (format!("view --env overcast {large} --out view.exr"), picture),
        ("composite --photo photo.exr --camera photo.fspy --env overcast --scene sphere --width 16384 --spp 1 --out both".into(), picture),
        ("bake --direct --env overcast --normals 256x512 --cells 64x64 --out table".into(), "a table of 131072 normals, 4096 cells for each"),
        (format!("render --scene sphere --env large.hdr --sampler mis --spp 1 {SMALL} --out a.exr"), "large.hdr: pixels"),
        // The file has 1/7 of the size of its numbers in memory.
        (format!("render --scene sphere --env overcast --sampler direct:middling --spp 1 {SMALL} --out a.exr"), "middling: a table of 2048 normals"),
    ] {
        let output = command(path, &arguments).env("HEADTAIL_MEMORY", "200").output().unwrap();
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments}: {said}");
        assert!(said.contains(what) && said.contains(" takes about ") && said.contains("of memory are available"), "{arguments}: {said}");
    }
    let output = command(path, "view --env overcast --out view.exr").env("HEADTAIL_MEMORY", "a lot").output().unwrap();
    assert!(text(&output.stderr).contains("HEADTAIL_MEMORY: is a whole number of MB"), "{}", text(&output.stderr));
}

#[test]
fn file_contents_are_escaped_on_the_terminal() {
    let here = folder();
    let path = here.path();
    fs::write(path.join("run.toml"), "\"\u{1b}[2J\u{9b}31m\" = 1\nenv = 'studio'\n").unwrap();
    let said = refused(path, "fit --config run.toml --out f");
    assert!(!said.contains(['\u{1b}', '\u{9b}']), "{said:?}");

    // Names and texts in files, as printed by `info`.
    let evil = "\u{1b}[2J\u{9b}31m";
    let image = Image { width: 1, height: 1, pixels: vec![[1.0; 3]] };
    write_exr(&path.join("a.exr"), &image, &[Attribute::new("note", "\u{1b}[2J")]).unwrap();
    let gltf = serde_json::json!({
        "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0, "name": evil }],
        "buffers": [{ "byteLength": 36, "uri": "triangle.bin" }], "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0] }],
        "meshes": [{ "name": evil, "primitives": [{ "attributes": { "POSITION": 0 } }] }],
    });
    fs::write(path.join("scene.gltf"), gltf.to_string()).unwrap();
    let corners = [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    fs::write(path.join("triangle.bin"), corners.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>()).unwrap();
    let map = format!("{evil}.hdr");
    fs::write(path.join(&map), radiance_file(4, 2, 128, 129)).unwrap();
    succeed(path, &format!("bake --direct --env {map} --normals 4x6 --cells 4x4 --out table"));
    for (file, shown) in [("a.exr", "note"), ("scene.gltf", "meshes"), ("table", "environment")] {
        for json in ["", " --json"] {
            let said = succeed(path, &format!("info {file}{json}"));
            assert!(said.contains(shown) && said.contains("[2J"), "{file}: {said:?}");
            assert!(!said.contains(['\u{1b}', '\u{9b}']), "{file}{json}: {said:?}");
        }
    }
}

/// Weights of 1e30 are finite, but yield no density.
#[test]
fn overflowing_weights_are_rejected() {
    let here = folder();
    let path = here.path();
    succeed(path, "fit --env overcast --material lambert --steps 2 --set conditions=4 --out fit");
    let mut bytes = fs::read(path.join("fit/sampler.safetensors")).unwrap();
    let header = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let tensors = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let places: Vec<(usize, usize)> = tensors
        .iter()
        .filter(|(name, _)| name.starts_with("layer"))
        .map(|(_, view)| (view.data().as_ptr() as usize - bytes.as_ptr() as usize, view.data().len()))
        .collect();
    assert!(!places.is_empty() && places.iter().all(|place| place.0 >= header));
    for (start, length) in places {
        for value in bytes[start..start + length].as_chunks_mut::<4>().0 {
            *value = 1e30_f32.to_le_bytes();
        }
    }
    fs::write(path.join("absurd"), bytes).unwrap();
    let said = refused(
        path,
        &format!("render --scene sphere --env overcast --sampler head:absurd --spp 1 {SMALL} --out a.exr"),
    );
    assert!(said.contains("weights: they make no density"), "{said}");
    assert!(refused(path, "inspect absurd --out a.svg").contains("no density"));
}

/// Uses a small file system in a mount namespace that ends with the script. Reports a skip if namespaces are
/// not permitted, except where the variable CI is set and they are.
#[test]
#[cfg(target_os = "linux")]
fn full_disks_keep_finished_runs() {
    let here = folder();
    let script = format!(
        "mkdir small && mount -t tmpfs -o size=300k tmpfs small && echo MOUNTED || exit 0
         '{}' compare --scene sphere --env overcast --width 96 --height 72 --samplers mis,brdf,emitter,patches --runs 3 --spp 1,2,4 \
         --reference-spp 1 --out small/c
         echo \"STATUS $?\"; cat small/c/results.csv",
        env!("CARGO_BIN_EXE_headtail")
    );
    let mut process = std::process::Command::new("unshare");
    let output = process.args(["-rm", "bash", "-c", &script]).current_dir(here.path()).output();
    let Some(said) = output.ok().map(|output| text(&output.stdout)).filter(|said| said.contains("MOUNTED")) else {
        let allows_namespaces =
            std::process::Command::new("unshare").args(["-rm", "true"]).status().is_ok_and(|s| s.success());
        assert!(
            !(allows_namespaces && std::env::var("CI").is_ok_and(|ci| ci == "true")),
            "a namespace, and no mount in it"
        );
        eprintln!("skipped: no file system can be mounted; namespaces: {allows_namespaces}");
        return;
    };
    assert!(said.contains("STATUS 1"), "{said}");
    // The first picture (83 kB) and the reference of the same size fit. The table has all runs before the
    // failed one.
    let rows = said.lines().filter(|line| line.starts_with("sphere,overcast,") && line.contains(",lattice:")).count();
    assert!(rows >= 2, "{said}");
}

#[test]
fn stability_resumes_with_missing_regimes() {
    let here = folder();
    let path = here.path();
    let suite = "stability --quick --only constant --out suite";
    assert!(command(path, suite).output().unwrap().status.success());
    let table = || fs::read_to_string(path.join("suite/stability.csv")).unwrap();
    // Times differ between measurements, so equal bytes were kept.
    let before = table();
    fs::remove_file(path.join("suite/stability.csv")).unwrap();
    fs::remove_file(path.join("suite/regimes.svg")).unwrap();
    assert!(command(path, suite).output().unwrap().status.success());
    assert_eq!(table(), before);
    // Damaged regimes are measured again.
    fs::write(path.join("suite/regimes/constant-map.toml"), "key = 'x'").unwrap();
    assert!(command(path, suite).output().unwrap().status.success());
    assert_ne!(table(), before);
}
