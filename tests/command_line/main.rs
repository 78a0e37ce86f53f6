//! The command line from outside: every command on small built-in data, mistakes, interruption, reproducibility.
//!
//! `demo` takes too long for a test; the script that runs every check runs it.

mod browser;
mod composite;
mod documentation;
mod export;
#[cfg(target_os = "linux")]
mod interruption;
mod lost_work;
mod options;
mod sweep;
mod visibility;

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use headtail_render::{
    export::ExportedSampler,
    image::{Image, read_radiance, write_exr},
};
use tempfile::TempDir;

/// Runs the program in `folder`, so that paths in arguments and messages are short. What other commands left there may be replaced.
fn headtail(folder: &Path, arguments: &str) -> Output {
    command(folder, arguments).arg("--force").output().expect("the program starts")
}

fn command(folder: &Path, arguments: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_headtail"));
    command.current_dir(folder).args(arguments.split_whitespace());
    command
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("the program writes UTF-8")
}

/// Runs a command that must succeed; its standard output.
fn succeed(folder: &Path, arguments: &str) -> String {
    let output = headtail(folder, arguments);
    assert!(output.status.success(), "{arguments}: {}\n{}", output.status, text(&output.stderr));
    text(&output.stdout)
}

/// Runs a command that must fail with one sentence; the sentence.
fn fail(folder: &Path, arguments: &str) -> String {
    let output = headtail(folder, arguments);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{arguments}: {message}");
    assert_eq!(message.trim_end().lines().count(), 1, "{arguments}: {message}");
    let sentence = message.strip_prefix("error: ").unwrap_or_else(|| panic!("{arguments}: {message}"));
    let reason = sentence.rsplit(": ").next().unwrap_or_default().trim();
    assert_eq!(sentence.matches(reason).count(), 1, "the reason is given twice: {sentence}");
    sentence.trim_end().to_owned()
}

/// Runs a command that the parser of arguments must refuse; what it says.
fn refuse(folder: &Path, arguments: &str) -> String {
    let output = headtail(folder, arguments);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{arguments}: {message}");
    assert!(message.starts_with("error: ") && !message.contains("panicked"), "{arguments}: {message}");
    message
}

fn folder() -> TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// The names in a folder, sorted; a temporary file that was left over would be among them.
fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("the folder is there");
    let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    // What says which command made the others.
    names.retain(|name| name != ".headtail");
    names.sort();
    names
}

fn picture(path: &Path) -> Image {
    read_radiance(path).unwrap()
}

/// Mean over pixels and channels.
fn mean(image: &Image) -> f64 {
    image.pixels.iter().flatten().map(|&value| f64::from(value)).sum::<f64>() / (3 * image.pixels.len()) as f64
}

/// A Radiance file of flat (not run-length coded) pixels, all of one colour: `mantissa / 256 * 2^(exponent - 128)`.
fn radiance_file(width: usize, height: usize, mantissa: u8, exponent: u8) -> Vec<u8> {
    let mut bytes = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n").into_bytes();
    bytes.extend([mantissa, mantissa, mantissa, exponent].repeat(width * height));
    bytes
}

fn is_png(path: &Path) -> bool {
    fs::read(path).unwrap().starts_with(b"\x89PNG\r\n\x1a\n")
}

/// Whether a file is a drawing that needs nothing from outside.
fn is_svg(path: &Path) -> bool {
    let svg = fs::read_to_string(path).unwrap();
    // The name of the format is no address that is asked for.
    let addresses = svg.matches("http:").count() + svg.matches("https:").count();
    svg.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\"") && svg.ends_with("</svg>\n") && addresses == 1
}

const SMALL: &str = "--width 24 --height 18";

