//! Writing results: lossless OpenEXR with attributes, and PNG for viewing. Equal images give equal bytes.

use std::collections::HashMap;
use std::io::Cursor;
use std::path::Path;

use exr::meta::attribute::{AttributeValue as ExrValue, Text};
use exr::prelude::{Encoding, Layer, LayerAttributes, SpecificChannels, WritableImage};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use super::Image;
use crate::color;
use crate::error::{Error, Result};
use crate::file;

/// A named value in the header of an OpenEXR file, such as the sampler, spp or seed of a rendering.
///
/// Names have up to 255 bytes. The standard's own (`channels`, `version`, `comments`, ...) are rejected; use
/// a prefix (`headtail.version`).
#[derive(Clone, Debug, PartialEq)]
pub struct Attribute {
    /// The name under which a reader finds the value.
    pub name: String,
    /// The value.
    pub value: AttributeValue,
}

impl Attribute {
    /// Creates an attribute from a text, an `i32`, an `f32` or an `f64`.
    pub fn new(name: impl Into<String>, value: impl Into<AttributeValue>) -> Self {
        Self { name: name.into(), value: value.into() }
    }
}

/// The value of an [`Attribute`].
#[derive(Clone, Debug, PartialEq)]
pub enum AttributeValue {
    /// A text of Latin-1 characters, the only ones that OpenEXR allows (see [`latin_1`]); also for 64-bit
    /// integers.
    Text(String),
    /// A 32-bit integer.
    I32(i32),
    /// A 32-bit float.
    F32(f32),
    /// A 64-bit float.
    F64(f64),
}

/// Escapes all characters outside Latin-1 as Rust does, `\u{1f600}`.
pub fn latin_1(text: &str) -> String {
    text.chars().map(|c| if u32::from(c) < 256 { c.to_string() } else { c.escape_unicode().to_string() }).collect()
}

impl From<&str> for AttributeValue {
    fn from(value: &str) -> Self {
        Self::Text(value.to_owned())
    }
}

impl From<String> for AttributeValue {
    fn from(value: String) -> Self {
        Self::Text(value)
    }
}

impl From<i32> for AttributeValue {
    fn from(value: i32) -> Self {
        Self::I32(value)
    }
}

impl From<f32> for AttributeValue {
    fn from(value: f32) -> Self {
        Self::F32(value)
    }
}

impl From<f64> for AttributeValue {
    fn from(value: f64) -> Self {
        Self::F64(value)
    }
}

/// Writes an OpenEXR file: channels R, G, B, 32-bit float, scan lines, ZIP (lossless).
///
/// # Errors
/// [`Error::Argument`] if the image is empty or an attribute has a name or text that OpenEXR does not allow;
/// [`Error::Io`] if the file cannot be written, see [`file::replace`].
pub fn write_exr(path: &Path, image: &Image, attributes: &[Attribute]) -> Result<()> {
    file::replace(path, &encode_exr(image, attributes)?)
}

/// Returns the bytes that [`write_exr`] writes.
///
/// # Errors
/// [`Error::Argument`], as [`write_exr`].
pub fn encode_exr(image: &Image, attributes: &[Attribute]) -> Result<Vec<u8>> {
    check_not_empty(image)?;
    let header = LayerAttributes { other: header_attributes(attributes)?, ..LayerAttributes::default() };
    let pixel = |position: exr::math::Vec2<usize>| {
        let [r, g, b] = image.pixels[position.y() * image.width + position.x()];
        (r, g, b)
    };
    let layer = Layer::new((image.width, image.height), header, Encoding::SMALL_LOSSLESS, SpecificChannels::rgb(pixel));
    let mut bytes = Cursor::new(Vec::new());
    exr::prelude::Image::from_layer(layer)
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .map_err(|error| Error::argument("OpenEXR attributes", error.to_string()))?;
    let mut bytes = bytes.into_inner();
    sort_header(&mut bytes);
    Ok(bytes)
}

