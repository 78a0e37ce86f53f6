//! Colours of photographs: profiles of PNG and JPEG files are converted, or named in a warning.

use std::borrow::Cow;

use headtail_render::image::{Image, Photograph, srgb_code};
use image::{ExtendedColorType, codecs::jpeg::JpegEncoder};
use moxcms::{ColorProfile, LutDataType, LutStore, LutType, LutWarehouse, Matrix3d, ToneReprCurve};
use png::{BitDepth, ColorType, Info, ScaledFloat, SourceChromaticities, SrgbRenderingIntent};

const RED: [u8; 3] = [230, 40, 40];
/// [`RED`] as a colour of Display P3, in linear Rec.709, by SMPTE EG 432-1 and IEC 61966-2-1.
const RED_OF_P3: [f32; 3] = [0.9645, -0.0111, 0.0061];
/// [`RED`] as a colour of sRGB.
const RED_OF_SRGB: [f32; 3] = [0.7913, 0.0212, 0.0212];

/// Returns a PNG file of one pixel.
fn png(color: ColorType, depth: BitDepth, pixel: &[u8], change: impl Fn(&mut Info)) -> Vec<u8> {
    let mut info = Info::with_size(1, 1);
    (info.color_type, info.bit_depth) = (color, depth);
    change(&mut info);
    let mut bytes = Vec::new();
    let mut writer = png::Encoder::with_info(&mut bytes, info).unwrap().write_header().unwrap();
    writer.write_image_data(pixel).unwrap();
    writer.finish().unwrap();
    bytes
}

fn red(change: impl Fn(&mut Info)) -> Vec<u8> {
    png(ColorType::Rgb, BitDepth::Eight, &RED, change)
}

/// Returns a PNG file with a chunk before its pixels.
fn with_chunk(png: &[u8], name: &[u8; 4], data: &[u8]) -> Vec<u8> {
    // After the signature and IHDR.
    let (start, rest) = png.split_at(8 + 25);
    let named = [name, data].concat();
    let checksum = crc32(&named);
    [start, &(data.len() as u32).to_be_bytes(), &named, &checksum.to_be_bytes(), rest].concat()
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes
        .iter()
        .fold(!0_u32, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ (0xedb8_8320 * (crc & 1))))
}

fn icc(profile: &ColorProfile) -> Cow<'static, [u8]> {
    Cow::Owned(profile.encode().unwrap())
}

/// Returns the first pixel, and the remarks with a `!` before warnings.
fn read(bytes: &[u8]) -> ([f32; 3], Vec<String>) {
    let photograph = Photograph::decode(bytes).unwrap();
    let mark = |remark: &headtail_render::remark::Remark| if remark.is_warning() { "! " } else { "" };
    let said = photograph.remarks.iter().map(|remark| format!("{}{remark}", mark(remark))).collect();
    (photograph.image.pixels[0], said)
}

#[track_caller]
fn assert_near(found: [f32; 3], expected: [f32; 3], tolerance: f32) {
    assert!((0..3).all(|k| (found[k] - expected[k]).abs() <= tolerance), "{found:?}, not {expected:?}");
}

#[test]
fn profiles_of_png_are_converted() {
    let p3 = icc(&ColorProfile::new_display_p3());
    let with_p3 = |info: &mut Info| info.icc_profile = Some(p3.clone());
    let (found, said) = read(&red(with_p3));
    assert_near(found, RED_OF_P3, 1e-3);
    assert!(said[0].starts_with("converted colours from ICC profile 'Display P3'"), "{said:?}");
    assert!(said[1].contains("outside of Rec.709") && said.iter().all(|text| !text.starts_with('!')), "{said:?}");

    let sixteen: Vec<u8> = RED.iter().flat_map(|&code| [code, code]).collect();
    assert_near(read(&png(ColorType::Rgb, BitDepth::Sixteen, &sixteen, with_p3)).0, RED_OF_P3, 1e-3);
    let palette = png(ColorType::Indexed, BitDepth::Two, &[0x40], |info| {
        with_p3(info);
        info.palette = Some(Cow::Owned([[0, 0, 9], RED].concat()));
    });
    assert_near(read(&palette).0, RED_OF_P3, 1e-3);
}