#[test]
fn the_help_of_every_command_ends_with_examples() {
    let here = folder();
    for name in [
        "demo",
        "fit",
        "fit-material",
        "fit-rival",
        "check-material",
        "backends",
        "bake",
        "render",
        "compare",
        "chart",
        "inspect",
        "material",
        "stability",
        "composite",
        "view",
        "paper",
        "scenes",
    ] {
        let help = succeed(here.path(), &format!("{name} --help"));
        let (_, examples) = help.split_once("Examples:").unwrap_or_else(|| panic!("{name}: no examples"));
        assert!(examples.contains(&format!("headtail {name}")), "{help}");
        assert!(succeed(here.path(), "--help").contains(&format!("\n  {name} ")));
    }
    let version = format!("headtail {}", env!("CARGO_PKG_VERSION"));
    assert_eq!(succeed(here.path(), "-V").trim(), version);
    let long = succeed(here.path(), "--version");
    assert!(
        long.starts_with(&version) && long.contains("features: flex") && long.contains("instruction set: "),
        "{long}"
    );
}

#[test]
fn a_head_is_fitted_baked_rendered_and_inspected() {
    let here = folder();
    let path = here.path();
    let said = succeed(path, "fit --env overcast --material lambert --steps 30 --seed 3 --out fitted");
    assert!(said.contains("KL ") && said.contains("30 steps"), "{said}");
    let files = ["measures.json", "metrics.jsonl", "resolved.toml", "sampler.safetensors"];
    assert_eq!(names(&path.join("fitted")), files);

    succeed(path, "bake --from fitted/sampler.safetensors --normals 6x8 --cells 8x8 --out baked.safetensors");
    succeed(path, "inspect fitted/sampler.safetensors --normal 1,0.5,-0.2 --out pictures/head.svg");
    succeed(path, "inspect baked.safetensors --out pictures/baked.svg");
    assert_eq!(names(&path.join("pictures")), ["baked.svg", "head.svg"]);
    assert!(is_svg(&path.join("pictures/head.svg")) && is_svg(&path.join("pictures/baked.svg")));

    // The samplers estimate one and the same picture.
    let view = format!("render --scene sphere --env overcast --spp 64 {SMALL}");
    for (sampler, name) in [("head:fitted/sampler", "head"), ("baked:baked", "baked")] {
        let said = succeed(path, &format!("{view} --sampler {sampler}.safetensors --out {name}.exr"));
        assert!(said.starts_with(sampler) && said.contains("64 spp"), "{said}");
    }
    succeed(path, &format!("{view} --sampler mis --out mis.exr"));
    let expected = mean(&picture(&path.join("mis.exr")));
    for name in ["head", "baked"] {
        let found = mean(&picture(&path.join(name).with_extension("exr")));
        // 432 pixels at 64 samples of relative deviation below 1: the mean is known to well under 1 %.
        assert!((found / expected - 1.0).abs() < 0.02, "{name}: {found}, mis: {expected}");
    }
}

#[test]
fn a_run_is_one_file_that_its_results_repeat() {
    let here = folder();
    let path = here.path();
    let run = "env = 'studio'\nout = 'first'\nsteps = 10\nconditions = 8\nhead.bins = 5\n[export]\nreproducible = true\n\
               [measure]\ntime = true\n[[measure.views]]\nname = 'ball'\nscene = 'sphere'\nwidth = 16\nheight = 12\nspp = 2\n\
               seconds = 0.02\nreference_spp = 16\n";
    fs::write(path.join("run.toml"), run).unwrap();
    let said = succeed(path, "fit --config run.toml");
    assert!(said.contains("10 steps") && said.contains("mse:ball") && said.contains("ns_per_sample"), "{said}");
    succeed(path, "fit --config first/resolved.toml --out second");
    let bytes = |file: &str| fs::read(path.join(file)).unwrap();
    assert_eq!(bytes("first/sampler.safetensors"), bytes("second/sampler.safetensors"));
    assert_eq!(bytes("first/resolved.toml"), bytes("second/resolved.toml"));
    // Every setting is inside of the file, and the table that made a table, too.
    let exported = ExportedSampler::read(&path.join("first/sampler.safetensors")).unwrap();
    assert_eq!(exported.run.as_deref().map(str::as_bytes), Some(&bytes("first/resolved.toml")[..]));
    succeed(path, "bake --from first/sampler.safetensors --normals 4x8 --cells 4x4 --out baked");
    let baked = ExportedSampler::read(&path.join("baked")).unwrap().run.unwrap();
    assert!(baked.starts_with(exported.run.as_deref().unwrap()) && baked.contains("normals = [4, 8]"), "{baked}");
    let flags = succeed(path, "fit --config run.toml --set head.bins=6 --out third --no-export");
    assert!(flags.contains("nothing was exported"), "{flags}");
    assert!(String::from_utf8(bytes("third/resolved.toml")).unwrap().contains("bins = 6"));
    assert!(fail(path, "fit --config first/resolved.toml").contains("--out"));
}

