//! Reading Radiance pictures (`#?RADIANCE`, `#?RGBE`), with headers and resolution strings as defined
//! by Radiance.
//!
//! `EXPOSURE` and `COLORCORR`, which may be repeated, are divided out. `PRIMARIES` other than Rec.709
//! are converted; all zeros mean none. All eight orientations of scan lines and both line endings
//! (LF, CR LF) are read.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use glam::{DMat3, DVec3};

use super::conversion::{Conversion, Transfer};
use super::primaries::{self, Primaries};
use super::rgbe;
use super::size::check_size;
use super::{Image, Picture};
use crate::error::{Error, Result};
use crate::remark::Remark;

/// Maximum length of a header, in bytes.
const MAX_HEADER: usize = 1 << 20;

/// Number of bytes that are read at most: twice the uncompressed size of the largest image.
const MAX_BYTES: u64 = 1 << 30;

/// Nested runs could code any row in a few bytes. Actual writers reach about a thousand pixels per byte
/// for a constant picture.
const MOST_PIXELS_PER_BYTE: u64 = 1 << 12;

/// Whether a file with this start is a Radiance picture, by its first line or, for old programs, by its
/// format.
pub(super) fn is_radiance(start: &[u8]) -> bool {
    start.starts_with(b"#?") || start.split(|&byte| byte == b'\n').any(|line| line.starts_with(b"FORMAT=32-bit_rle_"))
}

/// Reads the open `file` of `file_size` bytes; `path` is for messages.
pub(super) fn read(path: &Path, file: File, file_size: u64) -> Result<Picture> {
    let mut bytes = Vec::new();
    file.take(MAX_BYTES).read_to_end(&mut bytes).map_err(|source| Error::io(path, source))?;
    let mut rest: &[u8] = &bytes;
    let header = Header::read(&mut rest).map_err(|reason| Error::invalid(path, "header", reason))?;
    let resolution = next_line(&mut rest).and_then(|line| Resolution::parse(&line));
    let resolution = resolution.map_err(|reason| Error::invalid(path, "resolution", reason))?;
    let Resolution { lines, length, .. } = resolution;
    let (width, height) = resolution.size();
    check_size(path, "dimensions", width, height)?;
    let least = (least_line_bytes(length) * lines as u64).max((width * height) as u64 / MOST_PIXELS_PER_BYTE);
    if file_size < least {
        let reason = format!("{width} x {height} pixels take at least {least} bytes, the file has {file_size}");
        return Err(Error::invalid(path, "dimensions", reason));
    }
    let conversion = header.conversion().map_err(|reason| Error::invalid(path, "header", reason))?;
    let (factors, matrix, mut remarks) = conversion;
    let mut image = Image::black(width, height);
    let mut line = vec![[0; 4]; length];
    for number in 0..lines {
        rgbe::read_line(&mut rest, &mut line)
            .map_err(|reason| Error::invalid(path, "pixels", format!("{reason} (line {number} of {lines})")))?;
        for (k, &pixel) in line.iter().enumerate() {
            let values = DVec3::from(rgbe::to_linear(pixel).map(f64::from));
            image.pixels[resolution.index(number, k)] = (factors * values).to_array().map(|value| value as f32);
        }
    }
    let conversion = Conversion { luminance: None, transfer: Transfer::Linear, matrix };
    let repair = conversion.apply(&mut image, false, &mut remarks);
    Ok(Picture { image, layout: None, remarks, repair, is_converted: conversion.is_needed() })
}

/// The entries of a header that affect values.
struct Header {
    /// The product of all exposures and colour corrections, by which the stored radiance is multiplied.
    scale: [f64; 3],
    primaries: Option<Primaries>,
    is_xyz: bool,
    gamma: f64,
}

impl Header {
    /// Reads up to the empty line after the header. Errors are clauses, here and below.
    fn read(rest: &mut &[u8]) -> std::result::Result<Self, String> {
        let mut header = Self { scale: [1.0; 3], primaries: None, is_xyz: false, gamma: 1.0 };
        let length = rest.len();
        loop {
            if length - rest.len() > MAX_HEADER {
                return Err(format!("is longer than {MAX_HEADER} bytes"));
            }
            let line = next_line(rest)?;
            if line.is_empty() {
                return Ok(header);
            }
            if let Some((name, value)) = line.split_once('=') {
                header.set(name, value.trim())?;
            }
        }
    }

