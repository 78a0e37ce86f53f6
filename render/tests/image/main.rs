//! Reading and writing of images: exact round trips, all forms of OpenEXR that maps use, colour spaces, and
//! hostile files.

mod color_spaces;
mod hostile;
mod openexr;
mod unusual;

use std::path::{Path, PathBuf};

use exr::prelude::{
    AnyChannel, AnyChannels, AttributeValue as ExrValue, Blocks, Encoding, FlatSamples, Layer, LayerAttributes,
    LevelMaps, Levels, LineOrder, Text, Vec2, WritableImage, f16,
};
use glam::Vec3A;
use headtail_render::Error;
use headtail_render::color::tone_map;
use headtail_render::image::{
    Attribute, Image, MAX_PIXELS, encode_exr, encode_png, read_radiance, write_exr, write_png,
};
use headtail_render::random::{Purpose, Stream};

/// Returns an image of values that 16-bit floats represent exactly, so that every sample type is lossless.
fn picture(width: usize, height: usize) -> Image {
    let pixel = |i: usize| [i as f32 * 0.5, (i % 7) as f32 - 3.0, 1024.0 + (i % 64) as f32];
    Image { width, height, pixels: (0..width * height).map(pixel).collect() }
}

fn write(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

/// Returns the samples of one colour of an image.
fn channel(image: &Image, colour: usize) -> Vec<f32> {
    image.pixels.iter().map(|pixel| pixel[colour]).collect()
}

/// Returns an uncompressed Radiance file of RGBE pixels.
fn hdr_file(width: usize, height: usize, rgbe: &[[u8; 4]]) -> Vec<u8> {
    let mut bytes = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n").into_bytes();
    bytes.extend_from_slice(rgbe.as_flattened());
    bytes
}

#[test]
fn hdr_is_read_flat_and_run_length_coded_independently_of_its_name() {
    let folder = tempfile::tempdir().unwrap();
    // 2^(136 - 136) * mantissa = mantissa.
    let rgbe = [[10, 20, 30, 136], [1, 2, 3, 136], [0, 0, 0, 0], [128, 64, 32, 129]];
    let expected = [[10.0, 20.0, 30.0], [1.0, 2.0, 3.0], [0.0; 3], [1.0, 0.5, 0.25]];
    let read = read_radiance(&write(folder.path(), "wrong_name.exr", &hdr_file(2, 2, &rgbe))).unwrap();
    assert_eq!(read, Image { width: 2, height: 2, pixels: expected.to_vec() });

    // New run-length coding: marker, width, then each component as runs (count + 128).
    let mut coded = b"#?RGBE\n# comment\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 8\n".to_vec();
    coded.extend([2, 2, 0, 8]);
    for component in [10, 20, 30, 136] {
        coded.extend([128 + 8, component]);
    }
    let read = read_radiance(&write(folder.path(), "a.hdr", &coded)).unwrap();
    assert_eq!(read, Image { width: 8, height: 1, pixels: vec![[10.0, 20.0, 30.0]; 8] });
}

#[test]
fn hdr_written_by_the_image_crate_is_read_to_its_precision() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = Stream::new(7, Purpose::Test, 0);
    let mut image = Image::black(64, 16);
    for pixel in &mut image.pixels {
        *pixel = [0; 3].map(|_| 1000.0 * random.uniform().powi(4));
    }
    let pixels: Vec<_> = image.pixels.iter().map(|&pixel| image::Rgb(pixel)).collect();
    let mut bytes = Vec::new();
    image::codecs::hdr::HdrEncoder::new(&mut bytes).encode(&pixels, 64, 16).unwrap();
    let read = read_radiance(&write(folder.path(), "a.hdr", &bytes)).unwrap();
    for (a, b) in read.pixels.iter().zip(&image.pixels) {
        // A shared 8-bit mantissa: at most one unit of 1/128 of the largest channel.
        let unit = b[0].max(b[1]).max(b[2]) / 128.0;
        assert!((0..3).all(|c| (a[c] - b[c]).abs() <= unit), "{a:?} {b:?}");
    }
}

