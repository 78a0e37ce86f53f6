//! Colours of PNG and JPEG files: ICC profiles, and PNG's `cICP`, `gAMA` and `cHRM`.
//!
//! Of several descriptions in a PNG file, `cICP` takes precedence over `iCCP`, then `sRGB`, then `gAMA` with
//! `cHRM` (PNG, third edition, 4.3). The crate moxcms converts; what it cannot convert is read as sRGB.

use std::io::Cursor;

use image::{DynamicImage, ImageDecoder, codecs::jpeg::JpegDecoder};
use moxcms::{
    Chromaticity, CicpColorPrimaries, CicpProfile, ColorPrimaries, ColorProfile, DataColorSpace, Layout,
    MatrixCoefficients, ProfileText, RenderingIntent, ToneReprCurve, TransferCharacteristics, TransformF32Executor,
    TransformOptions,
};
use rayon::prelude::*;

use super::without_panic;
use crate::{
    color::{srgb_decode, srgb_encode},
    remark::Remark,
};

/// Pixels that are converted at once.
const BLOCK: usize = 1 << 12;

/// The exponent that stands for the curve of sRGB in files of programs that cannot state the curve.
const SRGB_GAMMA: f32 = 0.454_55;

/// Red, green, blue and white of sRGB.
const SRGB_CHROMATICITIES: [Chromaticity; 4] = [
    Chromaticity { x: 0.64, y: 0.33 },
    Chromaticity { x: 0.3, y: 0.6 },
    Chromaticity { x: 0.15, y: 0.06 },
    Chromaticity::D65,
];

/// A description of colours, and the words for it.
struct Described {
    profile: ColorProfile,
    name: String,
}

impl Described {
    fn new(profile: ColorProfile, name: impl Into<String>) -> Self {
        Self { profile, name: name.into() }
    }
}

/// Converts codes to linear Rec.709; `bytes` is the file. Codes of files without a description, or with one
/// of sRGB, are decoded as sRGB. The remark names a conversion, or a description that cannot be applied.
pub(super) fn linear_pixels(decoded: DynamicImage, bytes: &[u8]) -> (Vec<[f32; 3]>, Option<Remark>) {
    let is_colored = decoded.color().has_color();
    let transform = without_panic(|| match description(bytes)? {
        Some(described) => Transform::new(&described.profile, is_colored).map(|found| Some((found?, described.name))),
        None => Ok(None),
    });
    let transform = transform.unwrap_or_else(|| Err("the profile is damaged".into()));
    let mut codes = codes(decoded);
    let reason = match transform {
        Ok(None) => None,
        Err(reason) => Some(reason),
        Ok(Some((transform, name))) => match transform.apply(&codes) {
            Some(pixels) => {
                let limit = if transform.is_coded { ", clipped to it" } else { "" };
                return (pixels, Some(Remark::Note(format!("converted colours from {name} to Rec.709{limit}"))));
            }
            None => Some(format!("{name} gives colours that are not numbers")),
        },
    };
    codes.par_iter_mut().flatten().for_each(|value| *value = srgb_decode(*value));
    (codes, reason.map(|reason| Remark::Warning(format!("read colours as sRGB: {reason}"))))
}

/// Returns codes in `[0, 1]`.
fn codes(decoded: DynamicImage) -> Vec<[f32; 3]> {
    let channels = u16::from(decoded.color().channel_count());
    if decoded.color().bits_per_pixel() == 16 * channels {
        decoded.into_rgb16().pixels().map(|pixel| pixel.0.map(|code| f32::from(code) / 65535.0)).collect()
    } else {
        decoded.into_rgb8().pixels().map(|pixel| pixel.0.map(|code| f32::from(code) / 255.0)).collect()
    }
}

/// A conversion of codes to linear Rec.709.
struct Transform {
    transform: std::sync::Arc<TransformF32Executor>,
    is_grey: bool,
    /// Whether it ends at codes of sRGB.
    is_coded: bool,
}

