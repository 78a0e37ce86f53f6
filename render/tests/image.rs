//! Reading and writing of images: exact round trips, every form of OpenEXR that maps come in, and hostile files.

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

/// An image of values that 16-bit floats hold exactly, so that every sample type must give it back.
fn picture(width: usize, height: usize) -> Image {
    let pixel = |i: usize| [i as f32 * 0.5, (i % 7) as f32 - 3.0, 1024.0 + (i % 64) as f32];
    Image { width, height, pixels: (0..width * height).map(pixel).collect() }
}

fn write(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

/// The samples of one colour of an image.
fn channel(image: &Image, colour: usize) -> Vec<f32> {
    image.pixels.iter().map(|pixel| pixel[colour]).collect()
}

/// An OpenEXR file of named channels.
fn exr_file(size: (usize, usize), encoding: Encoding, channels: Vec<(&str, Levels<FlatSamples>)>) -> Vec<u8> {
    let channels = channels.into_iter().map(|(name, levels)| AnyChannel::new(name, levels)).collect();
    let layer = Layer::new(size, LayerAttributes::default(), encoding, AnyChannels::sort(channels));
    let mut bytes = std::io::Cursor::new(Vec::new());
    exr::prelude::Image::from_layer(layer).write().non_parallel().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

fn flat(samples: FlatSamples) -> Levels<FlatSamples> {
    Levels::Singular(samples)
}

fn f32_channels(image: &Image) -> Vec<(&'static str, Levels<FlatSamples>)> {
    ["R", "G", "B"].into_iter().enumerate().map(|(c, name)| (name, flat(FlatSamples::F32(channel(image, c))))).collect()
}

fn scan_lines(compression: exr::prelude::Compression) -> Encoding {
    Encoding { compression, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing }
}

fn tiles(width: usize, height: usize) -> Encoding {
    Encoding {
        compression: exr::prelude::Compression::ZIP16,
        blocks: Blocks::Tiles(Vec2(width, height)),
        line_order: LineOrder::Unspecified,
    }
}

/// An uncompressed Radiance file of RGBE pixels.
fn hdr_file(width: usize, height: usize, rgbe: &[[u8; 4]]) -> Vec<u8> {
    let mut bytes = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n").into_bytes();
    bytes.extend_from_slice(rgbe.as_flattened());
    bytes
}

#[test]
fn exr_round_trip_keeps_every_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let mut image = picture(37, 19);
    image.pixels[5] = [f32::MIN_POSITIVE, f32::MAX, -0.0];
    image.pixels[6] = [f32::INFINITY, f32::NEG_INFINITY, 1e-42];
    write_exr(&path, &image, &[]).unwrap();
    assert_eq!(read_radiance(&path).unwrap(), image);
    // NaN compares unequal to itself, so its bits are compared.
    image.pixels[7][1] = f32::NAN;
    write_exr(&path, &image, &[]).unwrap();
    assert_eq!(read_radiance(&path).unwrap().pixels[7][1].to_bits(), f32::NAN.to_bits());
}

#[test]
fn exr_attributes_are_found_by_any_reader_and_bytes_are_deterministic() {
    let attributes = [
        Attribute::new("headtail.sampler", "mis"),
        Attribute::new("headtail.spp", 64),
        Attribute::new("headtail.seconds", 1.25_f64),
        Attribute::new("headtail.exposure", 0.5_f32),
        Attribute::new("headtail.seed", u64::MAX.to_string()),
    ];
    let image = picture(8, 8);
    let bytes = encode_exr(&image, &attributes).unwrap();
    for _ in 0..20 {
        assert_eq!(encode_exr(&image, &attributes).unwrap(), bytes);
    }
    let meta = exr::meta::MetaData::read_from_buffered(bytes.as_slice(), true).unwrap();
    let other = &meta.headers[0].own_attributes.other;
    let get = |name: &str| other.get(&Text::new_or_panic(name)).cloned().unwrap();
    assert_eq!(get("headtail.sampler"), ExrValue::Text("mis".into()));
    assert_eq!(get("headtail.spp"), ExrValue::I32(64));
    assert_eq!(get("headtail.seconds"), ExrValue::F64(1.25));
    assert_eq!(get("headtail.exposure"), ExrValue::F32(0.5));
    assert_eq!(get("headtail.seed"), ExrValue::Text("18446744073709551615".into()));
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(read_radiance(&write(folder.path(), "a.exr", &bytes)).unwrap(), image);
}

#[test]
fn exr_attributes_that_the_format_forbids_are_refused() {
    let image = picture(2, 2);
    let refused = |attributes: &[Attribute]| matches!(encode_exr(&image, attributes), Err(Error::Argument { .. }));
    assert!(refused(&[Attribute::new("", 1)]));
    assert!(refused(&[Attribute::new("channels", "mine")]));
    assert!(refused(&[Attribute::new("version", "0.1.0")]));
    assert!(refused(&[Attribute::new("name", "\u{2603}")]));
    assert!(refused(&[Attribute::new("x".repeat(256), 1)]));
    assert!(refused(&[Attribute::new("twice", 1), Attribute::new("twice", 1)]));
    assert!(encode_exr(&Image::black(0, 3), &[]).is_err());
}

#[test]
fn every_sample_type_channel_order_and_compression_is_read() {
    use exr::prelude::Compression::{DWAA, PIZ, RLE, Uncompressed, ZIP1, ZIP16};
    let folder = tempfile::tempdir().unwrap();
    let image = picture(33, 21);
    let (red, green) = (channel(&image, 0), channel(&image, 1));
    let blue: Vec<u32> = channel(&image, 2).iter().map(|&b| b as u32).collect();
    for compression in [Uncompressed, RLE, ZIP1, ZIP16, PIZ] {
        for with_alpha in [false, true] {
            let mut channels = vec![
                ("B", flat(FlatSamples::U32(blue.clone()))),
                ("G", flat(FlatSamples::F32(green.clone()))),
                ("R", flat(FlatSamples::F16(red.iter().map(|&r| f16::from_f32(r)).collect()))),
            ];
            if with_alpha {
                channels.push(("A", flat(FlatSamples::F16(vec![f16::ONE; image.pixels.len()]))));
            }
            let bytes = exr_file((33, 21), scan_lines(compression), channels);
            let read = read_radiance(&write(folder.path(), "a.exr", &bytes)).unwrap();
            assert_eq!(read, image, "{compression:?}, alpha {with_alpha}");
        }
    }
    // DWAA is lossy: only that it is decoded is asked.
    let bytes = exr_file((33, 21), scan_lines(DWAA(None)), f32_channels(&image));
    assert_eq!(read_radiance(&write(folder.path(), "a.exr", &bytes)).unwrap().width, 33);
}

#[test]
fn tiles_and_the_largest_level_of_mip_maps_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let image = picture(50, 30);
    let bytes = exr_file((50, 30), tiles(16, 8), f32_channels(&image));
    assert_eq!(read_radiance(&write(folder.path(), "tiled.exr", &bytes)).unwrap(), image);

    // Smaller levels hold -1, which must not appear.
    let mip = |colour: usize| Levels::Mip {
        rounding_mode: exr::math::RoundingMode::Down,
        level_data: exr::meta::mip_map_levels(exr::math::RoundingMode::Down, Vec2(50, 30))
            .map(|(level, size)| {
                FlatSamples::F32(if level == 0 { channel(&image, colour) } else { vec![-1.0; size.area()] })
            })
            .collect::<LevelMaps<FlatSamples>>(),
    };
    let bytes = exr_file((50, 30), tiles(16, 8), vec![("R", mip(0)), ("G", mip(1)), ("B", mip(2))]);
    assert_eq!(read_radiance(&write(folder.path(), "mip.exr", &bytes)).unwrap(), image);
}

