//! Unusual but valid files: each is read as its format defines, with remarks about the decisions.

use exr::meta::attribute::{Chromaticities, EnvironmentMap, IntegerBounds};
use headtail_render::environment::Environment;
use headtail_render::image::{MapLayout, Picture, read_picture};

use super::{openexr::*, *};

/// Returns the texts of remarks, with a `!` before warnings.
pub fn said(picture: &Picture) -> Vec<String> {
    let mark = |remark: &headtail_render::remark::Remark| if remark.is_warning() { "! " } else { "" };
    picture.remarks.iter().map(|remark| format!("{}{}", mark(remark), remark.text())).collect()
}

/// Returns an OpenEXR file of an image with a changed header.
pub fn changed_exr(
    image: &Image,
    change: impl Fn(&mut Layer<AnyChannels<Levels<FlatSamples>>>, &mut IntegerBounds, &mut Option<Chromaticities>),
) -> Vec<u8> {
    let channels = f32_channels(image).into_iter().map(|(name, levels)| AnyChannel::new(name, levels)).collect();
    let encoding = scan_lines(exr::prelude::Compression::ZIP16);
    let layer =
        Layer::new((image.width, image.height), LayerAttributes::default(), encoding, AnyChannels::sort(channels));
    let mut file = exr::prelude::Image::from_layer(layer);
    let attributes = &mut file.attributes;
    change(&mut file.layer_data, &mut attributes.display_window, &mut attributes.chromaticities);
    let mut bytes = std::io::Cursor::new(Vec::new());
    file.write().non_parallel().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

pub fn read(bytes: &[u8]) -> Picture {
    let folder = tempfile::tempdir().unwrap();
    read_picture(&write(folder.path(), "a", bytes), None).unwrap()
}

pub fn error(bytes: &[u8]) -> String {
    let folder = tempfile::tempdir().unwrap();
    read_picture(&write(folder.path(), "a", bytes), None).unwrap_err().to_string()
}

#[test]
fn the_image_is_the_display_window() {
    let data = picture(4, 3);
    // Position of the data, then position and size of the display window.
    for (place, origin, size) in [
        ((2, 1), (0, 0), (8, 6)),
        ((-1, -2), (0, 0), (8, 6)),
        ((6, 5), (0, 0), (8, 6)),
        ((5, 5), (4, 4), (2, 2)),
        ((-3, 7), (-5, 6), (9, 5)),
        ((100, 100), (0, 0), (3, 3)),
    ] {
        let bytes = changed_exr(&data, |layer, display, _| {
            layer.attributes.layer_position = Vec2(place.0, place.1);
            *display = IntegerBounds { position: Vec2(origin.0, origin.1), size: Vec2(size.0, size.1) };
        });
        let found = read(&bytes);
        assert_eq!((found.image.width, found.image.height), size);
        for y in 0..size.1 {
            for x in 0..size.0 {
                let (u, v) = (x as i32 + origin.0 - place.0, y as i32 + origin.1 - place.1);
                let is_inside = (0..4).contains(&u) && (0..3).contains(&v);
                let expected = if is_inside { data.pixels[v as usize * 4 + u as usize] } else { [0.0; 3] };
                assert_eq!(found.image.pixels[y * size.0 + x], expected, "{place:?} in {origin:?} {size:?}: {x}, {y}");
            }
        }
        assert!(said(&found)[0].starts_with("placed the 4x3 data window"));
    }
    assert!(said(&read(&changed_exr(&data, |_, _, _| {}))).is_empty());
    let huge = changed_exr(&data, |_, display, _| display.size = Vec2(1 << 20, 1 << 10));
    assert!(error(&huge).contains("displayWindow"));
}

#[test]
fn colors_of_other_primaries_become_rec_709() {
    // Tristimulus values of the Rec.709 white, which must be read as white.
    let image = Image { width: 2, height: 1, pixels: vec![[0.950_456, 1.0, 1.089_058]; 2] };
    let of = |x: f32, y: f32| Vec2(x, y);
    let xyz =
        Chromaticities { red: of(1.0, 0.0), green: of(0.0, 1.0), blue: of(0.0, 0.0), white: of(1.0 / 3.0, 1.0 / 3.0) };
    let found = read(&changed_exr(&image, |_, _, chromaticities| *chromaticities = Some(xyz)));
    for value in found.image.pixels.iter().flatten() {
        // The white is known to four digits.
        assert!((value - 1.0).abs() < 1e-3, "{value}");
    }
    assert!(said(&found)[0].contains("from the primaries of the file"));
    // Rec.709 primaries change no bit.
    let own =
        Chromaticities { red: of(0.64, 0.33), green: of(0.3, 0.6), blue: of(0.15, 0.06), white: of(0.3127, 0.329) };
    assert_eq!(read(&changed_exr(&image, |_, _, chromaticities| *chromaticities = Some(own))).image, image);
    let line = Chromaticities { green: of(0.64, 0.33), ..own };
    assert!(
        error(&changed_exr(&image, |_, _, chromaticities| *chromaticities = Some(line))).contains("chromaticities")
    );
}

#[test]
fn half_precision_infinity_becomes_the_largest_value_of_a_map() {
    let values = [f16::INFINITY, f16::NEG_INFINITY, f16::NAN, f16::ONE];
    let channels = ["R", "G", "B"].map(|name| (name, flat(FlatSamples::F16(values.to_vec()))));
    let bytes = exr_file((4, 1), scan_lines(exr::prelude::Compression::ZIP1), channels.into());
    // The reader keeps values, for photographs.
    let [bright, dark, nan, one] = [0, 1, 2, 3].map(|k| read(&bytes).image.pixels[k][0]);
    assert!(bright == f32::INFINITY && dark == f32::NEG_INFINITY && nan.is_nan() && one == 1.0);
    let folder = tempfile::tempdir().unwrap();
    let map = Environment::open(write(folder.path(), "half.exr", &bytes).to_str().unwrap()).unwrap();
    assert_eq!(map.to_image().pixels[..4], [[65504.0; 3], [0.0; 3], [0.0; 3], [1.0; 3]]);
    let said: Vec<&str> =
        map.remarks().iter().filter(|remark| remark.is_warning()).map(headtail_render::remark::Remark::text).collect();
    assert!(
        said.iter().any(|text| text.contains("3 channel values were infinite and were replaced by 65504")),
        "{said:?}"
    );
}

#[test]
fn the_layer_of_light_is_found_by_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let layers = |names: &[&str]| {
        let channel = |(k, name): (usize, &&str)| AnyChannel::new(*name, flat(FlatSamples::F32(vec![k as f32; 4])));
        let channels = names.iter().enumerate().map(channel).collect();
        let encoding = scan_lines(exr::prelude::Compression::ZIP16);
        let layer = Layer::new((2, 2), LayerAttributes::default(), encoding, AnyChannels::sort(channels));
        let mut bytes = std::io::Cursor::new(Vec::new());
        exr::prelude::Image::from_layer(layer).write().non_parallel().to_buffered(&mut bytes).unwrap();
        write(folder.path(), "layers.exr", &bytes.into_inner())
    };
    let first = |names: &[&str], layer: Option<&str>| read_picture(&layers(names), layer);
    let rgb = |name: &str| ["R", "G", "B"].map(|colour| format!("{name}.{colour}"));
    let names = |layers: &[&str]| layers.iter().flat_map(|layer| rgb(layer)).collect::<Vec<_>>();
    let blender = names(&["View.AO", "View.Combined", "View.DiffCol"]);
    let blender: Vec<&str> = blender.iter().map(String::as_str).collect();
    let found = first(&blender, None).unwrap();
    assert_eq!(found.image.pixels[0], [3.0, 4.0, 5.0]);
    assert_eq!(said(&found), ["read layer 'View.Combined'"]);
    for layer in ["View.AO", "ao"] {
        assert_eq!(first(&blender, Some(layer)).unwrap().image.pixels[0], [0.0, 1.0, 2.0]);
    }
    let error = first(&blender, Some("Mist")).unwrap_err().to_string();
    assert!(error.contains("no layer is called 'Mist'; there are 'View.AO', 'View.Combined'"), "{error}");

    // Colours without a layer take precedence.
    let mut with_plain = vec!["R", "G", "B"];
    with_plain.extend(&blender);
    assert_eq!(first(&with_plain, None).unwrap().image.pixels[0], [0.0, 1.0, 2.0]);
    // If no layer's name marks it as the picture, the first is read, with a warning.
    let lights = names(&["sun", "sky"]);
    let lights: Vec<&str> = lights.iter().map(String::as_str).collect();
    let found = first(&lights, None).unwrap();
    assert_eq!(said(&found), ["! read the first of the layers 'sky', 'sun'; select another by its name"]);
    // Data layers are not light by default, and Y beside X is not luminance.
    for data in [&["N.X", "N.Y", "N.Z", "Z"][..], &["AO.R", "AO.G", "AO.B"], &["uv.Y"]] {
        let error = first(data, None).unwrap_err().to_string();
        assert!(error.contains("found only"), "{error}");
    }
    assert_eq!(first(&["AO.R", "AO.G", "AO.B"], Some("AO")).unwrap().image.pixels[0], [0.0, 1.0, 2.0]);
}