impl Transform {
    /// Creates the transform of a profile; `None` for that of sRGB.
    fn new(profile: &ColorProfile, is_colored: bool) -> Result<Option<Self>, String> {
        let is_grey = match profile.color_space {
            DataColorSpace::Rgb => false,
            DataColorSpace::Gray if is_colored => return Err("its profile is for grey images".into()),
            DataColorSpace::Gray => true,
            other => return Err(format!("profiles of {other:?} colours cannot be converted")),
        };
        // Tables end at codes, which have more values in the dark than linear ones.
        let is_coded = profile.lut_a_to_b_perceptual.is_some() || profile.lut_a_to_b_colorimetric.is_some();
        let mut to = ColorProfile::new_srgb();
        if !is_coded {
            to.cicp = None;
            let linear = Some(ToneReprCurve::Lut(Vec::new()));
            (to.red_trc, to.green_trc, to.blue_trc) = (linear.clone(), linear.clone(), linear);
        }
        let from = if is_grey { Layout::Gray } else { Layout::Rgb };
        let with = |rendering_intent| {
            let options = TransformOptions {
                rendering_intent,
                allow_extended_range_rgb_xyz: true,
                ..TransformOptions::default()
            };
            profile.create_transform_f32(from, &to, Layout::Rgb, options)
        };
        let transform = with(RenderingIntent::Perceptual).or_else(|_| with(RenderingIntent::RelativeColorimetric));
        let transform = transform.map_err(|error| format!("its profile cannot be converted ({error})"))?;
        let made = Self { transform, is_grey, is_coded };
        Ok(if made.is_srgb() { None } else { Some(made) })
    }

    /// Returns the linear colours of codes; `None` if any is not finite.
    fn apply(&self, codes: &[[f32; 3]]) -> Option<Vec<[f32; 3]>> {
        let mut pixels = vec![[0.0; 3]; codes.len()];
        let blocks = pixels.par_chunks_mut(BLOCK).zip(codes.par_chunks(BLOCK));
        blocks.map(|(to, from)| without_panic(|| self.convert(from, to)).flatten()).collect::<Option<()>>()?;
        Some(pixels)
    }

    fn convert(&self, from: &[[f32; 3]], to: &mut [[f32; 3]]) -> Option<()> {
        let done = if self.is_grey {
            let grey: Vec<f32> = from.iter().map(|pixel| pixel[0]).collect();
            self.transform.transform(&grey, to.as_flattened_mut())
        } else {
            self.transform.transform(from.as_flattened(), to.as_flattened_mut())
        };
        if self.is_coded {
            to.iter_mut().flatten().for_each(|value| *value = srgb_decode(*value));
        }
        done.ok().filter(|()| to.iter().flatten().all(|value| value.is_finite()))
    }

    /// Whether no 8-bit code of a grid and of greys changes.
    fn is_srgb(&self) -> bool {
        let grid = (0..6_usize.pow(3)).map(|k| [k % 6, k / 6 % 6, k / 36].map(|code| code as f32 / 5.0));
        let codes: Vec<[f32; 3]> = grid.chain((0..256).map(|code| [code as f32 / 255.0; 3])).collect();
        let is_same = |(code, linear): (&f32, &f32)| (code - srgb_encode(*linear)).abs() < 0.5 / 255.0;
        let is_inside = |linear: &f32| (-1e-3..=1.001).contains(linear);
        self.apply(&codes).is_some_and(|linear| {
            let linear = linear.as_flattened();
            linear.iter().all(is_inside) && codes.as_flattened().iter().zip(linear).all(is_same)
        })
    }
}

/// Finds the description of colours in a file; `None` if it is absent or sRGB by name. The error is a clause.
fn description(bytes: &[u8]) -> Result<Option<Described>, String> {
    if bytes.starts_with(b"\x89PNG") { of_png(bytes) } else { of_jpeg(bytes) }
}

fn of_jpeg(bytes: &[u8]) -> Result<Option<Described>, String> {
    let (mut has_profile, mut components) = (false, 0);
    for (marker, data) in jpeg_segments(bytes) {
        match marker {
            0xe2 => has_profile |= data.starts_with(b"ICC_PROFILE\0"),
            0xc0..=0xc3 | 0xc5..=0xc7 | 0xc9..=0xcb | 0xcd..=0xcf => components = data.get(5).copied().unwrap_or(0),
            _ => {}
        }
    }
    match (has_profile, components) {
        (_, 4) => Err("CMYK colours have no conversion without a printer; convert the file to sRGB".into()),
        (false, _) => Ok(None),
        (true, _) => {
            let profile = JpegDecoder::new(Cursor::new(bytes)).ok().and_then(|mut jpeg| jpeg.icc_profile().ok()?);
            of_icc(&profile.ok_or("parts of its ICC profile are missing")?).map(Some)
        }
    }
}

/// Returns the marker and the data of each segment before the pixels.
fn jpeg_segments(bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    let mut rest = bytes.get(2..).unwrap_or_default();
    std::iter::from_fn(move || {
        // Markers may be preceded by fill bytes.
        while let [0xff, 0xff, ..] = rest {
            rest = &rest[1..];
        }
        let &[0xff, marker, high, low, ..] = rest else { return None };
        let end = 2 + usize::from(u16::from_be_bytes([high, low]));
        let data = rest.get(4..end).filter(|_| marker != 0xda)?;
        rest = &rest[end..];
        Some((marker, data))
    })
}

