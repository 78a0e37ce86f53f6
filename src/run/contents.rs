//! Hashes of the files that runs name: a run is identified by the content of maps, scenes and materials, not
//! by their paths.

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

/// Kind and name of a file.
type Key = (&'static str, String);

/// Hashes of files by name. Each file is read once: later changes do not affect its hash.
#[derive(Debug, Default)]
pub struct Contents(Mutex<HashMap<Key, String>>);

impl Contents {
    /// Returns the hash of a map's repaired texels. Built-in maps are identified by name.
    pub fn map(&self, name: &str) -> String {
        if BUILT_IN_NAMES.contains(&name) {
            return name.to_owned();
        }
        self.of("map", name, || Environment::open(name).ok().map(|map| map.hash().to_owned()))
    }

    /// Returns the hash of a scene's meshes, materials and camera. Built-in scenes are identified by name.
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

    /// Returns the description of a material, with the file's hash in place of its name.
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

    /// Returns the result of `read`, which is called once per name. A file that cannot be read is identified
    /// by name: the run reports the error.
    fn of(&self, kind: &'static str, name: &str, read: impl FnOnce() -> Option<String>) -> String {
        let key = (kind, name.to_owned());
        let known = |contents: &Self| contents.0.lock().unwrap_or_else(PoisonError::into_inner).get(&key).cloned();
        if let Some(hash) = known(self) {
            return hash;
        }
        // Without the lock: reading uses all threads, and a waiting thread may be given a task that asks for
        // the same lock.
        let hash = read().unwrap_or_else(|| format!("unread {name}"));
        self.0.lock().unwrap_or_else(PoisonError::into_inner).entry(key).or_insert(hash).clone()
    }
}

/// Returns the BLAKE3 hash of a regular file.
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
    fn maps_are_identified_by_content() {
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
    fn materials_are_identified_by_file_content_and_names() {
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