#[test]
fn grey_profiles_are_converted() {
    // 1.8 is not the curve of sRGB: 128 becomes 0.2891 instead of 0.2159.
    let grey = icc(&ColorProfile::new_gray_with_gamma(1.8));
    let with = |info: &mut Info| info.icc_profile = Some(grey.clone());
    let eight = png(ColorType::Grayscale, BitDepth::Eight, &[128], with);
    let sixteen = png(ColorType::Grayscale, BitDepth::Sixteen, &[128, 128], with);
    let alpha = png(ColorType::GrayscaleAlpha, BitDepth::Eight, &[128, 255], with);
    for bytes in [eight, sixteen, alpha] {
        assert_near(read(&bytes).0, [0.2891; 3], 1e-3);
    }
    let (found, said) = read(&red(with));
    assert_near(found, RED_OF_SRGB, 1e-3);
    assert!(said[0].starts_with("! read colours as sRGB") && said[0].contains("grey"), "{said:?}");
}

#[test]
fn the_description_of_highest_precedence_is_applied() {
    let p3 = ScaledChromaticities { red: [0.68, 0.32], green: [0.265, 0.69], white: [0.3127, 0.329] };
    let linear = |info: &mut Info| info.source_gamma = Some(ScaledFloat::new(1.0));
    let wide = |info: &mut Info| info.icc_profile = Some(icc(&ColorProfile::new_bt2020()));
    let plain = red(|_| {});
    let code = |primaries, curve| [primaries, curve, 0, 1];
    // gAMA alone, with cHRM, and cHRM alone, whose curve is that of sRGB.
    let [r, g, _] = RED.map(|code| f32::from(code) / 255.0);
    assert_near(read(&red(linear)).0, [r, g, g], 1e-4);
    let both = read(&red(|info| {
        linear(info);
        info.source_chromaticities = Some(p3.source());
    }));
    assert_near(both.0, [1.2249 * r - 0.2249 * g, 1.042 * g - 0.042 * r, 1.0983 * g - 0.0197 * r - 0.0786 * g], 1e-3);
    assert_near(read(&red(|info| info.source_chromaticities = Some(p3.source()))).0, RED_OF_P3, 1e-3);
    // sRGB before gAMA.
    assert_near(read(&with_chunk(&red(linear), b"sRGB", &[0])).0, RED_OF_SRGB, 1e-3);
    // iCCP before sRGB and gAMA.
    let wide_alone = read(&red(wide)).0;
    assert!((wide_alone[0] - RED_OF_SRGB[0]).abs() > 0.1, "{wide_alone:?}");
    let chunk = with_chunk(&red(wide), b"gAMA", &100_000_u32.to_be_bytes());
    assert_near(read(&with_chunk(&chunk, b"sRGB", &[0])).0, wide_alone, 0.0);
    // cICP before all.
    assert_near(read(&with_chunk(&red(wide), b"cICP", &code(12, 13))).0, RED_OF_P3, 1e-3);
    assert_near(read(&with_chunk(&chunk, b"cICP", &code(1, 13))).0, RED_OF_SRGB, 1e-3);
    assert_near(read(&with_chunk(&plain, b"cICP", &code(1, 8))).0, [r, g, g], 1e-3);
}

/// Chromaticities with the blue of sRGB.
struct ScaledChromaticities {
    red: [f32; 2],
    green: [f32; 2],
    white: [f32; 2],
}

impl ScaledChromaticities {
    fn source(&self) -> SourceChromaticities {
        let of = |[x, y]: [f32; 2]| (x, y);
        SourceChromaticities::new(of(self.white), of(self.red), of(self.green), (0.15, 0.06))
    }
}

/// Codes of sRGB are kept, however the file names it.
#[test]
fn pictures_of_srgb_keep_their_codes_without_a_remark() {
    let table = |code: usize| {
        let x = code as f64 / 1023.0;
        let linear = if x <= 0.040_45 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) };
        (65535.0 * linear + 0.5) as u16
    };
    let mut tables = ColorProfile::new_srgb();
    tables.cicp = None;
    let curve = Some(ToneReprCurve::Lut((0..1024).map(table).collect()));
    (tables.red_trc, tables.green_trc, tables.blue_trc) = (curve.clone(), curve.clone(), curve);
    let srgb = ScaledChromaticities { red: [0.64, 0.33], green: [0.3, 0.6], white: [0.3127, 0.329] };
    for bytes in [
        red(|_| {}),
        red(|info| info.icc_profile = Some(icc(&ColorProfile::new_srgb()))),
        red(|info| info.icc_profile = Some(icc(&tables))),
        red(|info| info.srgb = Some(SrgbRenderingIntent::Perceptual)),
        with_chunk(&red(|_| {}), b"cICP", &[1, 13, 0, 1]),
        red(|info| info.source_gamma = Some(ScaledFloat::new(0.45455))),
        red(|info| {
            info.source_gamma = Some(ScaledFloat::new(0.45455));
            info.source_chromaticities = Some(srgb.source());
        }),
    ] {
        let (found, said) = read(&bytes);
        assert_eq!((found.map(srgb_code), said.len()), (RED, 0), "{said:?}");
    }
}