/// Converts attributes to OpenEXR's.
pub(super) fn header_attributes(attributes: &[Attribute]) -> Result<HashMap<Text, ExrValue>> {
    let mut all = HashMap::new();
    for attribute in attributes {
        let name = text(&attribute.name, &attribute.name)?;
        let value = match &attribute.value {
            AttributeValue::Text(value) => ExrValue::Text(text(&attribute.name, value)?),
            AttributeValue::I32(value) => ExrValue::I32(*value),
            AttributeValue::F32(value) => ExrValue::F32(*value),
            AttributeValue::F64(value) => ExrValue::F64(*value),
        };
        if all.insert(name, value).is_some() {
            return Err(Error::argument(format!("attribute {}", attribute.name), "it is given twice"));
        }
    }
    Ok(all)
}

/// Tone-maps an image with [`color::tone_map`] and writes it as an sRGB PNG, 8 bits per channel.
///
/// `exposure` is in stops: 0 leaves the radiance unchanged, each +1 doubles it.
///
/// # Errors
/// As [`encode_png`]; [`Error::Io`] if the file cannot be written, see [`file::replace`].
pub fn write_png(path: &Path, image: &Image, exposure: f32) -> Result<()> {
    file::replace(path, &encode_png(image, exposure)?)
}

/// Returns the bytes that [`write_png`] writes.
///
/// # Errors
/// [`Error::Argument`] if the image is empty.
pub fn encode_png(image: &Image, exposure: f32) -> Result<Vec<u8>> {
    check_not_empty(image)?;
    let scale = exposure.exp2();
    let display: Vec<[u8; 3]> =
        image.pixels.iter().map(|&pixel| color::tone_map(glam::Vec3A::from_array(pixel) * scale)).collect();
    encode_png_rgb8(image.width, image.height, &display)
}

/// Encodes sRGB pixels, `[height * width]` from the top left, as a PNG.
///
/// # Errors
/// [`Error::Argument`] if the size does not match the number of pixels or exceeds PNG's limits.
pub fn encode_png_rgb8(width: usize, height: usize, pixels: &[[u8; 3]]) -> Result<Vec<u8>> {
    let size =
        |length| u32::try_from(length).map_err(|_| Error::argument("image", "more than 2^32 - 1 pixels wide or high"));
    if pixels.is_empty() || pixels.len() != width * height {
        return Err(Error::argument("image", format!("{} pixels for {width} x {height}", pixels.len())));
    }
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Default, FilterType::Adaptive)
        .write_image(pixels.as_flattened(), size(width)?, size(height)?, ExtendedColorType::Rgb8)
        .map_err(|error| Error::argument("image", error.to_string()))?;
    Ok(bytes)
}

fn check_not_empty(image: &Image) -> Result<()> {
    if image.pixels.is_empty() || image.pixels.len() != image.width * image.height {
        let (width, height, pixels) = (image.width, image.height, image.pixels.len());
        return Err(Error::argument("image", format!("{pixels} pixels for {width} x {height}")));
    }
    Ok(())
}

/// Converts a text to OpenEXR's.
fn text(attribute: &str, value: &str) -> Result<Text> {
    Text::new_or_none(value).ok_or_else(|| {
        Error::argument(format!("attribute {attribute}"), "OpenEXR texts are limited to Latin-1 characters")
    })
}

/// Sorts the attributes of a single-layer header by name: the encoder takes them from a hash map, whose order
/// changes from run to run. Offsets in the file stay valid, since the header keeps its length.
pub(super) fn sort_header(bytes: &mut [u8]) {
    const START: usize = 8;
    let mut attributes = Vec::new();
    let mut at = START;
    while bytes[at] != 0 {
        let start = at;
        for _ in ["name", "type"] {
            at += bytes[at..].iter().position(|&byte| byte == 0).expect("the encoder ends its texts") + 1;
        }
        let size = u32::from_le_bytes(*bytes[at..].first_chunk().expect("the encoder writes sizes"));
        at += 4 + size as usize;
        attributes.push(bytes[start..at].to_vec());
    }
    attributes.sort();
    bytes[START..at].copy_from_slice(&attributes.concat());
}