#[test]
fn layer_prefixes_lower_case_and_luminance_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let image = picture(9, 5);
    let named = |r: &'static str, g: &'static str, b: &'static str| {
        let channels = [r, g, b].into_iter().enumerate();
        channels.map(|(c, name)| (name, flat(FlatSamples::F32(channel(&image, c))))).collect::<Vec<_>>()
    };
    let zip = scan_lines(exr::prelude::Compression::ZIP16);
    let mut prefixed = named("beauty.R", "beauty.G", "beauty.B");
    prefixed.push(("Z", flat(FlatSamples::F32(vec![7.0; 45]))));
    prefixed.push(("albedo.R", flat(FlatSamples::F32(vec![7.0; 45]))));
    for channels in [prefixed, named("r", "g", "b"), named("a.b.R", "a.b.G", "a.b.B")] {
        let bytes = exr_file((9, 5), zip, channels);
        assert_eq!(read_radiance(&write(folder.path(), "a.exr", &bytes)).unwrap(), image);
    }
    let bytes = exr_file((9, 5), zip, vec![("Y", flat(FlatSamples::F32(channel(&image, 0))))]);
    let grey = read_radiance(&write(folder.path(), "y.exr", &bytes)).unwrap();
    assert!(grey.pixels.iter().zip(&image.pixels).all(|(a, b)| *a == [b[0]; 3]));
}

