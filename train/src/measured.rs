//! Measured materials, and neural ones over surfaces, that heads are trained for.

use std::{
    fmt, io,
    path::Path,
    sync::{Arc, Mutex, PoisonError},
};

use headtail_render::{
    brdf::{
        NeuralTexture,
        neural::{NeuralBrdf, names_file},
    },
    error::Error,
    file::open_regular,
    scene::{NeuralSpec, open_measured},
};

/// Materials of a file.
///
/// They stay in memory until the process ends, once for each description and content of the file, because a
/// [`Material`](crate::Material) is `Copy`.
pub struct Measured {
    text: String,
    content: blake3::Hash,
    brdfs: Vec<Arc<NeuralBrdf>>,
    texture: Option<Arc<NeuralTexture>>,
}

static OPENED: Mutex<Vec<&'static Measured>> = Mutex::new(Vec::new());

/// Returns the materials that were opened by a description when the file had this content.
fn find(opened: &[&'static Measured], text: &str, content: blake3::Hash) -> Option<&'static Measured> {
    opened.iter().copied().find(|known| known.text == text && known.content == content)
}

/// Returns the BLAKE3 hash of a material file, and of the names beside it if there are any.
fn content_hash(file: &Path) -> io::Result<blake3::Hash> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(open_regular(file)?.0)?;
    if let Ok((names, _)) = open_regular(&names_file(file)) {
        hasher.update_reader(names)?;
    }
    Ok(hasher.finalize())
}

impl Measured {
    /// Opens the materials of a description.
    ///
    /// # Errors
    /// The file cannot be read, or a material that the description names is not in it.
    pub(crate) fn open(text: &str, file: &Path, names: &[String]) -> Result<&'static Self, String> {
        Self::cached(text, file, |content| {
            let brdfs = open_measured(file, names)?;
            Ok(Self { text: text.to_owned(), content, brdfs, texture: None })
        })
    }

    /// Opens a neural material over a surface.
    ///
    /// # Errors
    /// The file cannot be read, or is not a neural material.
    pub(crate) fn open_texture(text: &str, spec: &NeuralSpec) -> Result<&'static Self, String> {
        Self::cached(text, &spec.file, |content| {
            let texture = Some(Arc::new(NeuralTexture::read(&spec.file)?));
            Ok(Self { text: text.to_owned(), content, brdfs: vec![], texture })
        })
    }

    /// Calls `open` with the file's content hash unless the same content was opened by the same description.
    fn cached(
        text: &str,
        file: &Path,
        open: impl FnOnce(blake3::Hash) -> Result<Self, Error>,
    ) -> Result<&'static Self, String> {
        let opened = || OPENED.lock().unwrap_or_else(PoisonError::into_inner);
        let content = content_hash(file).map_err(|error| Error::io(file, error).to_string())?;
        let known = find(&opened(), text, content);
        if let Some(known) = known {
            return Ok(known);
        }
        // Opening uses rayon: under the lock, a worker that waits could take a task that asks for the same lock.
        let new = open(content).map_err(|error| error.to_string())?;
        let mut opened = opened();
        Ok(find(&opened, text, content).unwrap_or_else(|| {
            let new: &'static Self = Box::leak(Box::new(new));
            opened.push(new);
            new
        }))
    }

    /// The material over a surface, if it is one.
    pub fn texture(&self) -> Option<&Arc<NeuralTexture>> {
        self.texture.as_ref()
    }

    /// The materials.
    pub fn brdfs(&self) -> &[Arc<NeuralBrdf>] {
        &self.brdfs
    }

    /// Whether there are many, which one head serves.
    pub fn is_family(&self) -> bool {
        self.brdfs.len() > 1
    }
}

impl PartialEq for Measured {
    fn eq(&self, other: &Self) -> bool {
        self.text == other.text && self.content == other.content
    }
}

impl fmt::Debug for Measured {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Measured({})", self.text)
    }
}

impl fmt::Display for Measured {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use glam::Vec3;
    use headtail_render::brdf::neural::write_networks;

    use super::*;
    use crate::{Material, test_support::grey_lobe};

    fn open(text: &str) -> &'static Measured {
        let Material::Measured(materials) = text.parse().unwrap() else { panic!("{text}") };
        materials
    }

    /// The luminance towards the normal, seen from there, of the first material.
    fn luminance(materials: &Measured) -> f32 {
        materials.brdfs()[0].luminances(Vec3::Z, Vec3::Z, &[Vec3::Z])[0]
    }

    #[test]
    fn replaced_file_is_opened_anew() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("one.safetensors");
        let text = format!("nbrdf:{}#lobe", file.display());
        write_networks(&file, &[("lobe".into(), grey_lobe(0.5))]).unwrap();
        let dull = open(&text);
        assert!(std::ptr::eq(dull, open(&text)), "an unchanged file is opened once");
        write_networks(&file, &[("lobe".into(), grey_lobe(3.0))]).unwrap();
        let bright = open(&text);
        assert_ne!(dull, bright);
        assert!(luminance(bright) > 2.0 * luminance(dull), "{} and {}", luminance(dull), luminance(bright));
    }

    #[test]
    fn replaced_neural_material_is_opened_anew() {
        let checkpoint = |name| format!("{}/../checkpoints/{name}.safetensors", env!("CARGO_MANIFEST_DIR"));
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("cloth.safetensors");
        let text = format!("neural:{}", file.display());
        let hash_of = |name| {
            fs::copy(checkpoint(name), &file).unwrap();
            open(&text).texture().unwrap().hash()
        };
        assert_ne!(hash_of("satin"), hash_of("velvet"));
    }

    #[test]
    fn replaced_names_of_raw_rows_are_read_anew() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rows.f32");
        // All weights are zero: each material is as bright everywhere as the biases of its last layer.
        let row = |bias: f32| [vec![0.0; 672], vec![bias; 3]].concat();
        let bytes: Vec<u8> = [row(0.1), row(0.5)].concat().into_iter().flat_map(f32::to_le_bytes).collect();
        fs::write(&file, bytes).unwrap();
        let text = format!("nbrdf:{}#a", file.display());
        let luminance_with = |names: &str| {
            fs::write(names_file(&file), names).unwrap();
            luminance(open(&text))
        };
        let [first, second] = ["a\nb\n", "b\na\n"].map(luminance_with);
        assert!(second > 2.0 * first, "{first} and {second}");
    }
}