/// A profile of a table whose corners are linear colours of Display P3, as tristimulus values under D50.
#[test]
fn profiles_of_tables_are_converted() {
    let p3 = ColorProfile::new_display_p3();
    let corners = [p3.red_colorant, p3.green_colorant, p3.blue_colorant].map(|c| [c.x, c.y, c.z]);
    // The first channel varies least. 1 is stored as 32768.
    let node = |k: usize| [4, 2, 1].map(|bit| if k & bit != 0 { 1.0 } else { 0.0 });
    let xyz = |k: usize| [0, 1, 2].map(|c| (0..3).map(|i| node(k)[i] * corners[i][c]).sum::<f64>());
    let table = (0..8).flat_map(xyz).map(|value| (32768.0 * value).round() as u16).collect();
    let identity = || LutStore::Store16([0, 65535].repeat(3));
    let lut = LutDataType {
        num_input_channels: 3,
        num_output_channels: 3,
        num_clut_grid_points: 2,
        matrix: Matrix3d::IDENTITY,
        num_input_table_entries: 2,
        num_output_table_entries: 2,
        input_table: identity(),
        clut_table: LutStore::Store16(table),
        output_table: identity(),
        lut_type: LutType::Lut16,
    };
    let mut profile = p3;
    profile.lut_a_to_b_perceptual = Some(LutWarehouse::Lut(lut));
    let bytes = png(ColorType::Rgb, BitDepth::Eight, &[128, 100, 100], |info| info.icc_profile = Some(icc(&profile)));
    let (found, said) = read(&bytes);
    // By SMPTE EG 432-1; tables of moxcms have 15 bits.
    assert_near(found, [0.5267, 0.3875, 0.3900], 2e-3);
    assert!(said.len() == 1 && said[0].ends_with("clipped to it"), "{said:?}");
}

/// Returns a JPEG file of 16 x 16 equal pixels.
fn jpeg(code: &[u8], color: ExtendedColorType) -> Vec<u8> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, 100).encode(&code.repeat(256), 16, 16, color).unwrap();
    bytes
}

/// Returns a JPEG file with a profile in segments of 100 bytes, in the given order.
fn with_profile(jpeg: &[u8], profile: &[u8], reversed: bool) -> Vec<u8> {
    let parts: Vec<&[u8]> = profile.chunks(100).collect();
    let mut segments: Vec<Vec<u8>> = parts
        .iter()
        .enumerate()
        .map(|(k, part)| {
            let data = [&b"ICC_PROFILE\0"[..], &[k as u8 + 1, parts.len() as u8], part].concat();
            [&[0xff, 0xe2][..], &(data.len() as u16 + 2).to_be_bytes(), &data].concat()
        })
        .collect();
    if reversed {
        segments.reverse();
    }
    [&jpeg[..2], &segments.concat(), &jpeg[2..]].concat()
}

#[test]
fn profiles_of_jpeg_are_converted_from_any_number_of_segments() {
    let red = jpeg(&RED, ExtendedColorType::Rgb8);
    let p3 = icc(&ColorProfile::new_display_p3());
    for reversed in [false, true] {
        let (found, said) = read(&with_profile(&red, &p3, reversed));
        // Codes of JPEG are off by one: 1 % of the value.
        assert_near(found, RED_OF_P3, 0.012);
        assert!(said[0].contains("'Display P3'"), "{said:?}");
    }
    let grey = jpeg(&[128], ExtendedColorType::L8);
    let profile = icc(&ColorProfile::new_gray_with_gamma(1.8));
    assert_near(read(&with_profile(&grey, &profile, false)).0, [0.2891; 3], 0.005);
    // Profiles of three colours apply to grey pictures too.
    let grey_of_p3 = read(&with_profile(&grey, &p3, false)).0;
    assert!(grey_of_p3.iter().all(|value| (value - 0.2159).abs() < 0.005), "{grey_of_p3:?}");
}

