//! Runs the commands of the documentation with small settings: every line that starts with `headtail` in a
//! block marked `sh`.
//!
//! Blocks that are not run state a reason: `sh not run: needs a cluster`.

use std::{fs, path::Path};

use super::{SMALL, folder, headtail, radiance_file, succeed, text};

/// The pages relative to the root of the repository.
fn pages() -> Vec<String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut pages = ["README.md", "RESULTS.md", "checkpoints/README.md"].map(str::to_owned).to_vec();
    let mut folders = vec!["docs".to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(root.join(&folder)).unwrap() {
            let entry = entry.unwrap();
            let name = format!("{folder}/{}", entry.file_name().into_string().unwrap());
            match entry.file_type().unwrap().is_dir() {
                true => folders.push(name),
                false if name.ends_with(".md") => pages.push(name),
                false => {}
            }
        }
    }
    pages[3..].sort();
    pages
}

/// Returns the commands of a page, each on one line without comments, and the number of blocks that are not
/// run.
fn commands(page: &str) -> (Vec<String>, usize) {
    let (mut found, mut left_out, mut is_inside, mut command) = (Vec::new(), 0, false, String::new());
    for line in page.lines() {
        match line.strip_prefix("```") {
            Some(mark) => {
                let reason = mark.strip_prefix("sh not run: ");
                assert!(!mark.starts_with("sh ") || reason.is_some_and(|reason| reason.len() > 8), "{mark}: no reason");
                left_out += usize::from(reason.is_some());
                is_inside = mark == "sh" && !is_inside;
            }
            None if is_inside => {
                let line = line.split(" #").next().unwrap_or_default().trim();
                let (part, goes_on) = line.strip_suffix('\\').map_or((line, false), |part| (part.trim_end(), true));
                command += part;
                command.push(' ');
                if !goes_on {
                    let whole = std::mem::take(&mut command);
                    found.extend(whole.trim().strip_prefix("headtail ").map(str::to_owned));
                }
            }
            None => {}
        }
    }
    (found, left_out)
}

/// Adds options for small pictures and short training.
fn small(command: &str) -> String {
    let mut words: Vec<String> = command.split_whitespace().map(str::to_owned).collect();
    for (option, value) in
        [("--width", "24"), ("--height", "18"), ("--runs", "1"), ("--reference-spp", "4"), ("--crop", "4,3,16,12")]
    {
        if let Some(at) = words.iter().position(|word| word == option) {
            words[at + 1] = value.into();
        }
    }
    if let Some(at) = words.iter().position(|word| word == "--spp") {
        words[at + 1] = if words[at + 1].contains(',') { "1,2" } else { "1" }.into();
    }
    let has = |option: &str| words.iter().any(|word| word == option);
    let mut added = String::new();
    match words[0].as_str() {
        "render" | "compare" | "view" if !has("--width") => added += &format!(" {SMALL}"),
        "bake" if has("--visibility") => added += &format!(" {SMALL} --spp 1"),
        "composite" => added += " --spp 1",
        "fit-rival" => added += " --steps 2 --views 4 --directions 8",
        "fit" if !has("--print-config") => {
            added += " --set steps=12 --set conditions=4 --set validation_conditions=2";
            if has("flow") {
                added += " --set flow.steps=12 --set flow.cells=16";
            }
        }
        _ => {}
    }
    if words[0] == "compare" {
        added += if has("--runs") { "" } else { " --runs 1" };
        added += if has("--reference-spp") { "" } else { " --reference-spp 4" };
    }
    words.join(" ") + &added
}

/// A map with one bright window.
pub(super) fn room() -> Vec<u8> {
    let (width, height) = (64, 32);
    let mut bytes = radiance_file(width, height, 128, 127);
    let start = bytes.len() - 4 * width * height;
    for (y, x) in (8..12).flat_map(|y| (20..26).map(move |x| (y, x))) {
        bytes[start + 4 * (y * width + x) + 3] = 131;
    }
    bytes
}

/// A pyramid as binary glTF.
pub(super) fn pyramid() -> Vec<u8> {
    let corners: [[f32; 3]; 4] = [[-1.0, 0.0, -1.0], [1.0, 0.0, -1.0], [0.0, 0.0, 1.0], [0.0, 1.5, 0.0]];
    let triangles: [u16; 12] = [0, 1, 2, 0, 3, 1, 1, 3, 2, 2, 3, 0];
    let mut binary: Vec<u8> = corners.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
    binary.extend(triangles.iter().flat_map(|value| value.to_le_bytes()));
    let mut json = String::from(
        r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],"buffers":[{"byteLength":72}],
        "bufferViews":[{"buffer":0,"byteOffset":0,"byteLength":48},{"buffer":0,"byteOffset":48,"byteLength":24}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[-1,0,-1],"max":[1,1.5,1]},
        {"bufferView":1,"componentType":5123,"count":12,"type":"SCALAR"}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}]}"#,
    );
    while !json.len().is_multiple_of(4) {
        json.push(' ');
    }
    let chunk = |kind: &[u8; 4], bytes: &[u8]| [&(bytes.len() as u32).to_le_bytes(), kind.as_slice(), bytes].concat();
    let chunks = [chunk(b"JSON", json.as_bytes()), chunk(b"BIN\0", &binary)].concat();
    let head = [b"glTF".as_slice(), &2_u32.to_le_bytes(), &(12 + chunks.len() as u32).to_le_bytes()].concat();
    [head, chunks].concat()
}

#[test]
fn commands_of_the_documentation_run() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut ran = 0;
    for page in pages() {
        let (commands, _) = commands(&fs::read_to_string(root.join(&page)).unwrap());
        let here = folder();
        fs::write(here.path().join("room.hdr"), room()).unwrap();
        fs::create_dir(here.path().join("checkpoints")).unwrap();
        for entry in fs::read_dir(root.join("checkpoints")).unwrap() {
            let entry = entry.unwrap();
            if entry.file_type().unwrap().is_file() {
                fs::copy(entry.path(), here.path().join("checkpoints").join(entry.file_name())).unwrap();
            }
        }
        fs::write(here.path().join("spot.glb"), pyramid()).unwrap();
        fs::write(here.path().join("run.toml"), "learning_rate = 2e-3\n").unwrap();
        for command in &commands {
            println!("{page}: {command}");
            succeed(here.path(), &small(command));
            ran += 1;
        }
    }
    assert!(ran > 20, "only {ran} commands were found");
}

#[test]
fn continued_lines_are_joined_and_comments_removed() {
    let page = "```sh\n# a\nheadtail x \\\n    --y  # b\ncargo z\n```\n```toml\nheadtail = 1\n```\n```sh not run: needs a cluster\nheadtail w\n```\n";
    assert_eq!(commands(page), (vec!["x --y".to_owned()], 1));
}

/// Returns the commands in the help, `help` itself excluded, with their descriptions.
pub(super) fn commands_of_the_help() -> Vec<(String, String)> {
    let help = text(&headtail(folder().path(), "--help").stdout);
    let (_, rest) = help.split_once("Commands:\n").expect("a list of commands");
    let mut rows: Vec<(String, String)> = Vec::new();
    for line in rest.lines().take_while(|line| !line.is_empty()) {
        let words = line.trim();
        match (line.starts_with("   "), rows.last_mut()) {
            (true, Some((_, about))) => *about += &format!(" {words}"),
            _ => rows.extend(words.split_once(' ').map(|(name, about)| (name.to_owned(), about.trim().to_owned()))),
        }
    }
    rows.retain(|(name, _)| name != "help");
    rows
}
