//! Colour spaces of OpenEXR files: names, luminance and chroma, and infinite values in other primaries.

use exr::meta::attribute::Chromaticities;
use headtail_render::environment::Environment;

use super::{
    openexr::*,
    unusual::{changed_exr, error, read, said},
    *,
};

/// Returns an OpenEXR file with attributes and chromaticities.
fn stated(image: &Image, attributes: &[(&str, ExrValue)], chromaticities: Option<Chromaticities>) -> Vec<u8> {
    changed_exr(image, |layer, _, stated| {
        *stated = chromaticities;
        let all = attributes.iter().map(|(name, value)| (Text::new_or_panic(name), value.clone()));
        layer.attributes.other.extend(all);
    })
}

fn named(image: &Image, id: &str) -> Vec<u8> {
    stated(image, &[("colorInteropID", ExrValue::Text(id.into()))], None)
}

const REC_2020: Chromaticities = Chromaticities {
    red: Vec2(0.708, 0.292),
    green: Vec2(0.17, 0.797),
    blue: Vec2(0.131, 0.046),
    white: Vec2(0.3127, 0.329),
};

fn one(pixel: [f32; 3]) -> Image {
    Image { width: 1, height: 1, pixels: vec![pixel] }
}

fn assert_near(found: [f32; 3], expected: [f32; 3], tolerance: f32, what: &str) {
    assert!((0..3).all(|k| (found[k] - expected[k]).abs() <= tolerance), "{what}: {found:?}, not {expected:?}");
}

