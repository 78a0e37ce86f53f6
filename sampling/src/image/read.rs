//! Reading radiance maps, with the format detected from the first bytes.

use std::fs::File;
use std::io::{Read, Seek};
use std::path::Path;

#[cfg(feature = "exr")]
use super::openexr;
use super::{Image, MapLayout, Repair, radiance, without_panic};
use crate::error::{Error, Result};
use crate::file::open_regular;
use crate::remark::Remark;

/// The first bytes of every OpenEXR file.
const OPENEXR: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];
/// Number of bytes read to detect the format.
const MAGIC_BYTES: u64 = 4096;

/// The format of a file, by its first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// OpenEXR.
    OpenExr,
    /// Radiance.
    Radiance,
    /// PNG.
    Png,
    /// JPEG.
    Jpeg,
    /// Any other.
    Other,
}

impl Format {
    /// Detects the format of a file.
    ///
    /// # Errors
    /// If the file cannot be read, is empty, or is a Git LFS pointer.
    pub fn of(path: &Path) -> Result<Self> {
        open(path).map(|(.., format)| format)
    }
}

/// Opens a file; returns its size and format too.
fn open(path: &Path) -> Result<(File, u64, Format)> {
    let failed = |source| Error::io(path, source);
    let (mut file, size) = open_regular(path).map_err(failed)?;
    let mut start = Vec::new();
    file.by_ref().take(MAGIC_BYTES).read_to_end(&mut start).map_err(failed)?;
    file.rewind().map_err(failed)?;
    let refused = |reason| Err(Error::invalid(path, "first bytes", reason));
    let format = match &start[..] {
        [] => return refused("the file is empty"),
        start if start.starts_with(b"version https://git-lfs") => {
            return refused("is a Git LFS pointer; run `git lfs pull` to fetch the file");
        }
        start if start.starts_with(&OPENEXR) => Format::OpenExr,
        start if radiance::is_radiance(start) => Format::Radiance,
        start if start.starts_with(b"\x89PNG") => Format::Png,
        [0xff, 0xd8, ..] => Format::Jpeg,
        _ => Format::Other,
    };
    Ok((file, size, format))
}

/// The content of a radiance file.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Linear Rec.709 values. NaN, infinite and negative values are kept unless the file's colours were
    /// converted, since their handling depends on the use.
    pub image: Image,
    /// The layout of directions in the picture, if the file has one.
    pub layout: Option<MapLayout>,
    /// Remarks on conversions and choices.
    pub remarks: Vec<Remark>,
    /// The values of the image that are not radiance.
    pub repair: Repair,
    /// Whether colours were converted from another colour space.
    pub is_converted: bool,
}

/// Reads a Radiance (.hdr) or OpenEXR (.exr) file as linear Rec.709; see [`read_picture`].
///
/// # Errors
/// As [`read_picture`].
pub fn read_radiance(path: &Path) -> Result<Image> {
    read_picture(path, None).map(|picture| picture.image)
}

/// Reads a Radiance (.hdr) or OpenEXR (.exr) file.
///
/// Colours of other primaries are converted to Rec.709, the exposure and the colour correction of a
/// Radiance header are divided out, and the display window of an OpenEXR file is read. `layer` is the
/// name of a layer of an OpenEXR file, or the end of it; by default R, G and B are read, or else the
/// layer with a usual name of a picture.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read or is a folder, a pipe or a device; [`Error::Invalid`],
/// naming the field, if it has neither format, is damaged, holds no colour or no such layer, or has
/// more than [`super::MAX_PIXELS`] pixels. No content of a file makes this function panic (unless
/// panics abort).
pub fn read_picture(path: &Path, layer: Option<&str>) -> Result<Picture> {
    let (file, size, format) = open(path)?;
    match (format, layer) {
        #[cfg(feature = "exr")]
        (Format::OpenExr, layer) => checked(path, || openexr::read(path, file, size, layer)),
        #[cfg(not(feature = "exr"))]
        (Format::OpenExr, _) => Err(Error::invalid(
            path,
            "first bytes",
            "is an OpenEXR file, and this build reads Radiance files only: give the texels, or enable the feature exr",
        )),
        (Format::Radiance, None) => checked(path, || radiance::read(path, file, size)),
        (Format::Radiance, Some(layer)) => {
            Err(Error::invalid(path, "layers", format!("a Radiance file has none, nor '{layer}'")))
        }
        (Format::Png | Format::Jpeg | Format::Other, _) => {
            Err(Error::invalid(path, "first bytes", "neither a Radiance (.hdr) nor an OpenEXR (.exr) file"))
        }
    }
}

/// Turns a panic of a decoder into an error.
///
/// Sizes in headers and blocks are checked before, and the tests' damaged files do not panic in a
/// release build. But inside compressed blocks, decoders assume well-formed data: with overflow checks,
/// truncated B44 blocks panic in `exr` 1.74.
fn checked(path: &Path, read: impl FnOnce() -> Result<Picture>) -> Result<Picture> {
    without_panic(read).unwrap_or_else(|| Err(Error::invalid(path, "pixels", "they are damaged")))
}
