//! Common options of renderers: crops, rotated and tinted maps, AOVs, JSON output, file information.

use std::fs;

use headtail_render::{
    environment::Environment,
    image::{Image, read_picture, text_attributes, write_exr},
    statistics::ErrorMetrics,
};

use super::{SMALL, command, fail, folder, mean, names, picture, refuse, succeed, text};

const VIEW: &str = "render --scene dishes --env studio --sampler mis --spp 4 --width 40 --height 30";

#[test]
fn crops_equal_the_pixels_of_the_whole() {
    let here = folder();
    let path = here.path();
    // 7, 5 is inside a tile of 16 x 16 pixels, and the crop ends inside another.
    for points in ["lattice", "sobol", "independent"] {
        succeed(path, &format!("{VIEW} --points {points} --out whole.exr"));
        succeed(path, &format!("{VIEW} --points {points} --crop 7,5,21,18 --out part.exr"));
        let (whole, part) = (picture(&path.join("whole.exr")), picture(&path.join("part.exr")));
        assert_eq!((part.width, part.height), (21, 18));
        for (k, pixel) in part.pixels.iter().enumerate() {
            assert_eq!(*pixel, whole.pixels[(5 + k / 21) * 40 + 7 + k % 21], "{points}: pixel {k}");
        }
    }
    for wrong in ["20,0,21,30", "0,0,40,31"] {
        assert!(fail(path, &format!("{VIEW} --crop {wrong} --out x.exr")).contains("--crop"));
    }
    for wrong in ["0,0,0,1", "1,2,3", "1,2,3,x", "-1,0,2,2"] {
        assert!(refuse(path, &format!("{VIEW} --crop={wrong} --out x.exr")).contains("--crop"));
    }
}

#[test]
fn rotated_maps_equal_rolled_files() {
    let here = folder();
    let path = here.path();
    let map = Environment::open("studio").unwrap().to_image();
    // Rotation is counter-clockwise from above, from +X to -Z: texels move left by 25 % of the map.
    let rolled = |by: usize| {
        let from = |k: usize| map.pixels[k / map.width * map.width + (k % map.width + by) % map.width];
        Image { pixels: (0..map.pixels.len()).map(from).collect(), ..map }
    };
    write_exr(&path.join("map.exr"), &map, &[]).unwrap();
    write_exr(&path.join("right.exr"), &rolled(map.width / 4), &[]).unwrap();
    write_exr(&path.join("left.exr"), &rolled(map.width * 3 / 4), &[]).unwrap();
    succeed(path, "bake --direct --env map.exr --normals 8x12 --cells 16x16 --out table");
    let view = format!("render --scene sphere --spp 256 {SMALL}");
    succeed(path, &format!("{view} --env map.exr --env-rotate 90 --sampler direct:table --out turned.exr"));
    let turned = picture(&path.join("turned.exr"));
    let error = |map: &str| {
        succeed(path, &format!("{view} --env {map}.exr --sampler mis --out other.exr"));
        ErrorMetrics::of(&turned, &picture(&path.join("other.exr"))).unwrap().relmse
    };
    let (right, left) = (error("right"), error("left"));
    assert!(right < 2e-2 && right < 0.05 * left, "{right} {left}");
    // The camera in the picture's header is the requested one.
    let known = text_attributes(&path.join("turned.exr")).unwrap();
    let of = |name: &str| known.iter().find(|(found, _)| found == name).unwrap().1.clone();
    assert_eq!((of("environment.rotated").as_str(), of("sampler").as_str()), ("90", "direct:table"));
    assert!(of("headtail.command").contains("--env-rotate 90") && of("scene") == "sphere");
    let field = "--material ggx:alpha=0.2..0.8 --env-rotate 10";
    assert!(fail(path, &format!("{view} --env studio --sampler mis {field} --out x.exr")).contains("--env-rotate"));
}

#[test]
fn scaled_light_scales_the_picture() {
    let here = folder();
    let path = here.path();
    succeed(path, &format!("{VIEW} --out one.exr"));
    succeed(path, &format!("{VIEW} --env-scale 2,1,0.5 --out tinted.exr"));
    let (one, tinted) = (picture(&path.join("one.exr")), picture(&path.join("tinted.exr")));
    for (a, b) in one.pixels.iter().zip(&tinted.pixels) {
        assert_eq!([2.0 * a[0], a[1], 0.5 * a[2]], *b);
    }
    assert!(refuse(path, &format!("{VIEW} --env-scale 0 --out x.exr")).contains("positive factor"));
}