#[test]
fn the_smallest_sufficient_sampler_is_named_and_written() {
    let here = folder();
    let path = here.path();
    let view = "--env overcast --scene sphere --material lambert --width 16 --height 12";
    let said = succeed(path, &format!("autosize {view} --prepare-seconds 1 --render-seconds 2 --out auto"));
    assert!(said.contains("the best: ") && said.contains("autosize.html"), "{said}");
    for role in ["winner", "cheapest"] {
        let spec = fs::read_to_string(path.join("auto").join(role)).unwrap();
        succeed(
            path,
            &format!("render --scene sphere --env overcast {SMALL} --sampler {} --spp 1 --out {role}.exr", spec.trim()),
        );
    }
    let page = fs::read_to_string(path.join("auto/autosize.html")).unwrap();
    assert!(page.contains("Error against time") && page.contains("best: ") && page.ends_with("</html>\n"));
}

#[test]
fn a_glossy_head_is_inspected_and_rendered_but_not_baked() {
    let here = folder();
    let path = here.path();
    let fit = "fit --env window --steps 20 --set conditions=8 --set head.bins=4 --set validation_conditions=6";
    for (material, name) in [("ggx:alpha=0.4", "one"), ("ggx:alpha=0.2..0.8", "range")] {
        succeed(path, &format!("{fit} --material {material} --out {name}"));
        let file = format!("{name}/sampler.safetensors");
        let said = succeed(path, &format!("inspect {file} --material ggx:alpha=0.3 --view 1,1,0 --out {name}.svg"));
        assert!(said.contains("alpha 0.3") && said.contains("% of samples from the head"), "{said}");
        assert!(is_svg(&path.join(name).with_extension("svg")));
        assert!(fail(path, &format!("inspect {file} --out a.svg")).contains("--material ggx:alpha=A"));
        assert!(fail(path, &format!("bake --from {file} --out a")).contains("only a head for diffuse surfaces"));
    }
    assert!(
        fail(path, "inspect one/sampler.safetensors --material ggx:alpha=0.2..0.8 --out a.svg").contains("one width")
    );
    let below = "inspect one/sampler.safetensors --material ggx:alpha=0.4 --view 0,-1,0 --out a.svg";
    assert!(fail(path, below).starts_with("--view"));

    let view = format!("render --scene sphere --material ggx:alpha=0.4 --env window --spp 64 {SMALL}");
    let render = |sampler: &str| {
        succeed(path, &format!("{view} --sampler {sampler} --out a.exr"));
        mean(&picture(&path.join("a.exr")))
    };
    let expected = render("mis");
    for sampler in ["head+mis:one/sampler.safetensors", "ris:4:head:range/sampler.safetensors"] {
        let found = render(sampler);
        // 432 pixels at 64 samples of relative deviation below 1.5: the mean is known to 1 %.
        assert!((found / expected - 1.0).abs() < 0.03, "{sampler}: {found}, mis: {expected}");
    }
}