fn of_png(bytes: &[u8]) -> Result<Option<Described>, String> {
    let reader = png::Decoder::new(Cursor::new(bytes)).read_info().map_err(|error| error.to_string())?;
    let info = reader.info();
    let has = |name: &[u8; 4]| png_chunks(bytes).any(|chunk| chunk == *name);
    if let Some(cicp) = info.coding_independent_code_points {
        return of_cicp(cicp);
    }
    if has(b"cICP") {
        return Err("its cICP chunk is damaged".into());
    }
    if let Some(profile) = &info.icc_profile {
        return of_icc(profile).map(Some);
    }
    if has(b"iCCP") {
        return Err("its iCCP chunk is damaged".into());
    }
    if info.srgb.is_some() {
        return Ok(None);
    }
    let gamma = info.gama_chunk.map(png::ScaledFloat::into_value);
    if (gamma.is_none() && has(b"gAMA")) || (info.chrm_chunk.is_none() && has(b"cHRM")) {
        return Err("its gAMA or cHRM chunk is damaged".into());
    }
    let at = |(x, y): (png::ScaledFloat, png::ScaledFloat)| Chromaticity { x: x.into_value(), y: y.into_value() };
    let stated = info.chrm_chunk.map(|stated| [stated.red, stated.green, stated.blue, stated.white].map(at));
    let is_near = |(a, b): (Chromaticity, Chromaticity)| (a.x - b.x).abs() < 1e-3 && (a.y - b.y).abs() < 1e-3;
    // With the primaries of sRGB, the exponent stands for its curve, within the error that libpng tolerates.
    if stated.is_none_or(|stated| stated.into_iter().zip(SRGB_CHROMATICITIES).all(is_near))
        && gamma.is_none_or(|gamma| (gamma / SRGB_GAMMA - 1.0).abs() < 0.05)
    {
        return Ok(None);
    }
    let mut profile = ColorProfile::new_srgb();
    profile.cicp = None;
    if let Some([red, green, blue, white]) = stated {
        profile.update_rgb_colorimetry(white.to_xyyb(), ColorPrimaries { red, green, blue });
    }
    if let Some(gamma) = gamma {
        let curve = Some(ToneReprCurve::Parametric(vec![1.0 / gamma]));
        (profile.red_trc, profile.green_trc, profile.blue_trc) = (curve.clone(), curve.clone(), curve);
    }
    Ok(Some(Described::new(profile, "gAMA and cHRM")))
}

/// Returns the names of chunks before the pixels.
fn png_chunks(bytes: &[u8]) -> impl Iterator<Item = [u8; 4]> {
    let mut rest = bytes.get(8..).unwrap_or_default();
    std::iter::from_fn(move || {
        let (length, after) = rest.split_first_chunk::<4>()?;
        let name = *after.first_chunk::<4>()?;
        // Length, name and checksum.
        rest = rest.get((u32::from_be_bytes(*length) as usize).checked_add(12)?..).unwrap_or_default();
        Some(name).filter(|name| name != b"IDAT")
    })
}

fn of_cicp(cicp: png::CodingIndependentCodePoints) -> Result<Option<Described>, String> {
    let (primaries, transfer) = (cicp.color_primaries, cicp.transfer_function);
    let name = format!("cICP {primaries}/{transfer}");
    let unusable = |what: &str| Err(format!("{name} has {what}, which cannot be converted"));
    if !cicp.is_video_full_range_image {
        return unusable("a narrow range");
    }
    let known = CicpColorPrimaries::try_from(primaries).ok().zip(TransferCharacteristics::try_from(transfer).ok());
    let Some((color_primaries, transfer_characteristics)) = known else { return unusable("unknown code points") };
    if matches!(transfer_characteristics, TransferCharacteristics::Smpte2084 | TransferCharacteristics::Hlg) {
        return unusable("an HDR curve");
    }
    let matrix_coefficients = MatrixCoefficients::Identity;
    let code = CicpProfile { color_primaries, transfer_characteristics, matrix_coefficients, full_range: true };
    let profile = ColorProfile::new_from_cicp(code);
    if profile.is_matrix_shaper() { Ok(Some(Described::new(profile, name))) } else { unusable("unknown code points") }
}

fn of_icc(bytes: &[u8]) -> Result<Described, String> {
    let profile =
        ColorProfile::new_from_slice(bytes).map_err(|error| format!("its ICC profile is damaged ({error})"))?;
    let title = match &profile.description {
        Some(ProfileText::PlainString(text)) => text.as_str(),
        Some(ProfileText::Localizable(texts)) => texts.first().map_or("", |text| &text.value),
        Some(ProfileText::Description(text)) => &text.ascii_string,
        None => "",
    };
    let title: String = title.chars().take(60).collect();
    let name = format!("ICC profile '{}'", title.trim_end_matches('\0').escape_debug());
    Ok(Described::new(profile, name))
}