#[test]
fn compare_supports_crops_and_lights_like_render() {
    let here = folder();
    let path = here.path();
    let options = "--env-rotate 30 --env-scale 2,1,0.5 --crop 7,5,21,18";
    succeed(path, &format!("{VIEW} --seed 1 {options} --out one.exr"));
    let compare = VIEW.replace("render", "compare").replace("--sampler", "--samplers");
    let compare = format!("{compare} --runs 1 --reference-spp 64 --reference-cache cache");
    succeed(path, &format!("{compare} {options} --out parts"));
    let (one, run) = (picture(&path.join("one.exr")), picture(&path.join("parts/mis_4spp.exr")));
    assert!(one == run, "the same picture");
    let reference = picture(&path.join("parts/reference.exr"));
    assert_eq!((reference.width, reference.height), (21, 18));
    // Both have the same light: means over 378 pixels with few samples agree within 10 %, those of other
    // factors do not.
    assert!((mean(&run) / mean(&reference) - 1.0).abs() < 0.1, "{} {}", mean(&run), mean(&reference));
    let table = fs::read_to_string(path.join("parts/results.csv")).unwrap();
    assert!(table.contains("dishes, pixels 7,5,21,18") && table.contains("studio, turned by 30\u{b0}, times 2,1,0.5"));
    let facts = text_attributes(&path.join("parts/mis_4spp.exr")).unwrap();
    let of = |name: &str| facts.iter().find(|(found, _)| found == name).unwrap().1.clone();
    assert_eq!((of("environment.rotated"), of("crop")), ("30".into(), "7,5,21,18".into()));
    // Another light or crop has another reference.
    assert_eq!(names(&path.join("cache")).len(), 2);
    succeed(path, &format!("{compare} {options} --out again"));
    assert_eq!(names(&path.join("cache")).len(), 2);
    succeed(path, &format!("{compare} --env-rotate 30 --crop 7,5,21,18 --out other"));
    assert_eq!(names(&path.join("cache")).len(), 4);
    assert!(fail(path, &format!("{compare} --crop 20,0,21,30 --out x")).contains("--crop"));
}

#[test]
fn aovs_are_written_beside_the_picture() {
    let here = folder();
    let path = here.path();
    succeed(
        path,
        "render --scene plane --env overcast --sampler mis --spp 1 --width 8 --height 6 --material lambert:albedo=0.25 --aovs --out a.exr",
    );
    // Layers are not colour: only `beauty` channels or R, G, B are.
    let layers = fs::read(path.join("a.aovs.exr")).unwrap();
    for name in ["albedo.R", "normal.Y", "depth.Z"] {
        assert!(layers.windows(name.len()).any(|window| window == name.as_bytes()), "{name}");
    }
    let albedo = read_picture(&path.join("a.aovs.exr"), Some("albedo")).unwrap().image;
    let seen = albedo.pixels.iter().filter(|pixel| pixel[0] > 0.0).count();
    assert!(seen > 0 && albedo.pixels.iter().all(|pixel| pixel[0] <= 0.25 + 1e-5), "{:?}", albedo.pixels);
    assert!(albedo.pixels.iter().any(|pixel| (pixel[0] - 0.25).abs() < 1e-5));
}

#[test]
fn the_default_sampler_is_chosen_and_named() {
    let here = folder();
    let path = here.path();
    let view = "render --scene dishes --env studio --material lambert --spp 512 --width 64 --height 48";
    let said = succeed(path, &format!("{view} --out a.exr"));
    let chosen = said.split("auto: ").nth(1).and_then(|rest| rest.split(' ').next()).expect("the choice is said");
    assert!(said.contains("relative efficiency in a pilot"), "{said}");
    succeed(path, &format!("{view} --sampler {chosen} --threads 1 --out b.exr"));
    assert_eq!(picture(&path.join("a.exr")), picture(&path.join("b.exr")));
    let attributes = text_attributes(&path.join("a.exr")).unwrap();
    let of = |name: &str| attributes.iter().find(|(own, _)| own == name).map(|(_, value)| value.as_str());
    assert_eq!(of("sampler"), Some(chosen));
    assert!(of("auto").is_some_and(|text| text.contains("split:3:mis2-comp")));
}

