//! Invalid inputs are rejected with an error.

use std::{fs, path::Path};

use headtail_render::image::{Image, write_exr};

use super::{SMALL, command, fail, folder, headtail, names, picture, radiance_file, refuse, succeed, text};

#[test]
fn unavailable_instruction_sets_are_rejected() {
    let here = folder();
    let output = command(here.path(), "scenes").env("HEADTAIL_SIMD", "abacus").output().unwrap();
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.starts_with("error: HEADTAIL_SIMD: \"abacus\"") && message.lines().count() == 1, "{message}");
}

#[test]
fn invalid_maps_are_repaired_or_rejected() {
    let here = folder();
    let path = here.path();
    let write = |name: &str, bytes: &[u8]| fs::write(path.join(name), bytes).unwrap();
    write("black.hdr", &radiance_file(4, 2, 0, 0));
    write("truncated.hdr", &radiance_file(64, 32, 128, 129)[..900]);
    write("empty.hdr", b"");
    write("text.hdr", b"not a picture at all");
    let render = |map: &str| format!("render --scene sphere --sampler mis --spp 2 {SMALL} --out a.exr --env {map}");
    for (map, expected) in [
        ("black.hdr", "black"),
        ("truncated.hdr", "too early"),
        ("empty.hdr", "empty"),
        ("text.hdr", "neither"),
        ("missing.hdr", "overcast, window, studio, sunset"),
        (".", ""),
    ] {
        let sentence = fail(path, &render(map));
        assert!(sentence.contains(map) && sentence.contains(expected), "{sentence}");
        fail(path, &format!("bake --direct --env {map} --out table"));
        fail(path, &format!("fit --env {map} --material lambert --steps 1 --out fitted"));
    }
    assert!(!path.join("a.exr").exists() && !path.join("table").exists());

    // Mantissa 128, exponent 129: radiance 1 everywhere, from a single texel. A white sphere in it is
    // invisible.
    write("one.hdr", &radiance_file(1, 1, 128, 129));
    succeed(path, &render("one.hdr").replace("mis", "cosine"));
    let white = picture(&path.join("a.exr"));
    assert!(white.pixels.iter().flatten().all(|value| (value - 1.0).abs() < 1e-3));
    succeed(path, "bake --direct --env one.hdr --normals 4x6 --cells 4x4 --out one.safetensors");

    let mut spoilt = Image { width: 8, height: 4, pixels: vec![[1.0; 3]; 32] };
    (spoilt.pixels[3], spoilt.pixels[9]) = ([f32::NAN, 1.0, -2.0], [f32::INFINITY, 1.0, 1.0]);
    write_exr(&path.join("spoilt.exr"), &spoilt, &[]).unwrap();
    let output = headtail(path, &render("spoilt.exr"));
    let warnings = text(&output.stderr);
    assert!(output.status.success(), "{warnings}");
    for kind in ["NaN", "negative", "infinite"] {
        let warning = warnings.lines().find(|line| line.contains(kind)).unwrap_or_else(|| panic!("{warnings}"));
        assert!(warning.starts_with("warning: spoilt.exr: "), "{warning}");
    }
    assert!(picture(&path.join("a.exr")).pixels.iter().flatten().all(|value| value.is_finite()));
}

#[test]
fn sampler_files_are_checked_before_they_are_used() {
    let here = folder();
    let path = here.path();
    succeed(path, "fit --env overcast --material lambert --steps 1 --out head");
    succeed(path, "bake --from head/sampler.safetensors --normals 4x6 --cells 4x4 --out baked");
    succeed(path, "bake --direct --env overcast --normals 4x6 --cells 4x4 --out direct");
    let bytes = fs::read(path.join("direct")).unwrap();
    fs::write(path.join("cut"), &bytes[..bytes.len() / 2]).unwrap();
    fs::write(path.join("newer"), replace(&bytes, b"\\\"format_version\\\":3", b"\\\"format_version\\\":9")).unwrap();

    let render = |env: &str, sampler: &str| {
        fail(path, &format!("render --scene sphere --env {env} --sampler {sampler} --spp 1 {SMALL} --out a.exr"))
    };
    for (sampler, hint) in [
        ("head:baked", "baked:FILE"),
        ("baked:head/sampler.safetensors", "head:FILE"),
        ("baked:direct", "direct:FILE"),
        ("direct:baked", "baked:FILE"),
        ("direct:cut", "header"),
        ("direct:newer", "format_version"),
        ("direct:nothing", "nothing"),
    ] {
        let sentence = render("overcast", sampler);
        assert!(sentence.contains(hint), "{sampler}: {sentence}");
    }
    let sentence = render("studio", "direct:direct");
    assert!(sentence.contains("'overcast'") && sentence.contains("'studio'"), "{sentence}");
    assert!(!path.join("a.exr").exists());

    assert!(fail(path, "bake --from direct --out b").contains("table already"));
    assert!(fail(path, "bake --from nothing --out b").starts_with("nothing: "));
    assert!(fail(path, "inspect cut --out a.svg").starts_with("cut: "));
    assert!(fail(path, "inspect direct --normal 0,0,0 --out a.svg").contains("--normal"));
    assert_eq!(names(path), ["baked", "cut", "direct", "head", "newer"]);
}

/// Replaces the only occurrence of `from` in `bytes` by `to`, which has the same length.
fn replace(bytes: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    let start = bytes.windows(from.len()).position(|window| window == from).expect("it is there");
    let mut changed = bytes.to_vec();
    changed[start..start + to.len()].copy_from_slice(to);
    changed
}