#[test]
fn flow_tails_and_compact_emitters_are_fitted_exported_and_shown() {
    let here = folder();
    let path = here.path();
    let fit =
        "fit --env sunset --material lambert --set steps=20 --set flow.steps=20 --set flow.cells=16 --checkpoint-dir";
    let said = succeed(path, &format!("{fit} ck --tail flow --out flow"));
    assert!(said.contains("flow tail: KL") && names(&path.join("ck")).contains(&"tail".to_owned()), "{said}");
    // A second run finds all steps done, of the tail and of the head.
    succeed(path, &format!("{fit} ck --resume --tail flow --out again"));
    succeed(path, &format!("{fit} ck2 --compact-emitters --set head.selection=true --out compact"));
    let said = succeed(path, "inspect --tail --env sunset flow/sampler.safetensors --out tails.svg");
    assert!(
        is_svg(&path.join("tails.svg")) && ["row-column", "hierarchical", "flow"].iter().all(|t| said.contains(t)),
        "{said}"
    );
    let view = format!("render --scene plane --env sunset --unshadowed {SMALL}");
    succeed(path, &format!("{view} --spp 64 --sampler mis --out mis.exr"));
    let expected = mean(&picture(&path.join("mis.exr")));
    // 432 pixels. A sample of the compact emitters' mixtures has a relative deviation below 2. A flow of 20 steps hardly knows the sun: its
    // samples weigh up to 900 (relative deviation 16, standard error of the mean 1.2 % at 4096 samples per pixel, of which five are allowed).
    for (sampler, file, spp, tolerance) in [
        ("head+mis", "flow", 4096, 0.06),
        ("head+mis", "compact", 64, 0.04),
        ("head", "compact", 64, 0.04),
        ("ris:4:head", "compact", 64, 0.04),
    ] {
        succeed(path, &format!("{view} --spp {spp} --sampler {sampler}:{file}/sampler.safetensors --out other.exr"));
        let found = mean(&picture(&path.join("other.exr")));
        assert!((found / expected - 1.0).abs() < tolerance, "{sampler}:{file}: {found}, mis: {expected}");
    }
    assert!(fail(path, "bake --direct --env sunset --tail flow --out a.safetensors").contains("fit --tail flow"));
    assert!(
        fail(path, "inspect --tail --env studio flow/sampler.safetensors --out a.svg").contains("environment_hash")
    );
    assert!(fail(path, "fit --env sunset --material lambert --set flow.cells=7 --out a").contains("flow.cells"));
}

#[test]
fn the_stability_suite_writes_a_table_and_a_page() {
    let here = folder();
    let path = here.path();
    let said = succeed(path, "stability --quick --only constant --only noon --out suite");
    assert!(said.contains("noon_grass: not run; give --maps DIR"), "{said}");
    assert_eq!(names(&path.join("suite")), ["regimes", "regimes.svg", "stability.csv", "stability.html"]);
    let table = fs::read_to_string(path.join("suite/stability.csv")).unwrap();
    for method in ["mis", "head", "head and brdf by halves", "selection", "all remedies"] {
        assert!(table.contains(&format!("constant map,{method},finished")), "{method}: {table}");
    }
    assert!(fs::read_to_string(path.join("suite/stability.html")).unwrap().contains("constant map"));
    assert!(fail(path, "stability --only nothing --out suite").contains("--only"));
    assert!(fail(path, "stability --maps nowhere --out suite").contains("nowhere"));
}

#[test]
fn a_direct_bake_needs_no_training() {
    let here = folder();
    let path = here.path();
    succeed(
        path,
        "bake --direct --env sunset --tail row-column --normals 6x8 --cells 8x8 --out tables/sunset.safetensors",
    );
    assert_eq!(names(&path.join("tables")), ["sunset.safetensors"]);
    let said = succeed(path, "inspect tables/sunset.safetensors --out sunset.svg");
    assert!(said.contains("Direct bake of 'sunset'") && said.contains("row-column"), "{said}");
    let view = format!("render --scene plane --env sunset --spp 4 {SMALL}");
    succeed(path, &format!("{view} --sampler direct:tables/sunset.safetensors --out plane.exr"));
    assert!(is_png(&path.join("plane.png")));
}

#[test]
fn every_sampler_without_a_file_gives_the_same_mean() {
    let here = folder();
    let path = here.path();
    let view = format!("render --scene sphere --env overcast --unshadowed {SMALL}");
    succeed(path, &format!("{view} --sampler mis --spp 256 --out reference.exr"));
    let expected = mean(&picture(&path.join("reference.exr")));
    for (sampler, spp) in [
        ("cosine", 64),
        ("emitter", 64),
        ("mis2", 64),
        ("mis-comp", 64),
        ("ris:4", 64),
        ("patches", 64),
        ("patches:fine", 64),
        ("oracle", 2),
    ] {
        let said = succeed(path, &format!("{view} --sampler {sampler} --spp {spp} --out picture.exr"));
        assert!(said.starts_with(&format!("{sampler}: {spp} spp")), "{said}");
        let found = mean(&picture(&path.join("picture.exr")));
        assert!((found / expected - 1.0).abs() < 0.03, "{sampler}: {found}, mis: {expected}");
    }
}