#[test]
fn maps_are_read_in_the_named_layout_and_layer() {
    let here = folder();
    let path = here.path();
    // Six faces in a column; the one to +Y (up) is bright.
    let mut image = Image { width: 8, height: 48, pixels: vec![[0.1; 3]; 8 * 48] };
    image.pixels[2 * 64..3 * 64].fill([1.0; 3]);
    write_exr(&path.join("cube.exr"), &image, &[]).unwrap();
    let view = "render --scene plane --material lambert --sampler mis --spp 16 --width 16 --height 12 --out a.exr --env cube.exr";
    let light = |more: &str| {
        succeed(path, &format!("{view}{more}"));
        mean(&picture(&path.join("a.exr")))
    };
    let as_cube = light(" --env-layout cube");
    assert_eq!(as_cube, light("#layout=cube"));
    assert!(as_cube > 1.1 * light(""), "{as_cube}");
    assert!(refuse(path, &format!("{view} --env-layout sphere")).contains("equal-area"));
    assert!(fail(path, &format!("{view} --env-layout cross")).contains("are not 3 x 4 squares"));
    assert!(fail(path, &format!("{view} --env-layer beauty")).contains("no layer is called 'beauty'"));
}

#[test]
fn strict_mode_turns_file_warnings_into_errors() {
    let here = folder();
    let path = here.path();
    let image = Image { width: 4, height: 2, pixels: vec![[1.0, f32::NAN, 1.0]; 8] };
    write_exr(&path.join("nan.exr"), &image, &[]).unwrap();
    let view = "render --scene plane --env nan.exr --spp 1 --width 8 --height 6 --out a.exr";
    let output = command(path, view).output().unwrap();
    assert!(output.status.success() && text(&output.stderr).contains("warning: nan.exr: 8 channel values were NaN"));
    assert!(fail(path, &format!("{view} --strict")).contains("were NaN and were replaced by 0 (--strict)"));
    let said = succeed(path, "info nan.exr");
    assert!(said.contains("warnings") && said.contains("8 channel values were NaN"), "{said}");
}

#[test]
fn json_output_contains_only_data() {
    let here = folder();
    let path = here.path();
    let json = |arguments: &str| -> serde_json::Value {
        let said = succeed(path, arguments);
        serde_json::from_str(&said).unwrap_or_else(|error| panic!("{arguments}: {error}: {said}"))
    };
    let rendered = json(&format!("{VIEW} --json --out a.exr"));
    assert_eq!((rendered["spp"].as_u64(), rendered["sampler"].as_str()), (Some(4), Some("mis")));
    assert!(json("scenes --json").as_array().unwrap().iter().any(|scene| scene["scene"] == "temple"));
    let runs = json(&format!(
        "compare --scene sphere --env studio {SMALL} --samplers mis,brdf --runs 2 --spp 1 --reference-spp 4 --json --out c"
    ));
    assert_eq!(runs.as_array().unwrap().len(), 4);
    assert_eq!(runs[1]["sampler"], "brdf");
    let fitted = json("fit --env overcast --material lambert --steps 2 --set conditions=4 --json --out f");
    assert!(fitted["kl"].is_f64());
    assert!(json("inspect f/sampler.safetensors --json --out f.svg")["kl"].is_f64());
    assert_eq!(json("info f/sampler.safetensors --json")["tail"], "hierarchical");
    let tails = json("inspect --tail --env overcast --json --out tails.svg");
    assert!(tails[1]["tail"] == "hierarchical" && tails[1]["discontinuity_sides"].is_f64(), "{tails}");
    let cloth = json("fit-material --source lacquer --side 8 --steps 1 --batch 256 --json --out cloth.safetensors");
    assert!(cloth["source"] == "lacquer" && cloth["psnr"].is_f64() && cloth["path_error"].is_f64(), "{cloth}");
    let rivals =
        json("fit-rival --kind lobes --material neural:cloth.safetensors --steps 1 --json --out rival.safetensors");
    assert!(rivals[0]["relative_variance"].is_f64() && rivals[0]["cross_entropy"].is_f64(), "{rivals}");
}

