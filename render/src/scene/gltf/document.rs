//! The parsed file with its buffers.

use std::{
    cell::Cell,
    io::Read,
    path::{Path, PathBuf},
};

use gltf::{
    binary::Glb,
    json::{self, Index, root::Get},
};

use super::uri;
use crate::{
    error::{Error, Result},
    file::open_regular,
};

/// The most bytes that the file and all files it names may have together.
const MAX_BYTES: u64 = 4 << 30;

/// The most vertices and indices that all instances of all meshes may have together. Many nodes and primitives can name
/// the same few bytes, so that a small file could otherwise ask for any amount of memory.
const MAX_ELEMENTS: u64 = 1 << 26;

/// The most JSON objects. The parsed form of an empty one takes a hundred times its three bytes of text.
const MAX_OBJECTS: usize = 1 << 21;

/// Extensions that a file may require: they do not change geometry or base colour, or are read.
const KNOWN_EXTENSIONS: [&str; 11] = [
    "KHR_mesh_quantization",
    "KHR_lights_punctual",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
];

/// A glTF file with the bytes of its buffers.
pub struct Document {
    path: PathBuf,
    root: json::Root,
    buffers: Vec<Vec<u8>>,
    bytes_left: Cell<u64>,
    elements_left: Cell<u64>,
}

impl Document {
    /// Reads a file and its buffers.
    pub fn open(path: &Path) -> Result<Self> {
        let bytes_left = Cell::new(MAX_BYTES);
        let bytes = read_file(path, &bytes_left).map_err(|error| Error::io(path, error))?;
        let (json, mut blob) = split(path, &bytes)?;
        if json.iter().filter(|&&byte| byte == b'{').count() > MAX_OBJECTS {
            return Err(Error::invalid(path, "JSON", format!("has more than {MAX_OBJECTS} objects")));
        }
        let root: json::Root = json::deserialize::from_slice(json)
            .map_err(|error| Error::invalid(path, "JSON", format!("is not a glTF document: {error}")))?;
        let mut document = Self {
            path: path.to_owned(),
            root,
            buffers: Vec::new(),
            bytes_left,
            elements_left: Cell::new(MAX_ELEMENTS),
        };
        document.check_header()?;
        for index in 0..document.root.buffers.len() {
            let buffer = document.read_buffer(index, &mut blob)?;
            document.buffers.push(buffer);
        }
        Ok(document)
    }

    /// The JSON.
    pub fn root(&self) -> &json::Root {
        &self.root
    }

    /// An error about a field of this file.
    pub fn invalid(&self, field: impl Into<String>, reason: impl Into<String>) -> Error {
        Error::invalid(&self.path, field, reason)
    }

    /// What an index in `field` stands for.
    pub fn get<T>(&self, index: Index<T>, field: &str) -> Result<&T>
    where
        json::Root: Get<T>,
    {
        let value = index.value();
        self.root.get(index).ok_or_else(|| self.invalid(field, format!("index {value} is out of range")))
    }

    /// The bytes of a buffer view and their stride, if it has one.
    pub fn view(&self, index: usize, field: &str) -> Result<(&[u8], Option<usize>)> {
        let Some(view) = self.root.buffer_views.get(index) else {
            return Err(self.invalid(format!("{field}.bufferView"), format!("index {index} is out of range")));
        };
        let Some(buffer) = self.buffers.get(view.buffer.value()) else {
            let reason = format!("index {} is out of range", view.buffer.value());
            return Err(self.invalid(format!("bufferViews[{index}].buffer"), reason));
        };
        let offset = view.byte_offset.map_or(0, |offset| offset.0);
        let range = offset
            .checked_add(view.byte_length.0)
            .and_then(|end| Some(usize::try_from(offset).ok()?..usize::try_from(end).ok()?));
        let Some(bytes) = range.and_then(|range| buffer.get(range)) else {
            let reason = format!(
                "{} bytes from {offset} on are more than the {} of the buffer",
                view.byte_length.0,
                buffer.len()
            );
            return Err(self.invalid(format!("bufferViews[{index}].byteLength"), reason));
        };
        Ok((bytes, view.byte_stride.map(|stride| stride.0)))
    }