#[test]
fn both_budgets_render_a_picture_of_the_size_asked_for() {
    let here = folder();
    let path = here.path();
    for (budget, name) in [("--spp 3", "samples"), ("--seconds 0.2", "time")] {
        let view = "render --scene temple --env window --sampler mis --width 31 --height 17";
        let said = succeed(path, &format!("{view} {budget} --out out/{name}.exr"));
        assert!(said.contains(" spp of sobol points in ") && said.contains(&format!("{name}.png written")), "{said}");
        let image = picture(&path.join("out").join(name).with_extension("exr"));
        assert_eq!((image.width, image.height), (31, 17));
        assert!(image.pixels.iter().flatten().all(|value| value.is_finite() && *value >= 0.0));
    }
    assert_eq!(names(&path.join("out")), ["samples.exr", "samples.png", "time.exr", "time.png"]);
}

#[test]
fn shadows_ground_and_camera_change_the_picture() {
    let here = folder();
    let path = here.path();
    let render = |options: &str| {
        succeed(
            path,
            &format!("render --scene temple --env overcast --sampler cosine --spp 16 {SMALL} {options} --out a.exr"),
        );
        picture(&path.join("a.exr"))
    };
    let shadowed = render("");
    let unshadowed = render("--unshadowed");
    // Without shadow rays a pixel gains light or stays as it is: the samples are the same.
    assert!(mean(&unshadowed) > 1.1 * mean(&shadowed));
    let brighter = |(a, b): (&[f32; 3], &[f32; 3])| a.iter().zip(b).all(|(a, b)| a >= b);
    assert!(unshadowed.pixels.iter().zip(&shadowed.pixels).all(brighter));
    for options in ["--ground --look-from 40,9,40 --look-at 0,0,0", "--look-from 40,9,40 --look-at 0,0,0", "--fov 20"] {
        assert_ne!(render(options), shadowed, "{options}");
    }
}

#[test]
fn light_over_several_surfaces_adds_to_direct_light() {
    let here = folder();
    let path = here.path();
    let view = format!("render --scene dishes --env overcast --sampler mis --spp 16 {SMALL}");
    let said = succeed(path, &format!("{view} --timings --out direct.exr"));
    for stage in ["camera rays", "sampling", "pdf evaluation", "shadow rays", "shading", "everything else"] {
        assert!(said.contains(&format!("\n{stage} ")), "{said}");
    }
    assert!(said.contains("\nthread-seconds by stage"), "{said}");
    // BRDF sampling asks no second sampler for a pdf.
    let one = succeed(path, &format!("{view} --timings --out direct.exr").replace("mis", "brdf"));
    assert!(one.contains("\npdf evaluation       0.000 s   0.0 %"), "{one}");
    succeed(path, &format!("{view} --out direct.exr"));
    assert!(!succeed(path, &format!("{view} --depth 1 --out same.exr")).contains("camera rays"));
    assert_eq!(fs::read(path.join("direct.png")).unwrap(), fs::read(path.join("same.png")).unwrap());
    succeed(path, &format!("{view} --depth 5 --out paths.exr"));
    let [direct, paths] = ["direct.exr", "paths.exr"].map(|file| mean(&picture(&path.join(file))));
    assert!(paths > 1.02 * direct, "{direct} {paths}");
    assert!(refuse(path, &format!("{view} --depth 0 --out a.exr")).contains("--depth"));
    assert!(refuse(path, &format!("{view} --depth 2 --unshadowed --out a.exr")).contains("--unshadowed"));
}