#[test]
fn names_of_linear_spaces_give_the_published_matrices() {
    for (id, red, green) in [
        // ITU-R BT.2087.
        ("lin_rec2020_scene", [1.6605, -0.1246, -0.0182], [-0.5876, 1.1329, -0.1006]),
        // The Academy, with Bradford adaptation.
        ("lin_ap1_scene", [1.7051, -0.1303, -0.0240], [-0.6218, 1.1408, -0.1290]),
        ("lin_ap0_scene", [2.5217, -0.2765, -0.0152], [-1.1341, 1.3727, -0.1532]),
        // SMPTE EG 432-1.
        ("lin_p3d65_scene", [1.2249, -0.0420, -0.0197], [-0.2249, 1.0420, -0.0786]),
        // Adobe RGB (1998) 4.3.
        ("lin_adobergb_scene", [1.3984, 0.0, 0.0], [-0.3984, 1.0, -0.0429]),
        // IEC 61966-2-1.
        ("lin_ciexyzd65_scene", [3.2406, -0.9689, 0.0557], [-1.5372, 1.8758, -0.2040]),
        ("lin_rec709_scene", [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
    ] {
        for (pixel, expected) in [([1.0, 0.0, 0.0], red), ([0.0, 1.0, 0.0], green)] {
            let found = read(&named(&one(pixel), id));
            assert_near(found.image.pixels[0], expected, 1e-3, id);
            let is_converted = id != "lin_rec709_scene";
            assert_eq!((found.is_converted, said(&found).len()), (is_converted, usize::from(is_converted)), "{id}");
        }
    }
}

#[test]
fn names_of_coded_spaces_are_decoded_or_rejected() {
    let half = one([0.5; 3]);
    for (id, expected) in [
        ("srgb_rec709_scene", 0.214_04),
        ("srgb_p3d65_scene", 0.214_04),
        ("srgb_rec709_display", 0.214_04),
        ("g18_rec709_scene", 0.287_17),
        ("g22_ap1_scene", 0.217_64),
        ("g22_adobergb_scene", 0.217_76),
        ("g24_rec709_display", 0.189_46),
    ] {
        // Grey stays grey in all of them.
        assert_near(read(&named(&half, id)).image.pixels[0], [expected; 3], 2e-4, id);
    }
    for id in ["pq_rec2020_display", "hlg_rec2020_display"] {
        assert!(error(&named(&half, id)).contains(&format!("colorInteropID: {id}")), "{id}");
    }
}

#[test]
fn other_names_and_contradictions_give_one_warning() {
    let red = one([1.0, 0.0, 0.0]);
    let id = |id: &str| ("colorInteropID", ExrValue::Text(id.into()));
    let aces = || ("acesImageContainerFlag", ExrValue::I32(1));
    let ap0 = [2.5217, -0.2765, -0.0152];
    let rec_2020 = [1.6605, -0.1246, -0.0182];
    for (attributes, chromaticities, expected, warning) in [
        (vec![id("data")], Some(REC_2020), [1.0, 0.0, 0.0], Some("data names no known colours")),
        (vec![id("unknown")], None, [1.0, 0.0, 0.0], Some("as linear Rec.709")),
        (vec![id("unknown")], Some(REC_2020), rec_2020, Some("by their chromaticities")),
        (vec![id("studio:camera_a")], None, [1.0, 0.0, 0.0], Some("studio:camera_a names no known colours")),
        (vec![id("log_rec709_scene")], None, [1.0, 0.0, 0.0], Some("log_rec709_scene names no known")),
        // The name takes precedence.
        (vec![id("lin_ap0_scene")], Some(REC_2020), ap0, Some("ignored the chromaticities")),
        (vec![id("lin_rec2020_scene")], Some(REC_2020), rec_2020, None),
        (vec![aces()], None, ap0, None),
        (vec![aces(), id("lin_ap1_scene")], None, ap0, Some("ignored colorInteropID lin_ap1_scene")),
    ] {
        let found = read(&stated(&red, &attributes, chromaticities));
        assert_near(found.image.pixels[0], expected, 1e-3, &format!("{attributes:?}"));
        let warnings: Vec<String> = said(&found).into_iter().filter(|text| text.starts_with('!')).collect();
        assert!(warnings.len() == usize::from(warning.is_some()), "{attributes:?}: {warnings:?}");
        assert!(warning.is_none_or(|text| warnings[0].contains(text)), "{warnings:?}");
    }
}

#[test]
fn luminance_and_chroma_become_colors_by_the_primaries_of_the_file() {
    // Red, green and blue of luminance 1 in Rec.709 and in Rec.2020 (ITU-R BT.2020: 0.2627, 0.6780, 0.0593).
    for (chromaticities, weights) in [(None, [0.2126, 0.7152, 0.0722]), (Some(REC_2020), [0.2627, 0.678, 0.0593])] {
        let colors = [[2.0, 1.0, 0.5], [0.0, 0.0, 0.0], [0.25, 0.25, 0.25], [0.1, 0.0, 3.0]];
        let luminance = |c: [f32; 3]| weights[0] * c[0] + weights[1] * c[1] + weights[2] * c[2];
        let chroma = |c: [f32; 3], k: usize| if luminance(c) > 0.0 { c[k] / luminance(c) - 1.0 } else { 0.0 };
        let samples = |of: &dyn Fn([f32; 3]) -> f32| flat(FlatSamples::F32(colors.iter().map(|&c| of(c)).collect()));
        let channels = vec![
            AnyChannel::new("BY", samples(&|c| chroma(c, 2))),
            AnyChannel::new("RY", samples(&|c| chroma(c, 0))),
            AnyChannel::new("Y", samples(&luminance)),
        ];
        let encoding = scan_lines(exr::prelude::Compression::ZIP16);
        let channels = AnyChannels::sort(channels.into());
        let mut file =
            exr::prelude::Image::from_layer(Layer::new((4, 1), LayerAttributes::default(), encoding, channels));
        file.attributes.chromaticities = chromaticities;
        let mut bytes = std::io::Cursor::new(Vec::new());
        file.write().non_parallel().to_buffered(&mut bytes).unwrap();
        let found = read(&bytes.into_inner());
        let plain = Image { width: 4, height: 1, pixels: colors.to_vec() };
        let expected = read(&stated(&plain, &[], chromaticities)).image;
        for (found, expected) in found.image.pixels.iter().zip(&expected.pixels) {
            // Weights have four digits.
            assert_near(*found, *expected, 2e-3, "luminance and chroma");
        }
        assert!(said(&found)[0].contains("luminance and chroma"));
    }
}

#[test]
fn incomplete_and_subsampled_chroma_is_rejected_by_name() {
    let zip = scan_lines(exr::prelude::Compression::ZIP16);
    let samples = || flat(FlatSamples::F32(vec![0.5; 4]));
    assert!(error(&exr_file((2, 2), zip, vec![("RY", samples()), ("Y", samples())])).contains("RY and BY"));
    let half = exr_file((2, 2), zip, vec![("BY", samples()), ("RY", samples()), ("Y", samples())]);
    // The sampling of BY: name, type, four bytes, then x and y.
    let at = half.windows(3).position(|bytes| bytes == b"BY\0").unwrap() + 3 + 4 + 4;
    let mut half = half;
    (half[at], half[at + 4]) = (2, 2);
    let message = error(&half);
    assert!(message.contains("subsampl"), "{message}");
}

#[test]
fn infinite_suns_of_other_primaries_keep_their_color() {
    let folder = tempfile::tempdir().unwrap();
    let open = |pixels: &[[f32; 3]]| {
        let image = Image { width: pixels.len(), height: 1, pixels: pixels.to_vec() };
        let path = write(folder.path(), "sun.exr", &stated(&image, &[], Some(REC_2020)));
        let map = Environment::open(path.to_str().unwrap()).unwrap();
        let warnings: Vec<String> = map.remarks().iter().filter(|r| r.is_warning()).map(ToString::to_string).collect();
        (map.to_image().pixels, warnings)
    };
    // The largest usable value is 8: the sun is 8, 3, 2 and 8, 8, 8 in Rec.2020.
    let inf = f32::INFINITY;
    let (pixels, warnings) = open(&[[inf, 3.0, 2.0], [inf; 3], [1.0, 8.0, 1.0], [1e30, 1.0, 1.0]]);
    assert_near(pixels[0], [11.376, 2.385, 1.791], 2e-3, "a red sun");
    assert_near(pixels[1], [8.0; 3], 1e-3, "a white sun");
    assert!(pixels[3][0] > 12.0 && pixels[3][0] < 13.0, "{pixels:?}");
    assert!(
        warnings[0].starts_with("5 channel values were infinite or above 1e15 and were replaced by 8,"),
        "{warnings:?}"
    );
    // The colours 1, 8, 1 and 8, 1, 1 are outside of Rec.709, which is another remark.
    assert!(
        warnings.len() == 2 && warnings[1].contains("became negative in the conversion to Rec.709"),
        "{warnings:?}"
    );
    // Negative values of the file itself.
    let (_, warnings) = open(&[[-3.0, 0.1, 0.1], [1.0; 3]]);
    assert!(warnings.len() == 1 && warnings[0].contains("were negative"), "{warnings:?}");
    // A colour of Rec.709, stored in Rec.2020: rounding is no remark.
    let (pixels, warnings) = open(&[[0.6274, 0.0691, 0.0164], [1.0; 3]]);
    assert_near(pixels[0], [1.0, 0.0, 0.0], 2e-4, "red");
    assert!(warnings.is_empty() && pixels[0].iter().all(|value| *value >= 0.0), "{warnings:?}");
}