#[test]
fn values_out_of_range_are_refused() {
    let here = folder();
    let path = here.path();
    let render = "render --scene sphere --env overcast --out a.exr";
    for (arguments, named) in [
        ("", "Usage"),
        ("paint", "paint"),
        ("fit --env studio --material ggx --out a", "ggx:alpha=0.4"),
        ("fit --env studio --material lambert --steps 0 --out a", "--steps"),
        ("fit --env studio --material lambert --seed -1 --out a", "-1"),
        ("bake --out a", "--direct"),
        ("bake --direct --out a", "--env"),
        ("bake --env studio --out a", "--from"),
        ("bake --direct --from a --env studio --out b", "--from"),
        ("bake --direct --env studio --cells 8 --out a", "16x32"),
        ("render --env overcast --sampler mis --spp 1 --out a.exr", "--scene"),
        (&format!("{render} --sampler mis"), "--spp"),
        (&format!("{render} --sampler mis --spp 1 --seconds 1"), "--seconds"),
        (&format!("{render} --sampler mis --spp 1 --width 0"), "--width"),
        (&format!("{render} --sampler mis --spp 1 --height 16385"), "--height"),
        (&format!("{render} --sampler mis --spp 1 --threads 0"), "--threads"),
        (&format!("{render} --sampler mis --spp 1 --look-from 1,2"), "three numbers"),
        (&format!("{render} --sampler mis --spp 1 --look-from 1,2,3"), "--look-at"),
        (&format!("{render} --sampler best --spp 1"), "'best'"),
        (&format!("{render} --sampler ris:0 --spp 1"), "ris:4"),
        (&format!("{render} --sampler head: --spp 1"), "head:FILE"),
        (&format!("{render} --sampler mis:4 --spp 1"), "colon"),
        ("compare --scene sphere --env overcast --samplers mis --spp 1 --runs 0 --out a", "--runs"),
        ("compare --scene sphere --env overcast --samplers mis --out a", "--spp"),
        ("inspect", "<FILE>"),
    ] {
        let message = refuse_or_help(path, arguments);
        assert!(message.contains(named), "{arguments}: {message}");
    }
    for (arguments, named) in [
        ("bake --direct --env studio --cells 65x8 --out a", "--cells"),
        ("bake --direct --env studio --normals 1x8 --out a", "--normals"),
        (&format!("{render} --sampler mis --spp 0"), "--spp"),
        (&format!("{render} --sampler mis --seconds=-1"), "--seconds"),
        (&format!("{render} --sampler mis --seconds nan"), "--seconds"),
        (&format!("{render} --sampler mis --spp 1 --fov 500"), "field of view"),
        (&format!("{render} --sampler mis --spp 1 --look-from 0,1,0 --look-at 0,1,0"), "direction"),
        ("render --scene sphere --env overcast --sampler mis --spp 1 --out a.png", ".exr"),
        ("compare --scene sphere --env overcast --samplers mis --spp 0 --out a", "--spp"),
        ("demo --env nowhere --out a", "nowhere"),
        ("material nowhere.safetensors", "nowhere.safetensors"),
        (
            "render --scene sphere --env overcast --material nbrdf:nowhere.png --sampler mis --spp 1 --out a.exr",
            "neither .safetensors nor .f32",
        ),
    ] {
        let message = fail(path, arguments);
        assert!(message.contains(named), "{arguments}: {message}");
    }
    #[cfg(not(feature = "wgpu"))]
    assert!(fail(path, "fit --env studio --material lambert --backend wgpu --out a").contains("--features wgpu"));
    let left: Vec<_> = names(path).into_iter().filter(|name| name != "a").collect();
    assert_eq!(left, Vec::<String>::new());
}

/// Like [`refuse`]; without arguments, the help is shown instead.
fn refuse_or_help(folder: &Path, arguments: &str) -> String {
    if arguments.is_empty() { text(&headtail(folder, arguments).stderr) } else { refuse(folder, arguments) }
}

#[test]
fn unwritable_files_are_errors() {
    let here = folder();
    fs::write(here.path().join("file"), "in the way").unwrap();
    let render = format!("render --scene sphere --env overcast --sampler mis --spp 1 {SMALL}");
    for arguments in [
        format!("{render} --out file/a.exr"),
        "bake --direct --env overcast --normals 4x6 --cells 4x4 --out file/a".into(),
        "fit --env overcast --material lambert --steps 1 --out file".into(),
        "compare --scene sphere --env overcast --samplers mis --spp 1 --out file".into(),
    ] {
        let sentence = fail(here.path(), &arguments);
        assert!(sentence.starts_with("file"), "{sentence}");
    }
    // An existing entry is kept if the new file cannot replace it: here a folder has the name.
    fs::create_dir(here.path().join("taken.exr")).unwrap();
    assert!(fail(here.path(), &format!("{render} --out taken.exr")).starts_with("taken.exr"));
    assert_eq!(names(here.path()), ["file", "taken.exr"]);
    assert_eq!(fs::read_to_string(here.path().join("file")).unwrap(), "in the way");
}

#[cfg(not(feature = "gpu"))]
#[test]
fn graphics_devices_of_builds_without_them_are_refused() {
    let here = folder();
    for command in ["render --spp 1 --sampler mis --out a.exr", "compare --spp 1 --samplers mis --out results"] {
        let sentence = fail(here.path(), &format!("{command} --scene sphere --env studio {SMALL} --device gpu"));
        assert!(sentence.contains("--device gpu") && sentence.contains("--features gpu"), "{sentence}");
    }
}
