//! What the files that runs name hold, as hashes: a run is known by maps, scenes and materials as they are, and not by where they lie.

use std::{
    collections::HashMap,
    fs,
    io::Read,
    path::Path,
    sync::{Mutex, PoisonError},
};

use headtail_render::{
    environment::{BUILT_IN_NAMES, Environment},
    file,
    path_text::text_of,
    scene::{MaterialSpec, Scene, built_in_names},
};

/// A kind of file, and the name that a run has it by.
type Key = (&'static str, String);

/// Hashes of files by their names. Each is read once: a file that changes later keeps the hash that it had.
#[derive(Debug, Default)]
pub struct Contents(Mutex<HashMap<Key, String>>);

impl Contents {
    /// Of a map: its repaired texels. A built-in map is known by its name.
    pub fn map(&self, name: &str) -> String {
        if BUILT_IN_NAMES.contains(&name) {
            return name.to_owned();
        }
        self.of("map", name, || Environment::open(name).ok().map(|map| map.hash().to_owned()))
    }

    /// Of a scene: meshes, materials and camera. A built-in scene is known by its name.
    pub fn scene(&self, name: &str) -> String {
        if built_in_names().any(|known| known == name) {
            return name.to_owned();
        }
        let read = || {
            let scene = Scene::open(name).ok()?;
            Some(format!("{} {:?}", scene.content_hash(), scene.camera()))
        };
        self.of("scene", name, read)
    }

    /// Of a material: its description, with the file's bytes in the place of its name.
    pub fn material(&self, text: &str) -> String {
        match text.parse() {
            Ok(MaterialSpec::Measured { file, names }) => format!("{} {names:?}", self.bytes(&file)),
            Ok(MaterialSpec::Neural(spec)) => format!("{} {} {:?}", self.bytes(&spec.file), spec.repeat, spec.on),
            _ => text.to_owned(),
        }
    }

    fn bytes(&self, path: &Path) -> String {
        self.of("material", &text_of(path), || hash_of(path).ok())
    }

    /// What `read` finds, once for each name. A file that cannot be read is known by its name: the run will say what is wrong with it.
    fn of(&self, kind: &'static str, name: &str, read: impl FnOnce() -> Option<String>) -> String {
        let key = (kind, name.to_owned());
        let known = |contents: &Self| contents.0.lock().unwrap_or_else(PoisonError::into_inner).get(&key).cloned();
        if let Some(hash) = known(self) {
            return hash;
        }
        // Not under the lock: reading uses all threads, and one that waits for the others may be given a task that asks for the same lock.
        let hash = read().unwrap_or_else(|| format!("unread {name}"));
        self.0.lock().unwrap_or_else(PoisonError::into_inner).entry(key).or_insert(hash).clone()
    }
}

/// BLAKE3 of a regular file.
fn hash_of(path: &Path) -> std::io::Result<String> {
    let (mut file, _): (fs::File, u64) = file::open_regular(path)?;
    let mut hasher = blake3::Hasher::new();
    let mut part = vec![0; 1 << 16];
    loop {
        match file.read(&mut part)? {
            0 => return Ok(hasher.finalize().to_hex().to_string()),
            count => hasher.update(&part[..count]),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_known_by_what_is_in_it() {
        let folder = tempfile::tempdir().unwrap();
        let map = |name: &str, red: u8| {
            let path = folder.path().join(name);
            let mut bytes = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n".to_vec();
            bytes.extend([red, 128, 128, 128].repeat(8));
            fs::write(&path, bytes).unwrap();
            path.display().to_string()
        };
        let (a, same, other) = (map("a.hdr", 100), map("b.hdr", 100), map("c.hdr", 101));
        let contents = Contents::default();
        assert_eq!(contents.map(&a), contents.map(&same));
        assert_ne!(contents.map(&a), contents.map(&other));
        map("a.hdr", 101);
        assert_eq!(contents.map(&a), contents.map(&same), "one process sees one map");
        assert_eq!(Contents::default().map(&a), contents.map(&other));
        assert_eq!(contents.map("studio"), "studio");
        assert_ne!(contents.map("none.hdr"), contents.map("nothing.hdr"));
    }

    #[test]
    fn a_material_is_known_by_its_file_and_its_names() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, text: &str| {
            let path = folder.path().join(name);
            fs::write(&path, text).unwrap();
            path.display().to_string()
        };
        let (a, b, c) = (file("a", "x"), file("b", "x"), file("c", "y"));
        let hash = |text: &str| Contents::default().material(text);
        assert_eq!(hash(&format!("nbrdf:{a}#gold")), hash(&format!("nbrdf:{b}#gold")));
        assert_ne!(hash(&format!("nbrdf:{a}#gold")), hash(&format!("nbrdf:{b}#silver")));
        assert_ne!(hash(&format!("nbrdf:{a}#gold")), hash(&format!("nbrdf:{c}#gold")));
        assert_eq!(hash(&format!("neural:{a},repeat=2")), hash(&format!("neural:{b},repeat=2")));
        assert_ne!(hash(&format!("neural:{a},repeat=2")), hash(&format!("neural:{a},repeat=3")));
        assert_eq!(hash("ggx:alpha=0.4"), "ggx:alpha=0.4");
    }
}