    fn set(&mut self, name: &str, value: &str) -> std::result::Result<(), String> {
        let numbers = || -> Option<Vec<f64>> { value.split_whitespace().map(|word| word.parse().ok()).collect() };
        let wrong = || Err(format!("{name}={value} cannot be used"));
        let is_factor = |x: &f64| *x > 0.0 && x.is_finite();
        match name {
            "FORMAT" => match value {
                "32-bit_rle_rgbe" => {}
                "32-bit_rle_xyze" => self.is_xyz = true,
                _ => return Err(format!("FORMAT={value} is neither 32-bit_rle_rgbe nor 32-bit_rle_xyze")),
            },
            "EXPOSURE" => match numbers().as_deref() {
                Some([factor]) if is_factor(factor) => self.scale = self.scale.map(|scale| scale * factor),
                _ => return wrong(),
            },
            "COLORCORR" => match numbers().as_deref() {
                Some([r, g, b]) if [r, g, b].into_iter().all(is_factor) => {
                    for (scale, factor) in self.scale.iter_mut().zip([r, g, b]) {
                        *scale *= factor;
                    }
                }
                _ => return wrong(),
            },
            "PRIMARIES" => match numbers().as_deref() {
                // Written by programs without knowledge of the primaries.
                Some([]) => {}
                Some(numbers) if numbers.iter().all(|&number| number == 0.0) => {}
                Some(&[rx, ry, gx, gy, bx, by, wx, wy]) => {
                    self.primaries = Some(Primaries { colors: [[rx, ry], [gx, gy], [bx, by]], white: [wx, wy] });
                }
                _ => return wrong(),
            },
            "GAMMA" => match numbers().as_deref() {
                Some([gamma]) if is_factor(gamma) => self.gamma = *gamma,
                _ => return wrong(),
            },
            _ => {}
        }
        Ok(())
    }

    /// The factors from values to radiance and the matrix to Rec.709, and remarks about them.
    fn conversion(&self) -> std::result::Result<(DVec3, Option<DMat3>, Vec<Remark>), String> {
        let mut remarks = Vec::new();
        let factors = DVec3::from(self.scale).recip();
        if self.scale != [1.0; 3] {
            if !factors.is_finite() || factors.min_element() <= 0.0 {
                return Err("the product of its exposures is out of range".into());
            }
            let [r, g, b] = factors.to_array();
            let factors = if r == g && g == b { format!("{r}") } else { format!("{r}, {g}, {b}") };
            remarks.push(Remark::Note(format!("divided out the exposure: multiplied values by {factors}")));
        }
        let matrix = match (self.is_xyz, self.primaries) {
            (true, _) => primaries::radiance_xyz_to_rec_709(),
            (false, Some(primaries)) => primaries.to_rec_709().map_err(|reason| format!("PRIMARIES: {reason}"))?,
            (false, None) => None,
        };
        if matrix.is_some() {
            remarks.push(Remark::Note("converted colours from the primaries of the file to Rec.709".into()));
        }
        if self.gamma != 1.0 {
            let gamma = self.gamma;
            remarks.push(Remark::Warning(format!("ignored GAMMA={gamma}: values are assumed to be linear")));
        }
        Ok((factors, matrix, remarks))
    }
}

/// Takes the next line, without its line ending.
fn next_line(rest: &mut &[u8]) -> std::result::Result<String, String> {
    let end = rest.iter().take(MAX_HEADER).position(|&byte| byte == b'\n').ok_or("the file ends too early")?;
    let line = rest[..end].strip_suffix(b"\r").unwrap_or(&rest[..end]);
    let text = String::from_utf8_lossy(line).into_owned();
    *rest = &rest[end + 1..];
    Ok(text)
}

/// The order of pixels in a file: of lines, and within a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Resolution {
    lines: usize,
    length: usize,
    /// Whether a line is a column of the image.
    is_column: bool,
    /// Whether rows go from bottom to top, and columns from right to left.
    flips: [bool; 2],
}

impl Resolution {
    /// Parses `-Y 512 +X 1024` or one of the other seven forms.
    fn parse(line: &str) -> std::result::Result<Self, String> {
        let wrong = || {
            format!(
                "'{}' is not a size; expected one such as -Y 512 +X 1024",
                line.chars().take(60).collect::<String>().escape_debug()
            )
        };
        let words: Vec<&str> = line.split_whitespace().collect();
        let &[outer, lines, inner, length] = &words[..] else { return Err(wrong()) };
        let count = |word: &str| word.parse::<u32>().map(|count| count as usize).map_err(|_| wrong());
        let (is_column, y, x) = match (outer, inner) {
            ("-Y" | "+Y", "-X" | "+X") => (false, outer, inner),
            ("-X" | "+X", "-Y" | "+Y") => (true, inner, outer),
            _ => return Err(wrong()),
        };
        Ok(Self { lines: count(lines)?, length: count(length)?, is_column, flips: [y == "+Y", x == "-X"] })
    }

    /// Width and height of the image.
    fn size(&self) -> (usize, usize) {
        if self.is_column { (self.lines, self.length) } else { (self.length, self.lines) }
    }

    /// The index in the image of pixel `k` of a line.
    fn index(&self, line: usize, k: usize) -> usize {
        let (width, height) = self.size();
        let (x, y) = if self.is_column { (line, k) } else { (k, line) };
        let y = if self.flips[0] { height - 1 - y } else { y };
        let x = if self.flips[1] { width - 1 - x } else { x };
        y * width + x
    }
}

/// The minimum size of a coded line in bytes: one pixel, then runs of 255, 255 * 256, ... copies, 4
/// bytes each.
fn least_line_bytes(length: usize) -> u64 {
    let (mut bytes, mut covered, mut run) = (4, 1, 255_usize);
    while covered < length {
        bytes += 4;
        covered = covered.saturating_add(run);
        run = run.saturating_mul(256);
    }
    bytes
}
