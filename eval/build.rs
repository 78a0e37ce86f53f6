//! Hashes the sources that determine what a sampler draws and what it costs, so that measurements can name
//! them.

use std::{fs, path::Path};

/// Folders and files of `sampling/src` or `render/src` that affect directions, densities, pictures or their
/// time.
const SOURCES: [&str; 33] = [
    "bake",
    "batch.rs",
    "brdf",
    "columns.rs",
    "discrete.rs",
    "environment",
    "estimator",
    "frame.rs",
    "head",
    "integrator",
    "latlong.rs",
    "linear.rs",
    "morton.rs",
    "patches",
    "points",
    "portals",
    "random.rs",
    "rival",
    "sampler",
    "scene/bvh.rs",
    "scene/material.rs",
    "scene/mesh.rs",
    "scene/mod.rs",
    "scene/normal_map.rs",
    "scene/ray.rs",
    "scene/texture.rs",
    "scene/wide",
    "scene/wide.rs",
    "simd.rs",
    "spline",
    "tail",
    "tile.rs",
    "visibility",
];

fn main() {
    let mut hasher = blake3::Hasher::new();
    for source in SOURCES {
        let paths = ["../sampling/src", "../render/src"].map(|root| Path::new(root).join(source));
        // Both may have it, as they have `portals`.
        for path in paths.iter().filter(|path| path.exists()) {
            println!("cargo:rerun-if-changed={}", path.display());
            add(path, source, &mut hasher);
        }
        // In a published package these sources are missing; its version stands for them.
        if !paths.iter().any(|path| path.exists()) {
            hasher.update(env!("CARGO_PKG_VERSION").as_bytes());
        }
    }
    let hash = hasher.finalize().to_hex();
    println!("cargo:rustc-env=HEADTAIL_SOURCES={}", &hash[..16]);
}

/// Adds a file, or the files of a folder in order of name, without tests, comments and white space.
fn add(path: &Path, name: &str, hasher: &mut blake3::Hasher) {
    if path.is_dir() {
        let mut entries: Vec<_> =
            fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
        entries.sort();
        for entry in entries {
            let part = entry.file_name().unwrap_or_default().to_string_lossy().into_owned();
            add(&entry, &format!("{name}/{part}"), hasher);
        }
    } else if path.extension().is_some_and(|extension| extension == "rs") && !name.ends_with("tests.rs") {
        let text = fs::read_to_string(path).unwrap_or_default();
        hasher.update(name.as_bytes()).update(code_of(&text).as_bytes());
    }
}

/// Returns the code of a file without its unit tests, comment lines and white space.
fn code_of(text: &str) -> String {
    let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    let lines = code.lines().map(str::trim).filter(|line| !line.starts_with("//"));
    lines.flat_map(|line| line.chars().filter(|letter| !letter.is_whitespace())).collect()
}
