//! No command replaces one of its inputs, whatever path leads to the file, with `--force` or without.

use std::{collections::BTreeSet, fs, path::Path};

use headtail_render::image::{Image, write_exr};

use super::{
    PORTALS, SMALL, command, documentation::commands_of_the_help, folder, headtail, lost_work::refused, succeed, text,
};

/// A command with `IN` for an input, a file that can be the input, and the output that must not replace it.
type Case<'a> = (String, &'a str, &'a str);

fn cases<'a>() -> Vec<Case<'a>> {
    let render = format!("render --scene sphere --spp 1 {SMALL} --sampler");
    let compare = format!("compare --scene sphere {SMALL} --samplers mis --runs 1 --spp 1");
    let composite = "composite --scene sphere --spp 1 --out both";
    let rival = "fit-rival --kind lobes --steps 1 --material";
    let (fit, auto) = ("fit --material lambert --steps 2", "autosize --env overcast --scene sphere --out auto");
    vec![
        ("view --env IN --width 16 --height 16 --out view.exr".into(), "map.exr", "view.exr"),
        ("view --env IN --env-layout equal-area --width 16 --height 16 --out view.exr".into(), "map.exr", "view.png"),
        ("view --env IN#layout=latlong --width 16 --height 16 --out view.exr".into(), "map.exr", "view.fspy"),
        (format!("{render} mis --env IN --out a.exr"), "map.exr", "a.exr"),
        (format!("{render} mis --env IN --out a.exr"), "map.exr", "a.png"),
        (format!("{render} mis --env IN --aovs --out a.exr"), "map.exr", "a.aovs.exr"),
        (format!("{render} mis --env overcast --material neural:IN --out a.exr"), "fabric", "a.png"),
        (format!("{render} ris:2:direct:IN --env overcast --out a.exr"), "table", "a.png"),
        (format!("{render} patches+vis:IN --env overcast --out a.exr"), "seen", "a.png"),
        (format!("{render} mis --env overcast --out a.exr").replace("sphere", "IN"), "scene.gltf", "a.png"),
        (format!("live --scene IN --env overcast {SMALL} --samplers mis --out a.html"), "scene.gltf", "a.html"),
        (format!("{compare} --env IN --out c"), "map.exr", "c/reference.exr"),
        (format!("{compare} --env IN --out c"), "map.exr", "c/mis_1spp_error.exr"),
        (
            format!("{compare} --samplers direct:IN --env overcast --reference-spp 1 --out c")
                .replace("--samplers mis ", ""),
            "table",
            "c/report.html",
        ),
        (format!("{compare} --env overcast --reference IN --out c"), "picture.exr", "c/mis_1spp.exr"),
        (format!("{composite} --env IN --photo map.exr --camera camera.fspy"), "map.exr", "both/layers.exr"),
        (format!("{composite} --env overcast --photo IN --camera camera.fspy"), "map.exr", "both/composite.exr"),
        (format!("{composite} --env overcast --photo map.exr --camera IN"), "camera.fspy", "both/mask.png"),
        (format!("{fit} --env IN --out fit"), "map.exr", "fit/resolved.toml"),
        (format!("{fit} --env overcast --config IN --out fit"), "run.toml", "fit/metrics.jsonl"),
        (format!("{fit} --env overcast --conditions-from IN --out fit"), "scene.gltf", "fit/measures.json"),
        (
            "fit --env overcast --steps 2 --material nbrdf:IN#a --out fit".into(),
            "raw.safetensors",
            "fit/sampler.safetensors",
        ),
        ("bake --direct --env IN --out baked".into(), "map.exr", "baked"),
        ("bake --from IN --out baked".into(), "head", "baked"),
        ("bake --visibility --scene sphere --env overcast --spp 1 --resume IN --out baked".into(), "seen", "baked"),
        (format!("{rival} neural:IN --out rival"), "fabric", "rival"),
        (
            "check-material --source lacquer --paths 1 --questions 16 --material IN --out check.png".into(),
            "fabric",
            "check.png",
        ),
        ("material IN --out out.safetensors".into(), "raw.safetensors", "out.safetensors"),
        ("chart results --out chart.html".into(), "results/results.csv", "chart.html"),
        ("inspect IN --out a.svg".into(), "table", "a.svg"),
        ("inspect --portals --scene IN --out a.json".into(), "scene.gltf", "a.json"),
        ("inspect --lights --env IN --out a.json".into(), "map.exr", "a.json"),
        ("inspect --lights --env IN --out a.json --rest b.exr".into(), "map.exr", "b.exr"),
        ("inspect --tail --env IN --out a.svg".into(), "map.exr", "a.svg"),
        ("export IN --target wgsl --out shader".into(), "table", "shader/floats.bin"),
        ("export patches --env IN --target wgsl --out shader".into(), "map.exr", "shader/layout.json"),
        ("export portals:IN --env overcast --target wgsl --out shader".into(), "portals.json", "shader/floats.bin"),
        (auto.replace("overcast", "IN"), "map.exr", "auto/winner"),
        (auto.replace("sphere", "IN"), "scene.gltf", "auto/autosize.html"),
        ("sweep collect IN --out space.sweep --file trials.csv".into(), "space.toml", "trials.csv"),
        ("sweep report IN --out space.sweep --file report.html".into(), "space.toml", "report.html"),
        ("sweep submit IN --out space.sweep --dry-run".into(), "space.toml", "space.sweep/slurm.sh"),
        ("scenes --env IN --spp 1 --width 16 --out scenes".into(), "map.exr", "scenes/temple.png"),
        ("demo --env IN --out demo".into(), "map.exr", "demo/results.csv"),
        // The same file by `--log`.
        (format!("{render} mis --env IN --out b.exr --log log"), "map.exr", "log"),
        (format!("{render} mis --env overcast --out b.exr --log log").replace("sphere", "IN"), "scene.gltf", "log"),
    ]
}

