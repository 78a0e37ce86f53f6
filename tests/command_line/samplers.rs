//! Samplers with files: fitted, baked, tabulated, plotted and used.

use std::fs;

use headtail_render::export::ExportedSampler;

use super::{SMALL, fail, folder, is_png, is_svg, mean, names, picture, succeed};

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

    // All samplers estimate the same picture.
    let view = format!("render --scene sphere --env overcast --spp 64 {SMALL}");
    for (sampler, name) in [("head:fitted/sampler", "head"), ("baked:baked", "baked")] {
        let said = succeed(path, &format!("{view} --sampler {sampler}.safetensors --out {name}.exr"));
        assert!(said.starts_with(sampler) && said.contains("64 spp"), "{said}");
    }
    succeed(path, &format!("{view} --sampler mis --out mis.exr"));
    let expected = mean(&picture(&path.join("mis.exr")));
    for name in ["head", "baked"] {
        let found = mean(&picture(&path.join(name).with_extension("exr")));
        // 432 pixels at 64 samples of relative deviation below 1: the mean has an error well below 1 %.
        assert!((found / expected - 1.0).abs() < 0.02, "{name}: {found}, mis: {expected}");
    }
}

#[test]
fn heads_for_cloth_are_inspected_at_a_texel() {
    let here = folder();
    let path = here.path();
    let cloth = concat!("neural:", env!("CARGO_MANIFEST_DIR"), "/checkpoints/satin.safetensors");
    succeed(path, &format!("fit --env studio --material {cloth},repeat=4 --steps 20 --set conditions=16 --out cloth"));
    let at = |place: &str| -> serde_json::Value {
        let command = format!(
            "inspect cloth/sampler.safetensors --material {cloth} --view 0.4,1,0 {place} --json --out {}.svg",
            place.len()
        );
        serde_json::from_str(&succeed(path, &command)).unwrap()
    };
    let (there, coarse) = (at("--place 0.1,0.7"), at("--place 0.1,0.7 --level 6"));
    for found in [&there, &coarse] {
        // Cells of 512 x 256 are small compared with the bins of an untrained head.
        assert!((found["integral"].as_f64().unwrap() - 1.0).abs() < 0.01, "{found}");
        assert!(found["kl"].as_f64().unwrap() > 0.0 && found["share"].is_f64());
    }
    // Other texels have other features and another target.
    assert!(there["kl"] != coarse["kl"]);
    assert!(fail(path, "inspect cloth/sampler.safetensors --out a.svg").contains("give --material neural:FILE"));
}

#[test]
fn resolved_settings_reproduce_a_run() {
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
    // The file contains every setting, and the run that made a table, too.
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
        // 432 pixels at 64 samples of relative deviation below 1.5: the mean has an error of 1 %.
        assert!((found / expected - 1.0).abs() < 0.03, "{sampler}: {found}, mis: {expected}");
    }
}

#[test]
fn flow_tails_are_fitted_exported_and_shown() {
    let here = folder();
    let path = here.path();
    let fit =
        "fit --env sunset --material lambert --set steps=20 --set flow.steps=20 --set flow.cells=16 --checkpoint-dir";
    let said = succeed(path, &format!("{fit} ck --tail flow --out flow"));
    assert!(said.contains("flow tail: KL") && names(&path.join("ck")).contains(&"tail".to_owned()), "{said}");
    // A second run finds all steps of tail and head done.
    succeed(path, &format!("{fit} ck --resume --tail flow --out again"));
    let said = succeed(path, "inspect --tail --env sunset flow/sampler.safetensors --out tails.svg");
    assert!(
        is_svg(&path.join("tails.svg")) && ["row-column", "hierarchical", "flow"].iter().all(|t| said.contains(t)),
        "{said}"
    );
    let view = format!("render --scene plane --env sunset --unshadowed {SMALL}");
    succeed(path, &format!("{view} --spp 64 --sampler mis --out mis.exr"));
    let expected = mean(&picture(&path.join("mis.exr")));
    // 432 pixels. A flow of 20 steps hardly matches the sun: weights reach 900 (relative deviation 16,
    // standard error of the mean 1.2 % at 4096 samples per pixel; five are allowed).
    succeed(path, &format!("{view} --spp 4096 --sampler head+mis:flow/sampler.safetensors --out other.exr"));
    let found = mean(&picture(&path.join("other.exr")));
    assert!((found / expected - 1.0).abs() < 0.06, "{found}, mis: {expected}");
    assert!(fail(path, "bake --direct --env sunset --tail flow --out a.safetensors").contains("fit --tail flow"));
    assert!(
        fail(path, "inspect --tail --env studio flow/sampler.safetensors --out a.svg").contains("environment_hash")
    );
    assert!(fail(path, "fit --env sunset --material lambert --set flow.cells=7 --out a").contains("flow.cells"));
}

#[test]
fn the_stability_suite_writes_a_table_and_a_chart() {
    let here = folder();
    let path = here.path();
    let said = succeed(path, "stability --quick --only constant --only noon --out suite");
    assert!(said.contains("noon_grass: not run; give --maps DIR"), "{said}");
    let files = ["regimes", "regimes.svg", "stability.csv"];
    assert_eq!(names(&path.join("suite")), files);
    // The regimes are cached: the same rows are printed.
    let said = succeed(path, "stability --quick --only constant --only noon --json --out suite");
    let rows: Vec<serde_json::Value> = serde_json::from_str(&said).unwrap();
    let head = rows.iter().find(|row| row["regime"] == "constant map" && row["method"] == "head").unwrap();
    assert!(head["variance_over_mis"].is_f64() && head["state"] == "finished", "{head}");
    assert!(rows.iter().any(|row| row["state"] == "not run" && row["kl"].is_null()));
    let table = fs::read_to_string(path.join("suite/stability.csv")).unwrap();
    for method in ["mis", "head", "head and brdf by halves", "share", "default"] {
        assert!(table.contains(&format!("constant map,{method},finished")), "{method}: {table}");
    }
    assert!(fs::read_to_string(path.join("suite/regimes.svg")).unwrap().contains("constant map"));
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