#[test]
fn built_in_scenes_are_listed_and_pictured() {
    let here = folder();
    let path = here.path();
    let said = succeed(path, "scenes --out pictures --spp 1 --width 16 --env overcast");
    for name in ["temple", "dishes", "diorama", "droid", "bedroom", "cloth", "sphere", "plane"] {
        assert!(said.contains(&format!("\n{name} ")), "{said}");
        assert!(is_png(&path.join("pictures").join(name).with_extension("png")));
    }
    assert!(fail(path, "scenes --out pictures --env nowhere").contains("nowhere"));
    assert!(fail(path, "chart nowhere --out chart.html").starts_with("nowhere"));
}

#[test]
fn one_material_can_be_given_to_every_surface() {
    let here = folder();
    let path = here.path();
    let view = format!("render --scene dishes --env overcast --ground --unshadowed {SMALL}");
    let render = |options: &str| {
        succeed(path, &format!("{view} --spp 32 {options} --out a.exr"));
        mean(&picture(&path.join("a.exr")))
    };
    let rough = render("--sampler mis --material ggx:alpha=0.2..0.8");
    assert!((render("--sampler brdf --material ggx:alpha=0.2..0.8") / rough - 1.0).abs() < 0.03);
    // White surfaces are brighter than the scene's own, and rough mirrors lose what they would reflect twice.
    assert!(render("--sampler mis --material lambert") > 1.1 * render("--sampler mis"));
    assert!(render("--sampler mis --material ggx:alpha=0.5") > 1.05 * render("--sampler mis --material ggx:alpha=1"));
}

#[test]
fn gltf_files_are_scenes() {
    let here = folder();
    // Three corners of three floats: (-1, -1, 0), (1, -1, 0), (0, 1, 0).
    let corners: Vec<u8> =
        [-1.0_f32, -1.0, 0.0, 1.0, -1.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|value| value.to_le_bytes()).collect();
    fs::write(here.path().join("corners.bin"), corners).unwrap();
    let scene = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [-1, -1, 0], "max": [1, 1, 0]}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}], "buffers": [{"uri": "corners.bin", "byteLength": 36}]}"#;
    fs::write(here.path().join("triangle.gltf"), scene).unwrap();
    let view = format!("render --env overcast --sampler mis --spp 1 {SMALL} --out a.exr --scene");
    succeed(here.path(), &format!("{view} triangle.gltf"));
    fs::write(here.path().join("broken.gltf"), &scene[..200]).unwrap();
    assert!(fail(here.path(), &format!("{view} broken.gltf")).starts_with("broken.gltf: "));
    assert!(
        fail(here.path(), &format!("{view} nowhere"))
            .contains("temple, dishes, diorama, droid, bedroom, cloth, sphere, plane")
    );
}