#[test]
fn info_describes_files_and_the_machine() {
    let here = folder();
    let path = here.path();
    succeed(path, &format!("{VIEW} --out a.exr"));
    let said = succeed(path, "info a.exr");
    for fact in ["40 x 30", "headtail.command", "--scene dishes", "environment.hash", "camera.look_from"] {
        assert!(said.contains(fact), "{fact}: {said}");
    }
    succeed(path, "fit --env overcast --material lambert --steps 2 --set conditions=4 --checkpoint-dir ck --out f");
    assert!(succeed(path, "info f/sampler.safetensors").contains(" --sampler head+mis:f/sampler.safetensors\n"));
    assert!(succeed(path, "info ck/step-000000002").contains("a checkpoint of a training"));
    let machine: serde_json::Value = serde_json::from_str(&succeed(path, "info --json")).unwrap();
    assert_eq!(machine["version"], env!("CARGO_PKG_VERSION"));
    assert!(machine["threads"].as_u64().is_some_and(|threads| threads > 0) && machine["adapters"].is_array());
    assert!(fail(path, "info f").contains("it is a folder"));
    fs::write(path.join("x"), "text").unwrap();
    assert!(fail(path, "info x").starts_with("x: "));
}

#[test]
fn shell_completions_are_generated() {
    let here = folder();
    for shell in ["bash", "zsh", "fish"] {
        let script = succeed(here.path(), &format!("completions {shell}"));
        assert!(script.contains("headtail") && script.contains("env-rotate"), "{shell}");
    }
}

#[test]
fn errors_contain_no_type_names() {
    let here = folder();
    let path = here.path();
    assert!(refuse(path, &format!("{VIEW} --seed x --out a.exr")).contains("not a whole number"));
    let said = fail(path, "fit --env studio --material lambert --set steps=[1] --out a");
    assert!(said.contains("whole number") && !said.contains("usize"), "{said}");
    let map = Image { width: 2, height: 2, pixels: vec![[f32::NAN; 3]; 4] };
    write_exr(&path.join("nan.exr"), &map, &[]).unwrap();
    let said = fail(path, &VIEW.replace("studio", "nan.exr").replace("--sampler", "--out a.exr --sampler"));
    assert!(said.contains("12 channel values were NaN"), "{said}");
}

#[test]
fn diffuse_tables_on_glossy_surfaces_print_a_note() {
    let here = folder();
    let path = here.path();
    succeed(path, "bake --direct --env overcast --normals 4x6 --cells 4x4 --out table");
    let note = |material: &str| {
        let arguments = format!(
            "render --scene sphere --env overcast --sampler direct:table --spp 1 {SMALL} --material {material} --out {material}.exr"
        );
        text(&command(path, &arguments).output().unwrap().stderr)
    };
    assert!(note("ggx:alpha=0.3").contains("knows nothing of glossy ones"));
    assert_eq!(note("lambert"), "");
}

#[test]
fn reference_noise_is_estimated_and_corrected() {
    let here = folder();
    let path = here.path();
    let compare = |spp: u32, out: &str| {
        let arguments = format!(
            "compare --scene sphere --env studio {SMALL} --samplers mis,patches --runs 4 --spp 16 --reference-spp {spp} --out {out}"
        );
        succeed(path, &arguments);
        let mut reader = csv::Reader::from_path(path.join(out).join("results.csv")).unwrap();
        let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
        let of = |sampler: &str| -> f64 {
            rows.iter().find(|row| &row[2] == sampler && &row[4] == "mean").unwrap()[8].parse().unwrap()
        };
        (of("mis"), of("patches"), fs::read_to_string(path.join(out).join("report.html")).unwrap())
    };
    let (mis, patches, page) = compare(1024, "good");
    assert!(
        page.contains("Its own mean squared error, from two independent halves, is") && !page.contains("limited by it")
    );
    // A reference from the runs' own number of samples yields nearly the same errors after correction.
    let (noisy_mis, noisy_patches, page) = compare(16, "noisy");
    // The sphere covers about 1/3 of 432 pixels, in four runs of each; the reference's errors are common to
    // all runs. Their variance is that of a mean over about 150 squared errors, with relative deviation 1.4
    // for normal errors and more here: 0.3 is two deviations.
    assert!((noisy_mis / mis - 1.0).abs() < 0.3, "{noisy_mis} {mis}");
    assert!(noisy_patches < 2.0 * patches || page.contains("limited by it"), "{noisy_patches} {patches}");
    // Runs of 512 times the reference's samples have far smaller errors, so theirs are reported as limited by
    // it.
    let arguments = format!(
        "compare --scene sphere --env studio {SMALL} --samplers mis,patches --runs 1 --spp 2048 --reference-spp 4 --out limited"
    );
    let said = succeed(path, &arguments);
    assert!(said.contains("mis at 2048spp, patches at 2048spp are limited by it"), "{said}");
    assert!(fs::read_to_string(path.join("limited/report.html")).unwrap().contains("limited by it"));
    assert!(mean(&picture(&path.join("noisy/reference.exr"))) > 0.0);
}