#[test]
fn the_environment_map_attribute_sets_the_layout() {
    // Six faces, white except the first, to +X, which is black.
    let mut image = Image { width: 8, height: 48, pixels: vec![[1.0; 3]; 8 * 48] };
    image.pixels[..64].fill([0.0; 3]);
    let bytes = changed_exr(&image, |layer, _, _| layer.attributes.environment_map = Some(EnvironmentMap::Cube));
    assert_eq!(read(&bytes).layout, Some(MapLayout::Cube));
    let folder = tempfile::tempdir().unwrap();
    let path = write(folder.path(), "cube.exr", &bytes);
    let map = Environment::open(path.to_str().unwrap()).unwrap();
    assert_eq!((map.width(), map.height()), (32, 16));
    for (w, expected) in [(Vec3A::X, 0.0), (Vec3A::NEG_X, 1.0), (Vec3A::Z, 1.0), (Vec3A::Y, 1.0)] {
        assert!((map.radiance(w).x - expected).abs() < 1e-3, "{w}: {}", map.radiance(w));
    }
    assert!(map.remarks()[0].text().contains("from layout cube"));
    // A requested layout takes precedence.
    let spec = format!("{}#layout=latlong", path.display());
    assert_eq!(Environment::open(&spec).unwrap().width(), 8);
    let error = Environment::open(&format!("{}#layout=cross", path.display())).unwrap_err().to_string();
    assert!(error.contains("cube.exr: layout: 8 x 48 pixels are not 3 x 4 squares"), "{error}");
}

