//! The pages in a real browser: the slider moves, charts are visible, the console is empty, pages fit narrow
//! screens, and no figure is split when printed.
//!
//! Needs `chromium`; reports a skip without it. The browser in the variable HEADTAIL_CHROMIUM must exist.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use super::{SMALL, folder, print::whole_figures, succeed, text};

/// Operates the page as a reader would, and writes the results into the body's `data-probe`.
const PROBE: &str = include_str!("probe.js");

/// Inspects a page in a frame of given width.
const NARROW: &str = include_str!("narrow.js");

/// Returns the probe's results. Panics if the page writes to the console, does not fit a telephone's screen,
/// or splits a figure when printed.
fn probe(browser: &str, page: &Path, dark: bool) -> String {
    let html = fs::read_to_string(page).unwrap();
    let copy = page.with_extension("probe.html");
    fs::write(&copy, html.replace("</body>", &format!("<script>{PROBE}</script></body>"))).unwrap();
    if !dark {
        let figures = whole_figures(browser, page);
        assert!(figures > 0 || !html.contains("<figure"), "{} has no figure on paper", page.display());
        for width in [360, 480] {
            assert_eq!(open(browser, &framed(page, width), dark), "fits", "{} in {width} pixels", page.display());
        }
    }
    open(browser, &copy, dark)
}

/// Wraps a page in a frame, since browser windows have a larger minimum width.
fn framed(page: &Path, width: u32) -> PathBuf {
    let (name, file) = (page.file_name().unwrap().to_str().unwrap(), page.with_extension("narrow.html"));
    let frame = format!("<iframe src=\"{name}\" style=\"width: {width}px; height: 2000px; border: 0\"></iframe>");
    fs::write(&file, format!("<!doctype html><body>{frame}<script>{NARROW}</script></body>")).unwrap();
    file
}

/// Opens a page that writes into its body's `data-probe`, and returns that.
fn open(browser: &str, page: &Path, dark: bool) -> String {
    let profile = folder();
    let mut command = Command::new(browser);
    command.args(
        "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking"
            .split(' '),
    );
    command.args(
        "--disable-component-update --disable-sync --enable-logging=stderr --virtual-time-budget=5000".split(' '),
    );
    if dark {
        command.arg("--force-dark-mode");
    }
    // Allows the page to access its frame.
    command.arg("--allow-file-access-from-files");
    command.arg(format!("--user-data-dir={}", profile.path().display()));
    let output = command.args(["--window-size=1400,3000", "--dump-dom"]).arg(page).output().unwrap();
    let (dom, log) = (text(&output.stdout), String::from_utf8_lossy(&output.stderr).into_owned());
    let console: Vec<&str> = log.lines().filter(|line| line.contains("CONSOLE")).collect();
    assert!(console.is_empty(), "{}: {console:?}", page.display());
    let found = dom.split_once("data-probe=\"").and_then(|(_, rest)| rest.split_once('"'));
    found.unwrap_or_else(|| panic!("{}: the probe did not run: {log}", page.display())).0.to_owned()
}

/// Returns the browser; reports a skip and returns `None` if there is none and none was named.
pub fn browser() -> Option<String> {
    let named = std::env::var("HEADTAIL_CHROMIUM").ok();
    let browser = named.clone().unwrap_or_else(|| "chromium".into());
    if Command::new(&browser).arg("--version").output().is_err() {
        assert!(named.is_none(), "{browser} cannot be started");
        eprintln!("skipped: {browser} is not there (name a browser by HEADTAIL_CHROMIUM)");
        return None;
    }
    Some(browser)
}

#[test]
fn pages_work_in_a_browser() {
    let Some(browser) = browser() else { return };
    let here = folder();
    let path = here.path();
    // Sampler names can be as long as paths.
    let table = "tables-of-the-studio-in-the-second-week/sixteen-normals-and-sixteen-cells-a-side/direct.safetensors";
    fs::create_dir_all(path.join(table).parent().unwrap()).unwrap();
    succeed(path, &format!("bake --direct --env studio --normals 4x6 --cells 4x4 --out {table}"));
    let view = format!(
        "compare --scene sphere --env studio {SMALL} --reference-spp 16 --samplers mis,ris:2,direct:{table} --spp 1,2 --runs 2"
    );
    succeed(path, &format!("{view} --out results"));
    succeed(path, "chart results results --out chart.html");
    for dark in [false, true] {
        let found = probe(&browser, &path.join("results/report.html"), dark);
        assert_eq!(
            found,
            "moved=true chosen=true same=true exposed=true difference=true zoomed=true sorted=true insets=true clicked=true fragment=true \
             charts=3 images=true"
        );
    }
    for dark in [false, true] {
        assert_eq!(probe(&browser, &path.join("chart.html"), dark), "charts=3 images=true");
    }
    succeed(path, "view --env window --width 60 --height 40 --out shot.exr");
    succeed(
        path,
        "composite --photo shot.exr --camera shot.fspy --env window --scene sphere --size 0.8 --spp 4 --out into",
    );
    for dark in [false, true] {
        assert_eq!(
            probe(&browser, &path.join("into/composite.html"), dark),
            "moved=true chosen=true same=true exposed=true difference=true zoomed=true charts=0 images=true"
        );
    }

    let view = "--env overcast --scene sphere --material lambert --width 16 --height 12";
    let said = succeed(path, &format!("autosize {view} --prepare-seconds 1 --render-seconds 2 --json --out auto"));
    let records: serde_json::Value = serde_json::from_str(&said).unwrap();
    let winners = records.as_array().unwrap().iter().filter(|record| record["winner"] == true).count();
    assert!(winners == 1 && records.as_array().unwrap().len() > 10, "{said}");
    let found = "front=true choice=true charts=1 images=true";
    for dark in [false, true] {
        assert_eq!(probe(&browser, &path.join("auto/autosize.html"), dark), found);
    }

    fs::write(path.join("space.toml"), super::sweep::SPACE.replace("steps = 400", "steps = 100")).unwrap();
    succeed(path, "sweep run space.toml --jobs 2 --threads 1");
    succeed(path, "sweep report space.toml");
    for dark in [false, true] {
        let found = probe(&browser, &path.join("space.sweep/report.html"), dark);
        assert_eq!(
            found,
            "rows=8 sorted=true filtered=4 brushed=true released=8 points=4 detail=true axis=true pdf=true saved=true charts=3 images=true"
        );
    }
}
