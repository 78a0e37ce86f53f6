//! Pictures: samplers without files, budgets, views, scenes, materials and points.

use std::fs;

use super::{SMALL, fail, folder, is_png, mean, names, picture, refuse, succeed};

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
        assert!(
            said.contains(" spp of lattice:")
                && said.contains(&format!("out/{name}.exr and out/{name}.png (exposed by ")),
            "{said}"
        );
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
    // Without shadow rays, pixels do not get darker: the samples are the same.
    assert!(mean(&unshadowed) > 1.1 * mean(&shadowed));
    let brighter = |(a, b): (&[f32; 3], &[f32; 3])| a.iter().zip(b).all(|(a, b)| a >= b);
    assert!(unshadowed.pixels.iter().zip(&shadowed.pixels).all(brighter));
    for options in ["--ground --look-from 40,9,40 --look-at 0,0,0", "--look-from 40,9,40 --look-at 0,0,0", "--fov 20"] {
        assert_ne!(render(options), shadowed, "{options}");
    }
}

#[test]
fn indirect_light_adds_to_direct_light() {
    let here = folder();
    let path = here.path();
    let view = format!("render --scene dishes --env overcast --sampler mis --spp 16 {SMALL}");
    let said = succeed(path, &format!("{view} --timings --out direct.exr"));
    for stage in ["camera rays", "sampling", "pdf evaluation", "shadow rays", "shading", "everything else"] {
        assert!(said.contains(&format!("\n{stage} ")), "{said}");
    }
    assert!(said.contains("\nthread-seconds by stage"), "{said}");
    // BRDF sampling evaluates no second pdf.
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
    for name in ["temple", "dishes", "diorama", "droid", "bedroom", "cloth", "arcade", "sphere", "plane"] {
        assert!(said.contains(&format!("\n{name} ")), "{said}");
        assert!(is_png(&path.join("pictures").join(name).with_extension("png")));
    }
    assert!(fail(path, "scenes --out pictures --env nowhere").contains("nowhere"));
    assert!(fail(path, "chart nowhere --out chart.html").starts_with("nowhere"));
}

#[test]
fn materials_can_replace_those_of_every_surface() {
    let here = folder();
    let path = here.path();
    let view = format!("render --scene dishes --env overcast --ground --unshadowed {SMALL}");
    let render = |options: &str| {
        succeed(path, &format!("{view} --spp 32 {options} --out a.exr"));
        mean(&picture(&path.join("a.exr")))
    };
    let rough = render("--sampler mis --material ggx:alpha=0.2..0.8");
    assert!((render("--sampler brdf --material ggx:alpha=0.2..0.8") / rough - 1.0).abs() < 0.03);
    // White surfaces are brighter than the scene's own, and rough mirrors lose energy between bounces.
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
            .contains("temple, dishes, diorama, droid, bedroom, cloth, arcade, sphere, plane")
    );
}

#[test]
fn the_same_seed_gives_the_same_picture_on_any_number_of_threads() {
    let here = folder();
    let view = "render --scene dishes --env studio --sampler ris:4 --spp 20 --width 40 --height 30";
    for (threads, seed, out) in [(1, 9, "a"), (3, 9, "b"), (3, 10, "c")] {
        succeed(here.path(), &format!("{view} --threads {threads} --seed {seed} --out {out}.exr"));
    }
    // EXR files contain the render time, so only their pixels are compared; PNG files are identical.
    let [a, b, c] = ["a", "b", "c"].map(|name| picture(&here.path().join(name).with_extension("exr")));
    assert_eq!(a, b);
    assert_ne!(a, c);
    let png = |name: &str| fs::read(here.path().join(name)).unwrap();
    assert!(png("a.png") == png("b.png"));
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
    let named = ["lattice", "sobol", "independent"].map(|points| render(points, &format!("--spp 4 --points {points}")));
    let spoken = ["lattice:4", "sobol", "independent"];
    for ((_, said), points) in named.iter().zip(spoken) {
        assert!(said.contains(&format!(" 4 spp of {points} points in ")), "{said}");
    }
    assert_eq!(default, named[0].0);
    assert!(named[0].0 != named[1].0 && named[1].0 != named[2].0 && named[2].0 != named[0].0);
    // A picture of three samples may be part of a plan of four; a budget in seconds is planned after the first sample.
    assert!(render("planned", "--spp 3 --points lattice:4").0 != render("resolved", "--spp 3 --points lattice").0);
    assert!(render("timed", "--seconds 0.01").1.contains(" spp of lattice:"));

    let compare =
        format!("compare --scene plane --env studio --samplers mis,emitter --runs 1 --reference-spp 8 {SMALL}");
    succeed(path, &format!("{compare} --spp 1,6 --seconds 0.01 --out results"));
    let mut reader = csv::Reader::from_path(path.join("results/results.csv")).unwrap();
    let points: Vec<(String, String, String)> = reader
        .records()
        .map(Result::unwrap)
        .map(|row| (row[3].to_owned(), row[16].to_owned(), row[5].to_owned()))
        .collect();
    assert_eq!(points.len(), 3 * 2 * 2);
    for (budget, points, spp) in points {
        assert_eq!(points, format!("lattice:{spp}"), "{budget}");
    }
    let page = fs::read_to_string(path.join("results/report.html")).unwrap();
    assert!(page.contains("<dd>lattice</dd>"));
    for wrong in ["halton", "zsobol", "lattice:0", "lattice:4294967296", "Sobol"] {
        let message = refuse(
            path,
            &format!("render --scene plane --env studio --sampler mis --spp 1 --points {wrong} --out x.exr"),
        );
        assert!(message.contains("--points") && message.contains("lattice:N"), "{message}");
    }
}