#[test]
fn missing_channels_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let zip = scan_lines(exr::prelude::Compression::ZIP16);
    let samples = || flat(FlatSamples::F32(vec![0.0; 4]));
    let bytes = exr_file((2, 2), zip, vec![("R", samples()), ("G", samples()), ("Z", samples())]);
    let error = read_radiance(&write(folder.path(), "a.exr", &bytes)).unwrap_err().to_string();
    assert!(error.contains("a.exr: channels: found only G, R, Z"), "{error}");
}

#[test]
fn hdr_is_read_flat_and_run_length_coded_whatever_its_name() {
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
fn hdr_written_by_the_image_crate_comes_back_to_its_precision() {
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
fn what_is_not_a_map_gets_one_sentence_with_file_and_field() {
    let folder = tempfile::tempdir().unwrap();
    let message = |name: &str, bytes: &[u8]| {
        let error = read_radiance(&write(folder.path(), name, bytes)).unwrap_err().to_string();
        assert!(error.contains(name) && !error.contains('\n'), "{error}");
        error
    };
    assert!(message("empty.hdr", b"").contains("the file is empty"));
    assert!(message("text.hdr", b"hello, world").contains("first bytes"));
    assert!(message("short.exr", &[0x76, 0x2f, 0x31]).contains("first bytes"));
    assert!(message("magic.exr", &[0x76, 0x2f, 0x31, 0x01]).contains("header: the file ends too early"));
    assert!(message("magic.hdr", b"#?RADIANCE").contains("header"));
    assert!(message("size.hdr", &hdr_file(0, 4, &[])).contains("dimensions: 0 x 4 pixels"));
    assert!(message("huge.hdr", &hdr_file(4_000_000, 1_000, &[])).contains("dimensions: 4000000 x 1000"));
    assert!(message("promise.hdr", &hdr_file(8192, 4096, &[])).contains("take at least 49152 bytes"));
    assert!(message("cut.hdr", &hdr_file(4, 4, &[[9; 4]; 15])).contains("pixels: the file ends too early"));
    assert!(message("flipped.hdr", b"#?RADIANCE\n\n+Y 2 +X 2\n0123456789abcdef").contains("header"));
    let missing = read_radiance(&folder.path().join("missing.hdr")).unwrap_err();
    assert!(matches!(missing, Error::Io { .. }) && missing.to_string().contains("missing.hdr"));
    assert!(matches!(read_radiance(folder.path()), Err(Error::Io { .. })));
}

#[cfg(unix)]
#[test]
fn pipes_devices_and_folders_are_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    // Nobody writes to the pipe: opening it would wait for ever.
    let pipe = folder.path().join("pipe.hdr");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    for (path, word) in [
        (pipe.as_path(), "pipe.hdr: it is a pipe or a device"),
        (Path::new("/dev/zero"), "/dev/zero: it is a pipe or a device"),
        (folder.path(), ": it is a folder"),
    ] {
        let error = read_radiance(path).unwrap_err();
        assert!(matches!(error, Error::Io { .. }) && error.to_string().contains(word), "{error}");
    }
}

/// The position of a header attribute's value in a file.
fn attribute_value(bytes: &[u8], name_and_type: &[u8]) -> usize {
    let start = bytes.windows(name_and_type.len()).position(|window| window == name_and_type).unwrap();
    start + name_and_type.len() + 4
}

#[test]
fn exr_headers_that_promise_too_much_are_refused_before_allocation() {
    let folder = tempfile::tempdir().unwrap();
    let image = picture(16, 16);
    let files = [exr_file((16, 16), tiles(8, 8), f32_channels(&image)), encode_exr(&image, &[]).unwrap()];
    for bytes in files {
        let window = attribute_value(&bytes, b"dataWindow\0box2i\0");
        for last in [i32::MAX, i32::MAX - 1, 1 << 30, 1 << 20, 1 << 15] {
            let mut damaged = bytes.clone();
            for at in [window + 8, window + 12] {
                damaged[at..at + 4].copy_from_slice(&last.to_le_bytes());
            }
            let error = read_radiance(&write(folder.path(), "a.exr", &damaged)).unwrap_err().to_string();
            assert!(error.contains("dataWindow") || error.contains("header"), "{last}: {error}");
        }
    }
    // More than the limit, whatever the file's size.
    let mut damaged = encode_exr(&picture(16, 1), &[]).unwrap();
    let window = attribute_value(&damaged, b"dataWindow\0box2i\0");
    damaged[window + 8..window + 12].copy_from_slice(&(MAX_PIXELS as i32).to_le_bytes());
    let error = read_radiance(&write(folder.path(), "a.exr", &damaged)).unwrap_err().to_string();
    assert!(error.contains("dataWindow: 134217729 x 1 pixels"), "{error}");

    // A single tile, whose number does not change when it grows.
    let mut damaged = exr_file((16, 16), tiles(16, 16), f32_channels(&image));
    let tile = attribute_value(&damaged, b"tiles\0tiledesc\0");
    for at in [tile, tile + 4] {
        damaged[at..at + 4].copy_from_slice(&(1_i32 << 14).to_le_bytes());
    }
    let error = read_radiance(&write(folder.path(), "a.exr", &damaged)).unwrap_err().to_string();
    assert!(error.contains("tiles: a block of pixels is larger"), "{error}");
}

/// Small valid files of both formats, every coding among them.
fn small_files() -> Vec<(String, Vec<u8>)> {
    use exr::prelude::Compression::{B44, DWAA, PIZ, PXR24, RLE, Uncompressed, ZIP1, ZIP16};
    let image = picture(12, 9);
    let half = |c: usize| flat(FlatSamples::F16(channel(&image, c).iter().map(|&v| f16::from_f32(v)).collect()));
    let halves = || vec![("R", half(0)), ("G", half(1)), ("B", half(2))];
    let mut files: Vec<(String, Vec<u8>)> = [Uncompressed, RLE, ZIP1, ZIP16, PIZ, PXR24, B44, DWAA(None)]
        .into_iter()
        .map(|compression| (format!("{compression:?}"), exr_file((12, 9), scan_lines(compression), halves())))
        .collect();
    files.push(("DWA with every kind of channel".into(), dwa_file(DWAA(None)).0));
    files.push(("tiled".into(), exr_file((12, 9), tiles(5, 4), f32_channels(&image))));
    files.push(("flat hdr".into(), hdr_file(3, 2, &[[3, 4, 5, 129]; 6])));
    let pixels: Vec<_> = image.pixels.iter().map(|&pixel| image::Rgb(pixel)).collect();
    let mut coded = Vec::new();
    image::codecs::hdr::HdrEncoder::new(&mut coded).encode(&pixels, 12, 9).unwrap();
    files.push(("coded hdr".into(), coded));
    files
}

#[test]
fn files_cut_anywhere_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in small_files() {
        // Every length of small files, and 2000 of large ones.
        for length in (0..bytes.len()).step_by(1 + bytes.len() / 2000) {
            let path = write(folder.path(), "cut", &bytes[..length]);
            assert!(read_radiance(&path).is_err(), "{name} cut to {length} of {} bytes is taken as whole", bytes.len());
        }
    }
}

