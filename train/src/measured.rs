//! Measured materials, and neural ones over surfaces, that heads are trained for.

use std::{
    fmt,
    path::Path,
    sync::{Arc, Mutex, PoisonError},
};

use headtail_render::{
    brdf::{NeuralTexture, neural::NeuralBrdf},
    scene::{NeuralSpec, open_measured},
};

/// Materials of a file. What was opened is kept for the life of the process, once for each description: materials are
/// values that are copied.
pub struct Measured {
    text: String,
    brdfs: Vec<Arc<NeuralBrdf>>,
    texture: Option<Arc<NeuralTexture>>,
}

static OPENED: Mutex<Vec<&'static Measured>> = Mutex::new(Vec::new());

impl Measured {
    /// Opens what a description names.
    ///
    /// # Errors
    /// A sentence: the file cannot be read, or does not hold what it is asked for.
    pub(crate) fn open(text: &str, file: &Path, names: &[String]) -> Result<&'static Self, String> {
        Self::kept(text, || {
            let brdfs = open_measured(file, names).map_err(|error| error.to_string())?;
            Ok(Self { text: text.to_owned(), brdfs, texture: None })
        })
    }

    /// Opens a neural material over a surface.
    ///
    /// # Errors
    /// A sentence: the file cannot be read.
    pub(crate) fn open_texture(text: &str, spec: &NeuralSpec) -> Result<&'static Self, String> {
        Self::kept(text, || {
            let texture = NeuralTexture::read(&spec.file).map_err(|error| error.to_string())?;
            Ok(Self { text: text.to_owned(), brdfs: vec![], texture: Some(Arc::new(texture)) })
        })
    }

    fn kept(text: &str, open: impl FnOnce() -> Result<Self, String>) -> Result<&'static Self, String> {
        let mut opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = opened.iter().find(|known| known.text == text) {
            return Ok(known);
        }
        let own: &'static Self = Box::leak(Box::new(open()?));
        opened.push(own);
        Ok(own)
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
        self.text == other.text
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
