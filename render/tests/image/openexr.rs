//! All forms of OpenEXR that maps use.

use super::*;

/// Returns an OpenEXR file of named channels.
pub fn exr_file(size: (usize, usize), encoding: Encoding, channels: Vec<(&str, Levels<FlatSamples>)>) -> Vec<u8> {
    let channels = channels.into_iter().map(|(name, levels)| AnyChannel::new(name, levels)).collect();
    let layer = Layer::new(size, LayerAttributes::default(), encoding, AnyChannels::sort(channels));
    let mut bytes = std::io::Cursor::new(Vec::new());
    exr::prelude::Image::from_layer(layer).write().non_parallel().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

pub fn flat(samples: FlatSamples) -> Levels<FlatSamples> {
    Levels::Singular(samples)
}

pub fn f32_channels(image: &Image) -> Vec<(&'static str, Levels<FlatSamples>)> {
    ["R", "G", "B"].into_iter().enumerate().map(|(c, name)| (name, flat(FlatSamples::F32(channel(image, c))))).collect()
}

pub fn scan_lines(compression: exr::prelude::Compression) -> Encoding {
    Encoding { compression, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing }
}

pub fn tiles(width: usize, height: usize) -> Encoding {
    Encoding {
        compression: exr::prelude::Compression::ZIP16,
        blocks: Blocks::Tiles(Vec2(width, height)),
        line_order: LineOrder::Unspecified,
    }
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
    // NaN is not equal to itself, so its bits are compared.
    image.pixels[7][1] = f32::NAN;
    write_exr(&path, &image, &[]).unwrap();
    assert_eq!(read_radiance(&path).unwrap().pixels[7][1].to_bits(), f32::NAN.to_bits());
}

#[test]
fn exr_attributes_are_readable_and_bytes_are_deterministic() {
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
    // DWAA is lossy: this only tests that it is decoded.
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