#[test]
fn tone_map_is_monotonic_and_neutral_and_highlights_nan() {
    assert_eq!(tone_map(Vec3A::ZERO), [0; 3]);
    assert_eq!(tone_map(Vec3A::splat(8.0)), [255; 3]);
    assert_eq!(tone_map(Vec3A::splat(f32::INFINITY)), [255; 3]);
    assert_eq!(tone_map(Vec3A::new(-1.0, -2.0, -3.0)), [0; 3]);
    assert_eq!(tone_map(Vec3A::new(0.2, f32::NAN, 0.2)), [255, 0, 255]);
    let mut last = 0;
    for i in 0..1000 {
        let [r, g, b] = tone_map(Vec3A::splat(i as f32 * 0.01));
        assert!(r == g && g == b && r >= last);
        last = r;
    }
    // A saturated bright colour fades towards white but keeps its hue.
    let [r, g, b] = tone_map(Vec3A::new(20.0, 1.0, 0.2));
    assert!(r == 255 && g > 128 && g >= b, "{r} {g} {b}");
    // A dark colour keeps its ratios, up to the 8 bits.
    assert_eq!(tone_map(Vec3A::new(0.05, 0.0, 0.0))[1], 0);
}

#[test]
fn png_holds_the_tone_mapped_pixels_and_is_deterministic() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let image = Image { width: 3, height: 1, pixels: vec![[0.1, 0.2, 0.4], [4.0; 3], [0.0; 3]] };
    write_png(&path, &image, 1.0).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!(bytes, encode_png(&image, 1.0).unwrap());
    let read = image::load_from_memory(&bytes).unwrap().into_rgb8();
    let expected: Vec<u8> = image.pixels.iter().flat_map(|&p| tone_map(Vec3A::from_array(p) * 2.0)).collect();
    assert_eq!(read.into_raw(), expected);
    assert!(encode_png(&Image::black(0, 0), 0.0).is_err());
}

#[test]
fn writing_replaces_whole_files_and_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    write_exr(&path, &picture(4, 4), &[]).unwrap();
    write_exr(&path, &picture(5, 5), &[]).unwrap();
    assert_eq!(read_radiance(&path).unwrap(), picture(5, 5));
    assert!(write_exr(&path, &Image::black(0, 0), &[]).is_err());
    assert_eq!(read_radiance(&path).unwrap(), picture(5, 5), "a failed write must not touch the old file");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    let nowhere = folder.path().join("no/such/folder.exr");
    let error = write_exr(&nowhere, &picture(1, 1), &[]).unwrap_err();
    assert!(matches!(error, Error::Io { .. }) && error.to_string().contains("folder.exr"));
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let plain = write(folder.path(), "plain", b"");
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&path), mode(&plain), "a result is as readable as any new file");
    }
}

/// Returns the folder of real maps, if this machine has it.
fn real_maps() -> Option<PathBuf> {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .map(|folder| folder.join("shared/data/envmaps"))
        .find(|folder| folder.is_dir())
}

#[test]
fn real_maps_are_read_whole() {
    let Some(folder) = real_maps() else {
        println!("no shared/data/envmaps above {}: real maps are not tested", env!("CARGO_MANIFEST_DIR"));
        return;
    };
    let mut read = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if !matches!(path.extension().and_then(|e| e.to_str()), Some("hdr" | "exr")) {
            continue;
        }
        let image = read_radiance(&path).unwrap();
        let width = if path.ends_with("StageEnvLatLong.exr") { 1000 } else { 1024 };
        assert_eq!((image.width, image.height), (width, width / 2), "{}", path.display());
        let sum: f64 = image.pixels.iter().flatten().map(|&v| f64::from(v)).sum();
        assert!(sum.is_finite() && sum > 0.0, "{}", path.display());
        // No row is black, so every block was placed.
        assert!(image.pixels.chunks(width).all(|row| row.iter().flatten().any(|&v| v != 0.0)), "{}", path.display());
        read += 1;
    }
    assert!(read > 0);
}