#[test]
fn descriptions_that_cannot_be_converted_give_one_warning() {
    let plain = red(|_| {});
    let p3 = icc(&ColorProfile::new_display_p3());
    let jpeg = jpeg(&RED, ExtendedColorType::Rgb8);
    let mut missing = with_profile(&jpeg, &p3, false);
    missing.drain(2..2 + 4 + 14 + 100);
    for (bytes, said) in [
        (with_profile(&jpeg, &p3[..200], false), "ICC profile is damaged"),
        (missing, "parts of its ICC profile are missing"),
        (with_chunk(&plain, b"iCCP", b"P3\0\0not deflate"), "iCCP chunk is damaged"),
        (with_chunk(&plain, b"cICP", &[9, 16, 0, 1]), "cICP 9/16 has an HDR curve"),
        (with_chunk(&plain, b"cICP", &[9, 18, 0, 1]), "cICP 9/18 has an HDR curve"),
        (with_chunk(&plain, b"cICP", &[12, 13, 0, 0]), "a narrow range"),
        (with_chunk(&plain, b"cICP", &[200, 13, 0, 1]), "unknown code points"),
        (with_chunk(&plain, b"cICP", &[12, 13]), "cICP chunk is damaged"),
        (with_chunk(&plain, b"gAMA", &[0; 4]), "gAMA or cHRM chunk is damaged"),
    ] {
        let (found, remarks) = read(&bytes);
        assert_near(found, RED_OF_SRGB, 0.012);
        assert!(remarks.len() == 1 && remarks[0].starts_with("! ") && remarks[0].contains(said), "{said}: {remarks:?}");
    }
}

/// A JPEG of four components whose coefficients are all 0.
#[test]
fn cmyk_pictures_give_a_warning() {
    let grey = jpeg(&[128], ExtendedColorType::L8);
    let at = |marker: u8| grey.windows(2).position(|bytes| bytes == [0xff, marker]).unwrap();
    let components: Vec<u8> = (1..=4).flat_map(|id| [id, 0x11, 0]).collect();
    let frame = [&[0xff, 0xc0, 0, 20, 8, 0, 8, 0, 8, 4][..], &components].concat();
    let tables: Vec<u8> = (1..=4).flat_map(|id| [id, 0]).collect();
    let scan = [&[0xff, 0xda, 0, 14, 4][..], &tables, &[0, 63, 0]].concat();
    // Of the standard tables, 00 is no change of the mean, and 1010 the end of a block.
    let pixels = [0b0010_1000, 0b1010_0010, 0b1000_1010, 0xff, 0xd9];
    // Between the frame and the scan of the grey picture are the tables.
    let middle = &grey[at(0xc0) + 2 + 11..at(0xda)];
    let cmyk = [&grey[..at(0xc0)], &frame, middle, &scan, &pixels].concat();
    let (_, said) = read(&cmyk);
    assert!(said.len() == 1 && said[0].starts_with("! read colours as sRGB: CMYK"), "{said:?}");
}

#[test]
fn photographs_keep_values_that_are_not_radiance() {
    let inf = f32::INFINITY;
    let pixels = vec![[inf, 3.0, 2.0], [-0.5, 0.25, f32::NAN], [1.0; 3], [4.0; 3]];
    let photograph = Photograph::of_radiance(Image { width: 4, height: 1, pixels });
    assert_eq!(photograph.image.pixels[0], [inf, 3.0, 2.0]);
    let light = |x: f32| photograph.sample(glam::Vec2::new(x, 0.5)).unwrap().to_array();
    assert_eq!((light(0.5), light(1.5)), ([4.0, 3.0, 2.0], [0.0, 0.25, 0.0]));
    assert_eq!(photograph.resized(2, 1).image.pixels[0], [1.75, 1.625, 1.0]);
    let said: Vec<&str> = photograph.remarks.iter().map(headtail_render::remark::Remark::text).collect();
    for word in ["infinite", "negative", "NaN"] {
        assert!(said.iter().any(|text| text.contains(word)), "{said:?}");
    }
}