/// Returns a Radiance file with these lines in its header.
fn radiance(lines: &str, resolution: &str, rgbe: &[[u8; 4]]) -> Vec<u8> {
    let mut bytes = format!("#?RADIANCE\n{lines}FORMAT=32-bit_rle_rgbe\n\n{resolution}\n").into_bytes();
    bytes.extend_from_slice(rgbe.as_flattened());
    bytes
}

#[test]
fn exposure_and_color_settings_of_radiance_headers_are_applied() {
    let grey = [[64, 64, 64, 136]; 2];
    let first = |lines: &str| read(&radiance(lines, "-Y 1 +X 2", &grey));
    assert_eq!(first("").image.pixels[0], [64.0; 3]);
    let exposed = first("EXPOSURE=2.0\nEXPOSURE= 0.125e0\nGAMMA=1\nPRIMARIES=0 0 0 0 0 0 0 0\n");
    assert_eq!(exposed.image.pixels[0], [256.0; 3]);
    assert_eq!(said(&exposed), ["divided out the exposure: multiplied values by 4"]);
    assert_eq!(first("COLORCORR=1 2 4\n").image.pixels[0], [64.0, 32.0, 16.0]);
    // White stays white for any primaries.
    for value in first("PRIMARIES= .7347 .2653 0 1 .0001 -.077 .32168 .33767\n").image.pixels[0] {
        assert!((value / 64.0 - 1.0).abs() < 1e-5, "{value}");
    }
    assert!(said(&first("GAMMA=2.2\n"))[0].starts_with("! ignored GAMMA=2.2"));
    for wrong in [
        "EXPOSURE=0\n",
        "EXPOSURE=x\n",
        "EXPOSURE=1e-200\nEXPOSURE=1e-200\n",
        "COLORCORR=1 2\n",
        "PRIMARIES=1 2\n",
        "FORMAT=rgb\n",
    ] {
        assert!(error(&radiance(wrong, "-Y 1 +X 2", &grey)).contains("header: "), "{wrong}");
    }
}

#[test]
fn radiance_files_may_have_any_line_ending_and_no_first_line() {
    let grey = [[64, 64, 64, 136]; 2];
    let plain = read(&radiance("", "-Y 1 +X 2", &grey));
    let text = "#?RADIANCE\r\n# a comment\r\nFORMAT=32-bit_rle_rgbe\r\n\r\n-Y 1 +X 2\r\n";
    assert_eq!(read(&[text.as_bytes(), grey.as_flattened()].concat()), plain);
    let text = "oconv scene.rad\nrpict -vth\n\tpfilt\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n";
    assert_eq!(read(&[text.as_bytes(), grey.as_flattened()].concat()), plain);
}

#[test]
fn all_eight_orientations_are_read() {
    // 1 2 3 over 4 5 6.
    let value = |k: u8| [10 * k, 10 * k, 10 * k, 136];
    let row = |values: [u8; 6]| values.map(value);
    for (resolution, order) in [
        ("-Y 2 +X 3", [1, 2, 3, 4, 5, 6]),
        ("-Y 2 -X 3", [3, 2, 1, 6, 5, 4]),
        ("+Y 2 +X 3", [4, 5, 6, 1, 2, 3]),
        ("+Y 2 -X 3", [6, 5, 4, 3, 2, 1]),
        ("+X 3 -Y 2", [1, 4, 2, 5, 3, 6]),
        ("+X 3 +Y 2", [4, 1, 5, 2, 6, 3]),
        ("-X 3 -Y 2", [3, 6, 2, 5, 1, 4]),
        ("-X 3 +Y 2", [6, 3, 5, 2, 4, 1]),
    ] {
        let image = read(&radiance("", resolution, &row(order))).image;
        assert_eq!((image.width, image.height), (3, 2), "{resolution}");
        assert_eq!(
            image.pixels.iter().map(|pixel| pixel[0]).collect::<Vec<_>>(),
            [10.0, 20.0, 30.0, 40.0, 50.0, 60.0],
            "{resolution}"
        );
    }
}

#[test]
fn git_lfs_pointers_are_named_in_the_error() {
    let pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n";
    assert!(error(pointer).contains("Git LFS pointer"));
}
