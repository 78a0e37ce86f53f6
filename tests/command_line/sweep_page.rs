//! The page of a sweep: its commands, its links and its front.

#[cfg(unix)]
use std::process::Command;
use std::{fs, path::Path};

#[cfg(unix)]
use super::text;
use super::{folder, succeed, sweep::SPACE};

/// The data of a sweep's page.
fn page_data(page: &Path) -> serde_json::Value {
    let text = fs::read_to_string(page).unwrap();
    let json = text.split_once("type=\"application/json\">").unwrap().1.split_once("</script>").unwrap().0;
    serde_json::from_str(json).unwrap()
}

#[cfg(unix)]
#[test]
fn commands_and_links_of_moved_pages_work() {
    let here = folder();
    let path = here.path();
    fs::write(path.join("room.hdr"), super::radiance_file(8, 4, 128, 128)).unwrap();
    let space = SPACE.replace("env = \"studio\"", "env = \"room.hdr\"").replace("steps = 400", "steps = 20");
    fs::write(path.join("space.toml"), space.replace("seed = [0, 1]", "seed = [0]")).unwrap();
    // A name with characters that are special in shells and addresses.
    let run = |action: &str, more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_headtail"));
        command.args(["sweep", action, "space.toml", "--out", "my sweep#1"]).args(more);
        let output = command.current_dir(path).output().unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
    };
    run("run", &["--jobs", "2", "--threads", "1"]);
    run("report", &["--file", "pages/of/report.html"]);
    let data = page_data(&path.join("pages/of/report.html"));
    assert_eq!(data["trials_at"], "../../my sweep#1/trials");
    let id = data["trials"][0]["id"].as_str().unwrap();
    assert!(path.join("pages/of").join(data["trials_at"].as_str().unwrap()).join(id).join("resolved.toml").is_file());
    let fit = data["fit"].as_str().unwrap().replace("{id}", id);
    let program = Path::new(env!("CARGO_BIN_EXE_headtail")).parent().unwrap();
    let known = std::env::var("PATH").unwrap_or_default();
    let mut shell = Command::new("sh");
    shell.env("PATH", format!("{}:{known}", program.display())).args(["-c", &fit]).current_dir(path);
    let output = shell.output().unwrap();
    assert!(output.status.success(), "{fit}: {}", text(&output.stderr));
    let bytes = |folder: &Path| fs::read(folder.join("sampler.safetensors")).unwrap();
    assert_eq!(bytes(&path.join(id)), bytes(&path.join("my sweep#1/trials").join(id)));
}

#[test]
fn the_page_has_the_front_of_error_against_time_by_the_worst_seed() {
    let here = folder();
    let path = here.path();
    let space = SPACE
        .replace("[\"relative_variance\", \"weights\"]", "[\"mse:small\", \"ns_per_sample\"]")
        .replace("steps = 400", "steps = 40")
        .replace("learning_rate = { log = [4e-3, 1.6e-2], points = 2 }\n", "")
        + "by = \"worst\"\n[[run.measure.views]]\nname = \"small\"\nscene = \"sphere\"\nwidth = 16\nheight = 12\nspp = 2\n\
           reference_spp = 64\n";
    fs::write(path.join("space.toml"), space).unwrap();
    succeed(path, "sweep run space.toml --jobs 2 --threads 1");
    succeed(path, "sweep report space.toml");
    let data = page_data(&path.join("space.sweep/report.html"));
    assert_eq!(data["objectives"], serde_json::json!(["mse:small", "ns_per_sample"]));
    let configurations = data["configurations"].as_array().unwrap();
    assert_eq!(configurations.len(), 2);
    let figures = |value: &serde_json::Value| -> Vec<f64> {
        value["figures"].as_array().unwrap().iter().map(|figure| figure.as_f64().unwrap()).collect()
    };
    for own in configurations {
        let trials: Vec<Vec<f64>> = own["trials"]
            .as_array()
            .unwrap()
            .iter()
            .map(|at| figures(&data["trials"][at.as_u64().unwrap() as usize]))
            .collect();
        let worst = [0, 1].map(|k| trials.iter().map(|trial| trial[k]).fold(0.0, f64::max));
        assert!(trials.len() == 2 && worst[0] > 0.0 && figures(own) == worst, "{own}");
        let beats =
            |other: &&serde_json::Value| figures(other).iter().zip(figures(own)).all(|(other, own)| *other < own);
        assert_eq!(own["front"], !configurations.iter().any(|other| beats(&other)), "{configurations:?}");
    }
    let page = fs::read_to_string(path.join("space.sweep/report.html")).unwrap();
    assert!(page.contains("mse:small against ns_per_sample") && page.contains("class=\"front\""));
}