/// Commands with `--out` whose inputs are built in, or files of a given name in a folder.
const WITHOUT_INPUTS: [&str; 3] = ["conformance", "fit-material", "stability"];

fn write_inputs(path: &Path) {
    let pixels = (0..32 * 16).map(|k| [1.0 + k as f32 * 0.01; 3]).collect();
    write_exr(&path.join("map.exr"), &Image { width: 32, height: 16, pixels }, &[]).unwrap();
    let pixels = vec![[0.5; 3]; 24 * 18];
    write_exr(&path.join("picture.exr"), &Image { width: 24, height: 18, pixels }, &[]).unwrap();
    let weights = |k: usize| ((k * 37) % 19) as f32 * 0.01 - 0.09;
    fs::write(path.join("raw.f32"), (0..675).flat_map(|k| weights(k).to_le_bytes()).collect::<Vec<u8>>()).unwrap();
    fs::write(path.join("raw.names.txt"), "a\n").unwrap();
    fs::write(path.join("run.toml"), "steps = 2\n").unwrap();
    fs::write(path.join("portals.json"), PORTALS).unwrap();
    let space = "objectives = ['kl']\n[run]\nenv = 'overcast'\nmaterial = 'lambert'\n[axes.seed]\nvalues = [1]\n";
    fs::write(path.join("space.toml"), space).unwrap();
    let gltf = serde_json::json!({
        "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
        "buffers": [{ "byteLength": 36, "uri": "triangle.bin" }], "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0] }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
    });
    fs::write(path.join("scene.gltf"), gltf.to_string()).unwrap();
    let corners = [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    fs::write(path.join("triangle.bin"), corners.map(f32::to_le_bytes).concat()).unwrap();
    for made in [
        "view --env overcast --width 16 --height 16 --out camera.exr",
        "bake --direct --env overcast --normals 4x6 --cells 4x4 --out table",
        "bake --visibility --scene sphere --env overcast --width 24 --height 18 --spp 1 --out seen",
        "fit --env overcast --material lambert --steps 2 --set conditions=4 --out made",
        "fit-material --source lacquer --side 8 --steps 1 --batch 256 --out fabric",
        "material raw.f32 --out raw.safetensors",
        "compare --scene sphere --env overcast --width 24 --height 18 --samplers mis --runs 1 --spp 1 --reference-spp 1 --out results",
    ] {
        succeed(path, made);
    }
    fs::copy(path.join("made/sampler.safetensors"), path.join("head")).unwrap();
}

#[test]
#[cfg(unix)]
fn outputs_that_are_inputs_are_rejected_by_every_command() {
    let here = folder();
    let path = here.path();
    write_inputs(path);
    for (arguments, input, output) in cases() {
        let (source, target) = (path.join(input), path.join(output));
        let before = fs::read(&source).unwrap();
        fs::create_dir_all(target.parent().unwrap()).unwrap();
        let links: [(&str, &dyn Fn()); 2] = [
            ("hard link", &|| fs::hard_link(&source, &target).unwrap()),
            ("symbolic link", &|| std::os::unix::fs::symlink(&source, &target).unwrap()),
        ];
        for (kind, link) in links {
            link();
            for is_forced in [false, true] {
                let mut process = command(path, &arguments.replace("IN", input));
                let result = if is_forced { process.arg("--force") } else { &mut process }.output().unwrap();
                let said = text(&result.stderr);
                assert_eq!(result.status.code(), Some(1), "{arguments}, {kind}: {said}");
                let is_named = said.contains("also an") || said.contains("not a log of headtail");
                // Files in a folder are not known before it is read.
                let is_hidden = !is_forced && !arguments.contains("IN");
                assert!(
                    is_hidden || is_named && !said.contains("--force"),
                    "{arguments}, {kind}, forced: {is_forced}: {said}"
                );
                let is_kept = fs::read(&source).unwrap() == before && headtail_render::file::is_same(&source, &target);
                assert!(is_kept, "{arguments}, {kind}, forced: {is_forced}");
            }
            fs::remove_file(&target).unwrap();
        }
    }
    let writes = |name: &String| text(&headtail(path, &format!("{name} --help")).stdout).contains("--out");
    let mut expected: BTreeSet<String> =
        commands_of_the_help().into_iter().map(|(name, _)| name).filter(writes).collect();
    expected.insert("sweep".into());
    let words = cases().into_iter().map(|(arguments, ..)| arguments.split(' ').next().unwrap().to_owned());
    let listed: BTreeSet<String> = words.chain(WITHOUT_INPUTS.map(str::to_owned)).collect();
    assert_eq!(listed, expected);
}

#[test]
fn files_that_inputs_refer_to_are_inputs() {
    let here = folder();
    let path = here.path();
    write_inputs(path);
    fs::create_dir(path.join("folder")).unwrap();
    let scene = fs::read_to_string(path.join("scene.gltf")).unwrap();
    let render = format!("render --env overcast --sampler mis --spp 1 {SMALL}");
    let space = "objectives = ['kl']\n[run]\nenv = 'trials.csv'\nmaterial = 'lambert'\n[axes.seed]\nvalues = [1]\n";
    for (arguments, file) in [
        // Another spelling.
        (format!("{render} --scene sphere --out folder/../map.exr").replace("overcast", "./map.exr"), "map.exr"),
        // A buffer.
        (format!("{render} --scene scene.gltf --out a.exr"), "a.png"),
        // The map of a settings file and of a space.
        ("fit --config run.toml --out fit".into(), "fit/metrics.jsonl"),
        ("sweep collect space.toml --file trials.csv".into(), "trials.csv"),
    ] {
        let file = path.join(file);
        let before = if file.ends_with("a.png") {
            fs::write(path.join("scene.gltf"), scene.replace("triangle.bin", "a.png")).unwrap();
            fs::read(path.join("triangle.bin")).unwrap()
        } else {
            fs::read(path.join("map.exr")).unwrap()
        };
        fs::create_dir_all(path.join("fit")).unwrap();
        fs::write(path.join("run.toml"), "env = 'fit/metrics.jsonl'\nmaterial = 'lambert'\nsteps = 2\n").unwrap();
        fs::write(path.join("space.toml"), space).unwrap();
        fs::write(&file, &before).unwrap();
        let said = text(&headtail(path, &arguments).stderr);
        assert!(said.contains("also an"), "{arguments}: {said}");
        assert_eq!(fs::read(&file).unwrap(), before, "{arguments}");
    }
}

/// A command that replaces the results of another keeps those that it reads.
#[test]
fn results_of_replaced_commands_that_are_inputs_are_kept() {
    let here = folder();
    let path = here.path();
    let compare = format!("compare --scene sphere {SMALL} --runs 1 --spp 1 --reference-spp 1 --out c --samplers");
    succeed(path, &format!("{compare} mis --env overcast"));
    let map = fs::read(path.join("c/mis_1spp.exr")).unwrap();
    assert!(refused(path, &format!("{compare} brdf --env c/mis_1spp.exr")).contains("--force"));
    succeed(path, &format!("{compare} brdf --env c/mis_1spp.exr"));
    assert_eq!(fs::read(path.join("c/mis_1spp.exr")).unwrap(), map);
    assert!(path.join("c/brdf_1spp.exr").exists() && !path.join("c/mis_1spp_error.exr").exists());
}