#[test]
fn damaged_files_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = Stream::new(1, Purpose::Test, 0);
    let mut below = |bound: usize| (random.uniform() as f64 * bound as f64) as usize;
    for (name, bytes) in small_files() {
        // Every byte of the header region set to the values that break sizes and signs, then random damage of several bytes.
        let mut cases = Vec::new();
        for at in 0..bytes.len().min(600) {
            for value in [0, 0x7f, 0x80, 0xff] {
                cases.push(vec![(at, value)]);
            }
        }
        for _ in 0..1000 {
            cases.push((0..1 + below(4)).map(|_| (below(bytes.len()), below(256) as u8)).collect());
        }
        for case in cases {
            let mut damaged = bytes.clone();
            for &(at, value) in &case {
                damaged[at] = value;
            }
            let path = write(folder.path(), "damaged", &damaged);
            let outcome = std::panic::catch_unwind(|| read_radiance(&path).map(drop));
            assert!(outcome.is_ok(), "{name} panics with bytes {case:?}");
        }
    }
}

/// A file of two DWA blocks with every kind of channel (cosines, run lengths, others), and where the blocks' counters start.
fn dwa_file(compression: exr::prelude::Compression) -> (Vec<u8>, Vec<usize>) {
    let rows = compression.scan_lines_per_block();
    let image = picture(64, 2 * rows);
    let half = |c: usize| flat(FlatSamples::F16(channel(&image, c).iter().map(|&v| f16::from_f32(v)).collect()));
    let alpha = flat(FlatSamples::F16(vec![f16::ONE; image.pixels.len()]));
    let depth = flat(FlatSamples::F32(channel(&image, 0)));
    let channels = vec![("R", half(0)), ("G", half(1)), ("B", half(2)), ("A", alpha), ("Z", depth)];
    let bytes = exr_file((64, 2 * rows), scan_lines(compression), channels);
    let number = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
    // The table of two offsets ends where the first block is. A block starts with its row and its length, 4 bytes each.
    let table = (8..bytes.len() - 16).find(|&at| number(at) == at + 16).unwrap();
    let counters = vec![number(table) + 8, number(table + 8) + 8];
    (bytes, counters)
}

