//! The hash of the sources that determine what samplers draw and what that costs, by which measurements name
//! them. The build script computes it.

use std::{fs, path::Path};

/// Folders and files of the repository whose code affects directions, densities, pictures or their time.
pub const SOURCES: &[&str] = &["sampling/src", "render/src", "eval/src/auto.rs", "eval/src/view.rs"];

/// The same, and those that are added where a graphics device renders.
pub const DEVICE_SOURCES: &[&str] = &[
    "sampling/src",
    "render/src",
    "eval/src/auto.rs",
    "eval/src/view.rs",
    "shaders/src",
    "shaders/wgsl",
    "gpu/src",
    "gpu/wgsl",
];

/// Returns the hash of sources of a repository as 16 hexadecimal digits. In a published package, the version stands for
/// sources that are missing.
pub fn hash(repository: &Path, sources: &[&str]) -> String {
    let mut hasher = blake3::Hasher::new();
    for source in sources {
        let path = repository.join(source);
        if path.exists() {
            add(&path, source, &mut hasher);
        } else {
            hasher.update(env!("CARGO_PKG_VERSION").as_bytes());
        }
    }
    hasher.finalize().to_hex()[..16].to_owned()
}

/// Adds a file, or the files of a folder in order of name, without tests, comments and white space.
fn add(path: &Path, name: &str, hasher: &mut blake3::Hasher) {
    if path.is_dir() {
        let mut entries: Vec<_> =
            fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
        entries.sort();
        for entry in entries.iter().filter(|entry| !entry.ends_with("tests")) {
            let part = entry.file_name().unwrap_or_default().to_string_lossy().into_owned();
            add(entry, &format!("{name}/{part}"), hasher);
        }
    } else if path.extension().is_some_and(|extension| extension == "rs" || extension == "wgsl")
        && !name.ends_with("tests.rs")
    {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the folders below a folder, itself included, as paths relative to `root`.
    fn folders(root: &Path, folder: &str) -> Vec<String> {
        let mut found = vec![folder.to_owned()];
        for entry in fs::read_dir(root.join(folder)).unwrap().flatten().filter(|entry| entry.path().is_dir()) {
            found.extend(folders(root, &format!("{folder}/{}", entry.file_name().to_string_lossy())));
        }
        found
    }

    #[test]
    fn code_in_any_folder_changes_the_hash_but_comments_and_tests_do_not() {
        let repository = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let all: Vec<String> =
            ["sampling/src", "render/src"].into_iter().flat_map(|source| folders(&repository, source)).collect();
        assert!(all.iter().any(|folder| folder == "sampling/src/spec"));
        let copy = tempfile::tempdir().unwrap();
        all.iter().for_each(|folder| fs::create_dir_all(copy.path().join(folder)).unwrap());
        let empty = hash(copy.path(), SOURCES);
        for folder in all.iter().filter(|folder| !folder.contains("/tests")) {
            let file = copy.path().join(folder).join("added.rs");
            fs::write(&file, "fn added() {}\n").unwrap();
            let added = hash(copy.path(), SOURCES);
            assert_ne!(added, empty, "{folder}");
            fs::write(&file, "// What it does.\nfn added()  {}\n\n#[cfg(test)]\nmod tests {\n}\n").unwrap();
            assert_eq!(hash(copy.path(), SOURCES), added, "{folder}");
            fs::remove_file(&file).unwrap();
        }
        assert_eq!(hash(copy.path(), SOURCES), empty);
    }

    #[test]
    fn shaders_change_the_hash_of_devices_alone() {
        let copy = tempfile::tempdir().unwrap();
        fs::create_dir_all(copy.path().join("shaders/wgsl")).unwrap();
        let hashes = || [SOURCES, DEVICE_SOURCES].map(|sources| hash(copy.path(), sources));
        let empty = hashes();
        fs::write(copy.path().join("shaders/wgsl/added.wgsl"), "fn added() {}").unwrap();
        let added = hashes();
        assert!(added[0] == empty[0] && added[1] != empty[1]);
    }
}
