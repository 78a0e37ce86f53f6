//! The parsed file with its buffers.

use std::{
    cell::{Cell, OnceCell, RefCell},
    io::Read,
    path::{Path, PathBuf},
};

use super::{
    json::{Buffer, Root, Whole},
    list::List,
    uri,
};
use crate::{
    error::{Error, Result},
    file::open_regular,
    remark::Remark,
};

/// Maximum number of bytes of the file and all files it references.
const MAX_BYTES: u64 = 4 << 30;

/// Maximum number of vertices and indices of all instances of all meshes. Many nodes and primitives can
/// reference the same few bytes, so that a small file could otherwise request any amount of memory.
const MAX_ELEMENTS: u64 = 1 << 26;

/// Maximum number of JSON objects. Parsed, an empty one takes 100 times the memory of its three bytes of
/// text.
const MAX_OBJECTS: usize = 1 << 21;

/// Maximum number of commas between JSON values. Parsed, a digit takes 16 times the memory of its text.
const MAX_COMMAS: usize = 1 << 26;

/// Extensions that are read, or that change neither light nor geometry.
const READ: [&str; 9] = [
    "EXT_mesh_gpu_instancing",
    "KHR_animation_pointer",
    "KHR_materials_emissive_strength",
    "KHR_materials_variants",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "MSFT_lod",
];

/// Ignored extensions that a file may require: geometry and base colours are right without them.
const LEFT_OUT: [&str; 13] = [
    "KHR_lights_punctual",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_dispersion",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
    "EXT_lights_image_based",
];

/// A glTF file with the bytes of its buffers.
pub struct Document {
    path: PathBuf,
    root: Root,
    /// Read on first use.
    buffers: Vec<OnceCell<Vec<u8>>>,
    /// The binary chunk, until its buffer takes it.
    blob: RefCell<Option<Vec<u8>>>,
    has_chunk: bool,
    bytes_left: Cell<u64>,
    elements_left: Cell<u64>,
    remarks: RefCell<Vec<Remark>>,
}

impl Document {
    /// Reads a file and its buffers.
    pub fn open(path: &Path) -> Result<Self> {
        let bytes_left = Cell::new(MAX_BYTES);
        let bytes = read_file(path, &bytes_left).map_err(|error| Error::io(path, error))?;
        let (json, blob) = split(path, &bytes)?;
        for (mark, most, what) in [(b'{', MAX_OBJECTS, "objects"), (b',', MAX_COMMAS, "values")] {
            if json.iter().filter(|&&byte| byte == mark).count() > most {
                return Err(Error::invalid(path, "JSON", format!("has more than {most} {what}")));
            }
        }
        // Some programs write a byte order mark.
        let json = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json);
        let root: Root = serde_json::from_slice(json)
            .map_err(|error| Error::invalid(path, "JSON", format!("is not a glTF document: {error}")))?;
        let buffers = root.buffers.iter().map(|_| OnceCell::new()).collect();
        let document = Self {
            path: path.to_owned(),
            root,
            buffers,
            has_chunk: blob.is_some(),
            blob: RefCell::new(blob),
            bytes_left,
            elements_left: Cell::new(MAX_ELEMENTS),
            remarks: RefCell::default(),
        };
        document.check_header()?;
        Ok(document)
    }

    /// Returns the parsed JSON.
    pub fn root(&self) -> &Root {
        &self.root
    }

    /// Records a remark, once.
    pub fn remark(&self, remark: Remark) {
        let mut remarks = self.remarks.borrow_mut();
        if !remarks.contains(&remark) {
            remarks.push(remark);
        }
    }

    /// Records a warning, once.
    pub fn warn(&self, text: impl Into<String>) {
        self.remark(Remark::Warning(text.into()));
    }

    /// Returns all remarks.
    pub fn into_remarks(self) -> Vec<Remark> {
        self.remarks.into_inner()
    }

    /// Returns an error about a field of this file.
    pub fn invalid(&self, field: impl Into<String>, reason: impl Into<String>) -> Error {
        Error::invalid(&self.path, field, reason)
    }

    /// Looks up an index given in `field`.
    pub fn get<'a, T>(&self, list: &'a List<T>, index: Whole, field: &str) -> Result<&'a T> {
        list.find(index.0).map_err(|reason| self.invalid(field, reason))
    }

    /// Returns the bytes of a buffer view and their stride, if it has one.
    pub fn view(&self, index: Whole, field: &str) -> Result<(&[u8], Option<usize>)> {
        let view = self.get(&self.root.buffer_views, index, &format!("{field}.bufferView"))?;
        let index = index.0;
        let own = self.get(&self.root.buffers, view.buffer, &format!("bufferViews[{index}].buffer"))?;
        let cell = &self.buffers[view.buffer.index()];
        if cell.get().is_none() {
            // Nothing else sets it in between.
            let _ = cell.set(self.read_buffer(own, view.buffer.index())?);
        }
        let buffer = cell.get().map_or(&[][..], Vec::as_slice);
        let (offset, length) = (view.byte_offset.0, view.byte_length.0);
        let range =
            offset.checked_add(length).and_then(|end| Some(usize::try_from(offset).ok()?..usize::try_from(end).ok()?));
        let Some(bytes) = range.and_then(|range| buffer.get(range)) else {
            let reason = format!("{length} bytes from {offset} on are more than the {} of the buffer", buffer.len());
            return Err(self.invalid(format!("bufferViews[{index}].byteLength"), reason));
        };
        Ok((bytes, view.byte_stride.map(Whole::index)))
    }

    /// Reads the bytes of a URI given in `field`.
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

    /// Counts the `count` vertices or indices of `field` towards the limit.
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
        let is_known = |name: &str| READ.contains(&name) || LEFT_OUT.contains(&name);
        if let Some(name) = self.root.extensions_required.iter().find(|name| !is_known(name)) {
            return Err(self.invalid("extensionsRequired", format!("'{name}' is not supported")));
        }
        self.root.extensions_used.iter().for_each(|name| self.warn_of_extension(name));
        Ok(())
    }

    /// Returns whether an extension is read, or changes neither light nor geometry.
    pub fn reads_extension(name: &str) -> bool {
        READ.contains(&name)
    }

    /// Warns of an extension that is not read.
    pub fn warn_of_extension(&self, name: &str) {
        if !Self::reads_extension(name) {
            self.warn(format!("ignored extension {}", name.escape_debug()));
        }
    }

    /// Returns whether a buffer without a URI is the binary chunk, if there is one.
    fn is_chunk(&self, index: usize) -> bool {
        let is_bare = |buffer: Option<&Buffer>| buffer.is_some_and(|buffer| buffer.uri.is_none());
        self.root.buffers.iter().position(is_bare) == Some(index)
    }

    /// Returns whether there are bytes for a buffer.
    pub fn has_bytes(&self, buffer: &Buffer, index: usize) -> bool {
        buffer.uri.is_some() || (self.has_chunk && self.is_chunk(index))
    }

    /// Reads a buffer; the first one without a URI is the binary chunk.
    fn read_buffer(&self, buffer: &Buffer, index: usize) -> Result<Vec<u8>> {
        let field = format!("buffers[{index}]");
        let bytes = match &buffer.uri {
            Some(uri) => self.resolve(uri, &format!("{field}.uri"))?,
            None => self
                .blob
                .take()
                .filter(|_| self.is_chunk(index))
                .ok_or_else(|| self.invalid(format!("{field}.uri"), "is missing, and there is no binary chunk"))?,
        };
        if (bytes.len() as u64) < buffer.byte_length.0 {
            let reason = format!("says {} bytes, but there are {}", buffer.byte_length.0, bytes.len());
            return Err(self.invalid(format!("{field}.byteLength"), reason));
        }
        Ok(bytes)
    }
}