#[test]
fn dwa_blocks_that_promise_too_much_are_refused_before_allocation() {
    use exr::prelude::Compression::{DWAA, DWAB};
    let folder = tempfile::tempdir().unwrap();
    for compression in [DWAA(None), DWAB(None)] {
        let (bytes, blocks) = dwa_file(compression);
        assert_eq!(read_radiance(&write(folder.path(), "a.exr", &bytes)).unwrap().width, 64);
        for start in blocks {
            // Counters 1 to 9 are sizes; 0 is the version, 10 how cosines are coded.
            for counter in 0..11 {
                for value in [0, 1, 5, 1 << 10, 1 << 20, 1 << 31, 1 << 41, i64::MAX as u64, u64::MAX] {
                    let mut damaged = bytes.clone();
                    let at = start + 8 * counter;
                    damaged[at..at + 8].copy_from_slice(&value.to_le_bytes());
                    let read = read_radiance(&write(folder.path(), "a.exr", &damaged));
                    if (1..10).contains(&counter) && value >= 1 << 20 {
                        let error = read.unwrap_err().to_string();
                        assert!(error.contains("a.exr: pixels: ") && !error.contains('\n'), "{error}");
                    }
                }
            }
        }
    }
}

#[test]
fn tone_map_is_monotonic_neutral_and_shows_what_is_not_a_number() {
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
    // A dark one is left alone: its ratios stay, up to the 8 bits.
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

/// The folder of real maps, if this machine has it.
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
        // No row is left black: every block was placed.
        assert!(image.pixels.chunks(width).all(|row| row.iter().flatten().any(|&v| v != 0.0)), "{}", path.display());
        read += 1;
    }
    assert!(read > 0);
}