#[test]
fn compare_writes_the_table_the_page_and_the_images() {
    let here = folder();
    let path = here.path();
    succeed(path, "bake --direct --env studio --normals 6x8 --cells 8x8 --out direct.safetensors");
    let samplers = ["mis", "ris:2", "direct:direct.safetensors"];
    let view = format!("compare --scene sphere --env studio {SMALL} --reference-spp 32");
    let said = succeed(
        path,
        &format!("{view} --samplers {} --spp 2,4 --seconds 0.05 --runs 2 --seed 5 --out results", samplers.join(",")),
    );
    assert!(said.trim_end().ends_with("report.html"), "{said}");

    let mut reader = csv::Reader::from_path(path.join("results/results.csv")).unwrap();
    let columns = "scene,env,sampler,budget,run,spp,rays_per_sample,seconds,mse,relmse,relmse_trimmed,ttuv,mean_luminance,max_weight,seed,version,points";
    assert_eq!(reader.headers().unwrap().iter().collect::<Vec<_>>().join(","), columns);
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 3 * 3 * (2 + 1));
    for sampler in samplers {
        for budget in ["2spp", "4spp", "0.05s"] {
            let group: Vec<_> = rows.iter().filter(|row| &row[2] == sampler && &row[3] == budget).collect();
            assert_eq!(group.iter().map(|row| &row[4]).collect::<Vec<_>>(), ["0", "1", "mean"], "{sampler} {budget}");
            assert_eq!((&group[0][14], &group[1][14]), ("5", "6"));
            assert!(
                group
                    .iter()
                    .all(|row| &row[0] == "sphere" && &row[1] == "studio" && &row[15] == env!("CARGO_PKG_VERSION"))
            );
            for column in 5..14 {
                let value = |row: usize| group[row][column].parse::<f64>().unwrap();
                assert!(value(0) > 0.0 && value(0).is_finite());
                // The mean row holds the largest of the largest weights, and means of all else.
                let expected = if column == 13 { value(0).max(value(1)) } else { 0.5 * (value(0) + value(1)) };
                assert!((value(2) / expected - 1.0).abs() < 1e-9, "{sampler} {budget} column {column}: {group:?}");
            }
        }
    }

    let page = fs::read_to_string(path.join("results/report.html")).unwrap();
    assert!(page.contains("data:image/png;base64,") && page.contains("<svg"));
    assert!(!page.contains("src=\"http") && !page.contains("href=\"http"), "the page needs nothing but itself");
    let images = names(&path.join("results"));
    assert_eq!(images.iter().filter(|name| name.ends_with(".exr")).count(), 1 + 2 * 3 * 3, "{images:?}");
    let errors = picture(&path.join("results/mis_2spp_error.exr"));
    assert!(mean(&errors) > 0.0 && errors.pixels.len() == 24 * 18);

    // A reference that was rendered before is taken, and one of another size is refused.
    let again = format!("{view} --samplers mis --spp 2 --runs 1 --reference results/reference.exr --out again");
    succeed(path, &again);

    // One that is in the cache is not rendered again: the same rows come of it, but for the seconds.
    let cached = format!("{view} --samplers mis --spp 2 --runs 1 --reference-cache cache --out");
    succeed(path, &format!("{cached} first"));
    succeed(path, &format!("{cached} second"));
    assert_eq!(names(&path.join("cache")).len(), 2);
    let mse = |folder: &str| fs::read_to_string(path.join(folder).join("results.csv")).unwrap();
    let mse = |folder: &str| mse(folder).lines().nth(1).unwrap().split(',').nth(8).unwrap().to_owned();
    assert_eq!(mse("first"), mse("second"));
    assert!(fs::read_to_string(path.join("second/report.html")).unwrap().contains("found in the cache"));
    succeed(path, &format!("{cached} third --seed 9"));
    assert_eq!(names(&path.join("cache")).len(), 4);

    let other_size = again.replace("--width 24", "--width 25");
    assert!(fail(path, &other_size).contains("24 x 18"));
}

#[test]
fn the_same_seed_gives_the_same_sampler_file() {
    let here = folder();
    let fit = "fit --env window --material lambert --steps 12 --reproducible";
    for (seed, out) in [(1, "a"), (1, "b"), (2, "c")] {
        succeed(here.path(), &format!("{fit} --seed {seed} --out {out}"));
        succeed(
            here.path(),
            &format!("bake --from {out}/sampler.safetensors --normals 4x6 --cells 4x4 --out {out}/baked"),
        );
    }
    let bytes = |file: &str| fs::read(here.path().join(file)).unwrap();
    assert!(bytes("a/sampler.safetensors") == bytes("b/sampler.safetensors"));
    assert!(bytes("a/sampler.safetensors") != bytes("c/sampler.safetensors"));
    assert!(bytes("a/baked") == bytes("b/baked"));
}

#[test]
fn the_same_seed_gives_the_same_picture_on_any_number_of_threads() {
    let here = folder();
    let view = "render --scene dishes --env studio --sampler ris:4 --spp 20 --width 40 --height 30";
    for (threads, seed, out) in [(1, 9, "a"), (3, 9, "b"), (3, 10, "c")] {
        succeed(here.path(), &format!("{view} --threads {threads} --seed {seed} --out {out}.exr"));
    }
    // The EXR files hold the time that was taken; their pixels and the PNG files have no such excuse.
    let [a, b, c] = ["a", "b", "c"].map(|name| picture(&here.path().join(name).with_extension("exr")));
    assert_eq!(a, b);
    assert_ne!(a, c);
    let png = |name: &str| fs::read(here.path().join(name)).unwrap();
    assert!(png("a.png") == png("b.png"));
}

