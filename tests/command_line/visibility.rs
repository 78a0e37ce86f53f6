//! `headtail bake --visibility` and the use of its file.

use std::fs;

use super::{after_header, fail, headtail, info, succeed};

const VIEW: &str = "--scene bedroom --env window --width 64 --height 48";

#[test]
fn visibility_is_trained_continued_rendered_and_shown() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let said = succeed(at, &format!("bake --visibility {VIEW} --spp 2 --out seen"));
    assert!(said.contains("cells from") && said.contains("seen written"), "{said}");
    let again = succeed(at, &format!("bake --visibility {VIEW} --spp 2 --out again"));
    assert!(again.contains("cells from"), "{again}");
    let counts = |name: &str| after_header(&fs::read(at.join(name)).unwrap());
    assert!(counts("seen") == counts("again"), "same seed, same counts");
    let took = |name: &str| info(at, name)["seconds of learning"].as_f64().unwrap();
    succeed(at, &format!("bake --visibility {VIEW} --spp 2 --resume seen --out more"));
    assert!(fs::metadata(at.join("more")).unwrap().len() >= fs::metadata(at.join("seen")).unwrap().len());
    // The count includes the training that is continued.
    assert!(took("seen") > 0.0 && took("more") > took("seen"), "{} {}", took("seen"), took("more"));
    succeed(at, &format!("compare {VIEW} --samplers patches+vis:more --spp 1 --runs 1 --reference-spp 1 --out both"));
    let page = fs::read_to_string(at.join("both/report.html")).unwrap();
    assert!(page.contains(&format!("visibility learned before ({:.1} s)", took("more"))));

    // Another material and another viewpoint.
    let other = "--material ggx:alpha=0.4 --look-from 0.5,1.2,2 --look-at 0,1,0";
    let said = succeed(at, &format!("render {VIEW} {other} --sampler patches+vis:more --spp 4 --out a.exr"));
    assert!(said.contains("patches+vis:more: 4 spp") && said.contains("visibility: "), "{said}");
    let said = succeed(at, &format!("inspect more --visibility {VIEW} --out cells.svg"));
    assert!(said.contains("as learned") && fs::metadata(at.join("cells.svg")).unwrap().len() > 1000, "{said}");
}

#[test]
fn visibility_errors_are_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    succeed(at, &format!("bake --visibility {VIEW} --spp 1 --out seen"));
    for (command, said) in [
        (format!("bake --visibility {VIEW} --resume missing --out x"), "missing"),
        (VIEW.replace("bedroom", "temple") + " --sampler patches+vis:seen --spp 1 --out x.exr", "in another scene"),
        (VIEW.replace("window", "studio") + " --sampler patches+vis:seen --spp 1 --out x.exr", "another map, window"),
        (format!("{VIEW} --ground --sampler patches+vis:seen --spp 1 --out x.exr"), "in another scene"),
        (format!("inspect seen --visibility {VIEW} --pixel 64,0 --out x.svg"), "the picture has 64 x 48 pixels"),
        ("inspect seen --out x.svg".to_owned(), "not a sampler"),
    ] {
        let command = if command.starts_with("--") { format!("render {command}") } else { command };
        let error = fail(at, &command);
        assert!(error.contains(said), "{command}: {error}");
    }
    for (command, said) in [
        ("bake --visibility --env window --out x".to_owned(), "--scene"),
        ("bake --visibility --scene bedroom --out x".to_owned(), "--env"),
        ("bake --direct --visibility --env window --scene bedroom --out x".to_owned(), "cannot be used with"),
        (format!("render {VIEW} --visibility-memory 0 --sampler mis --spp 1 --out x.exr"), "--visibility-memory"),
    ] {
        let output = headtail(at, &command);
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && error.contains(said), "{command}: {error}");
    }
}