    /// The bytes behind a URI in `field`.
    pub fn resolve(&self, uri: &str, field: &str) -> Result<Vec<u8>> {
        let shown: String = uri.chars().take(60).collect();
        match uri::parse(uri) {
            Ok(uri::Source::Data(bytes)) => Ok(bytes),
            Ok(uri::Source::File(relative)) => {
                let file = self.path.parent().unwrap_or(Path::new("")).join(relative);
                read_file(&file, &self.bytes_left)
                    .map_err(|error| self.invalid(field, format!("cannot read '{shown}': {error}")))
            }
            Err(reason) => Err(self.invalid(field, format!("'{shown}' {reason}"))),
        }
    }

    /// Accounts for `count` vertices or indices that `field` asks for.
    pub fn reserve_elements(&self, count: u64, field: &str) -> Result<()> {
        let left = self.elements_left.get().checked_sub(count).ok_or_else(|| {
            self.invalid(field, format!("with its {count} elements the scene has more than {MAX_ELEMENTS}"))
        })?;
        self.elements_left.set(left);
        Ok(())
    }

    fn check_header(&self) -> Result<()> {
        let version = &self.root.asset.version;
        if !version.starts_with("2.") {
            return Err(self.invalid("asset.version", format!("is '{version}', but only glTF 2 can be read")));
        }
        match self.root.extensions_required.iter().find(|name| !KNOWN_EXTENSIONS.contains(&name.as_str())) {
            Some(name) => Err(self.invalid("extensionsRequired", format!("'{name}' is not supported"))),
            None => Ok(()),
        }
    }

    /// The bytes of a buffer: `blob` for the first one without URI.
    fn read_buffer(&self, index: usize, blob: &mut Option<Vec<u8>>) -> Result<Vec<u8>> {
        let buffer = &self.root.buffers[index];
        let field = format!("buffers[{index}]");
        let bytes = match &buffer.uri {
            Some(uri) => self.resolve(uri, &format!("{field}.uri"))?,
            None => blob
                .take()
                .ok_or_else(|| self.invalid(format!("{field}.uri"), "is missing, and there is no binary chunk"))?,
        };
        if (bytes.len() as u64) < buffer.byte_length.0 {
            let reason = format!("says {} bytes, but there are {}", buffer.byte_length.0, bytes.len());
            return Err(self.invalid(format!("{field}.byteLength"), reason));
        }
        Ok(bytes)
    }
}

/// The JSON of a file, and the binary chunk of a `.glb`.
fn split<'a>(path: &Path, bytes: &'a [u8]) -> Result<(&'a [u8], Option<Vec<u8>>)> {
    if !bytes.starts_with(b"glTF") {
        return Ok((bytes, None));
    }
    // The parser subtracts the 12 bytes of the header from this length without a look.
    let length = bytes.get(8..12).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    if length < 12 || bytes.len() < length as usize {
        let reason = format!("says {length} bytes, but the file has {}: it is cut off", bytes.len());
        return Err(Error::invalid(path, "GLB header", reason));
    }
    let glb = Glb::from_slice(bytes)
        .map_err(|error| Error::invalid(path, "GLB container", format!("cannot be split into chunks: {error}")))?;
    let std::borrow::Cow::Borrowed(json) = glb.json else {
        return Err(Error::invalid(path, "GLB container", "has no JSON chunk"));
    };
    Ok((json, glb.bin.map(std::borrow::Cow::into_owned)))
}

/// Reads a whole file, and takes its size from `bytes_left`.
fn read_file(path: &Path, bytes_left: &Cell<u64>) -> std::io::Result<Vec<u8>> {
    let (file, size) = open_regular(path)?;
    let Some(left) = bytes_left.get().checked_sub(size) else {
        return Err(std::io::Error::other(format!("more than {} GiB in all", MAX_BYTES >> 30)));
    };
    bytes_left.set(left);
    let mut bytes = Vec::new();
    // The file may grow meanwhile.
    file.take(size).read_to_end(&mut bytes)?;
    Ok(bytes)
}