#[test]
fn an_instruction_set_that_is_not_there_is_refused_with_a_sentence() {
    let here = folder();
    let output = command(here.path(), "scenes").env("HEADTAIL_SIMD", "abacus").output().unwrap();
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.starts_with("error: HEADTAIL_SIMD: \"abacus\"") && message.lines().count() == 1, "{message}");
}

#[test]
fn maps_are_repaired_or_refused_with_a_sentence() {
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

    // Mantissa 128, exponent 129: radiance 1 everywhere, from a single texel. A white sphere in it cannot be seen.
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

/// `bytes` with the only occurrence of `from` replaced by `to`, which is as long.
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

/// As [`refuse`]; without any argument the whole help is shown instead.
fn refuse_or_help(folder: &Path, arguments: &str) -> String {
    if arguments.is_empty() { text(&headtail(folder, arguments).stderr) } else { refuse(folder, arguments) }
}

#[test]
fn a_file_that_cannot_be_written_is_an_error() {
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
    // What is already there stays when the new file cannot take its place: a folder bears the name.
    fs::create_dir(here.path().join("taken.exr")).unwrap();
    assert!(fail(here.path(), &format!("{render} --out taken.exr")).starts_with("taken.exr"));
    assert_eq!(names(here.path()), ["file", "taken.exr"]);
    assert_eq!(fs::read_to_string(here.path().join("file")).unwrap(), "in the way");
}

#[test]
fn points_are_chosen_and_recorded() {
    let here = folder();
    let path = here.path();
    let render = |points: &str, options: &str| {
        let said = succeed(
            path,
            &format!("render --scene plane --env studio --sampler mis {SMALL} {options} --out {points}.exr"),
        );
        (picture(&path.join(format!("{points}.exr"))).pixels, said)
    };
    let default = render("default", "--spp 4").0;
    let named = ["sobol", "zsobol", "independent"].map(|points| render(points, &format!("--spp 4 --points {points}")));
    let spoken = ["sobol", "zsobol:4", "independent"];
    for ((_, said), points) in named.iter().zip(spoken) {
        assert!(said.contains(&format!(" 4 spp of {points} points in ")), "{said}");
    }
    assert_eq!(default, named[0].0);
    assert!(named[0].0 != named[1].0 && named[1].0 != named[2].0 && named[2].0 != named[0].0);
    // The plan is all that a budget decides: three of four samples are planned as four.
    let planned = render("planned", "--spp 3 --points zsobol:4").0;
    assert_eq!(planned, render("resolved", "--spp 3 --points zsobol").0);
    assert!(render("timed", "--seconds 0.01 --points zsobol").1.contains(" spp of zsobol:16 points in "));

    let compare =
        format!("compare --scene plane --env studio --samplers mis,emitter --runs 1 --reference-spp 8 {SMALL}");
    succeed(path, &format!("{compare} --spp 1,6 --seconds 0.01 --points zsobol --out results"));
    let mut reader = csv::Reader::from_path(path.join("results/results.csv")).unwrap();
    let points: Vec<(String, String)> =
        reader.records().map(Result::unwrap).map(|row| (row[3].to_owned(), row[16].to_owned())).collect();
    assert_eq!(points.len(), 3 * 2 * 2);
    for (budget, points) in points {
        assert_eq!(
            points,
            ["zsobol:1", "zsobol:8", "zsobol:16"][["1spp", "6spp", "0.01s"].iter().position(|b| *b == budget).unwrap()]
        );
    }
    let page = fs::read_to_string(path.join("results/report.html")).unwrap();
    assert!(page.contains("zsobol:1, zsobol:8, zsobol:16"));
    for wrong in ["halton", "zsobol:3", "zsobol:0", "zsobol:4294967296", "Sobol"] {
        let message = refuse(
            path,
            &format!("render --scene plane --env studio --sampler mis --spp 1 --points {wrong} --out x.exr"),
        );
        assert!(message.contains("--points") && message.contains("sobol, zsobol"), "{message}");
    }
}