/// Splits a file into the JSON and the binary chunk of a `.glb`.
fn split<'a>(path: &Path, bytes: &'a [u8]) -> Result<(&'a [u8], Option<Vec<u8>>)> {
    let Some(rest) = bytes.strip_prefix(b"glTF") else { return Ok((bytes, None)) };
    let number = |bytes: &[u8; 4]| u32::from_le_bytes(*bytes);
    let header = rest.split_first_chunk().and_then(|(version, rest)| Some((version, rest.split_first_chunk()?)));
    let invalid = |reason: String| Error::invalid(path, "GLB header", reason);
    let Some((version, (length, _))) = header else { return Err(invalid("is cut off".into())) };
    let (version, length) = (number(version), number(length));
    if length < 12 || bytes.len() < length as usize {
        return Err(invalid(format!("says {length} bytes, but the file has {}: it is cut off", bytes.len())));
    }
    if version != 2 {
        return Err(invalid(format!("says version {version}, but only glTF 2 can be read")));
    }
    let (mut json, mut binary) = (None, None);
    let mut rest = &bytes[12..length as usize];
    // Trailing bytes that are shorter than a chunk header are ignored.
    while let Some((length, after)) = rest.split_first_chunk().filter(|_| rest.len() >= 8) {
        let (kind, after) = after.split_at(4);
        let Some(chunk) = after.get(..number(length) as usize) else {
            let reason = format!("a chunk says {} bytes, but {} are left", number(length), after.len());
            return Err(Error::invalid(path, "GLB container", reason));
        };
        match kind {
            b"JSON" => json = json.or(Some(chunk)),
            b"BIN\0" => binary = binary.or(Some(chunk)),
            // The specification requires that unknown chunks be ignored.
            _ => {}
        }
        rest = &after[chunk.len()..];
    }
    let json = json.ok_or_else(|| Error::invalid(path, "GLB container", "has no JSON chunk"))?;
    Ok((json, binary.map(<[u8]>::to_vec)))
}

/// Reads a whole file, and subtracts its size from `bytes_left`.
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

/// Adds the file and the field to an error about a value made from `field`.
pub(super) fn in_field(document: &Document, field: &str, error: Error) -> Error {
    match error {
        Error::Argument { what, reason } => document.invalid(format!("{field}: {what}"), reason),
        other => other,
    }
}
