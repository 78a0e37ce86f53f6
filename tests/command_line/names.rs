//! Non-UTF-8 file names are accepted everywhere.
#![cfg(unix)]

use std::{
    ffi::OsStr,
    fs,
    os::unix::ffi::OsStrExt,
    path::Path,
    process::{Command, Output},
};

use super::{
    SMALL, command,
    documentation::{pyramid, room},
    folder, text,
};

fn name(bytes: &[u8]) -> &OsStr {
    OsStr::from_bytes(bytes)
}

fn run(process: &mut Command) -> Output {
    let output = process.output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    output
}

#[test]
fn non_utf8_names_are_accepted() {
    let here = folder();
    let path = here.path();
    let picture = name(b"caf\xe9.exr");
    let render = format!("render --scene sphere --env overcast --sampler mis --spp 1 {SMALL}");
    run(command(path, &render).arg("--out").arg(picture));
    assert!(path.join(picture).exists());
    run(command(path, "info").arg(picture));
}

/// Options where a name can be a built-in one or part of a text.
#[test]
fn maps_scenes_materials_and_samplers_accept_any_names() {
    let here = folder();
    let path = here.path();
    let (map, scene) = (name(b"caf\xe9,\xe9.hdr"), name(b"\xfe.glb"));
    let cloth = Path::new(env!("CARGO_MANIFEST_DIR")).join("checkpoints/satin.safetensors");
    fs::write(path.join(map), room()).unwrap();
    fs::write(path.join(scene), pyramid()).unwrap();
    fs::copy(cloth, path.join(name(b"\xfd.safetensors"))).unwrap();
    let bake = "bake --direct --normals 4x6 --cells 4x4 --out";
    run(command(path, bake).arg(name(b"\xff.safetensors")).arg("--env").arg(map));

    let compare = format!("compare {SMALL} --spp 1 --reference-spp 2 --runs 1 --out compared");
    let samplers = name(b"mis,direct:\xff.safetensors,ris:2:direct:\xff.safetensors");
    run(command(path, &compare).arg("--env").arg(map).arg("--scene").arg(scene).arg("--samplers").arg(samplers));
    let table = fs::read_to_string(path.join("compared/results.csv")).unwrap();
    // Names in results select the same file again.
    let written = table.lines().find_map(|line| line.split(',').find(|cell| cell.starts_with("direct:"))).unwrap();
    let render = format!("render {SMALL} --scene sphere --spp 1 --out again.exr --sampler");
    run(command(path, &render).arg(written).arg("--env").arg(map));

    let render = format!("render {SMALL} --scene plane --sampler patches --spp 1 --out cloth.exr");
    let material = name(b"neural:\xfd.safetensors,repeat=3");
    run(command(path, &render).arg("--env").arg(map).arg("--material").arg(material));

    // Slurm scripts contain raw bytes; `%` in the names of logs begins a pattern.
    fs::write(
        path.join(name(b"\xfc.toml")),
        "objectives = [\"relative_variance\"]\n[run]\nenv = \"studio\"\n[axes]\nseed = [1, 2]\n",
    )
    .unwrap();
    run(command(path, "sweep submit --dry-run").arg(name(b"\xfc.toml")).arg("--out").arg(name(b"5%\xfb")));
    let script = fs::read(path.join(name(b"5%\xfb/slurm.sh"))).unwrap();
    let holds = |part: &[u8]| script.windows(part.len()).any(|bytes| bytes == part);
    assert!(holds(b"/\xfc.toml' --out '") && holds(b"/5%\xfb' --task") && holds(b"/5%%\xfb/logs/slurm-%A_%a.log'"));

    let output = command(path, "view --out view.exr --env").arg(name(b"nowhere\xe9.hdr")).output().unwrap();
    let said = text(&output.stderr);
    assert!(output.status.code() == Some(1) && said.contains("there is no such file"), "{said}");
}
