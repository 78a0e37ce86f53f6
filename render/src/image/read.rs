//! Reading radiance maps, whatever the file is called: the first bytes tell the format.

use std::io::{Read, Seek};
use std::path::Path;

use super::{Image, openexr, radiance, without_panic};
use crate::error::{Error, Result};
use crate::file::open_regular;

/// Reads a Radiance (.hdr) or OpenEXR (.exr) file as linear RGB.
///
/// The values are those of the file: NaN, infinite and negative ones stay, because what to do about them depends on the
/// use. Colours are taken as Rec.709 and a Radiance `EXPOSURE` line is not applied. See `openexr` and `radiance` for
/// what is read of each format.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read or is none, but a folder, a pipe or a device; [`Error::Invalid`], naming the field, if it is neither format, is damaged,
/// holds no colour, or has more than [`super::MAX_PIXELS`] pixels. No content of a file makes this function panic
/// (unless panics abort).
pub fn read_radiance(path: &Path) -> Result<Image> {
    let failed = |source| Error::io(path, source);
    let (mut file, file_size) = open_regular(path).map_err(failed)?;
    let mut magic = Vec::with_capacity(4);
    file.by_ref().take(4).read_to_end(&mut magic).map_err(failed)?;
    file.rewind().map_err(failed)?;
    if magic == openexr::MAGIC {
        checked(path, || openexr::read(path, file, file_size))
    } else if magic.starts_with(radiance::MAGIC) {
        checked(path, || radiance::read(path, file, file_size))
    } else if magic.is_empty() {
        Err(Error::invalid(path, "first bytes", "the file is empty"))
    } else {
        Err(Error::invalid(path, "first bytes", "neither a Radiance (.hdr) nor an OpenEXR (.exr) file"))
    }
}

/// Turns a panic of a decoder into an error.
///
/// What headers and blocks promise is checked before, and the tests' damaged files never get here in a release build. But deep inside
/// compressed blocks the decoders count on well-formed data: with overflow checks on, B44 blocks of `exr` 1.74 that end too early do panic.
fn checked(path: &Path, read: impl FnOnce() -> Result<Image>) -> Result<Image> {
    without_panic(read).unwrap_or_else(|| Err(Error::invalid(path, "pixels", "they are damaged")))
}
