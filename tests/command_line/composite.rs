//! `view` and `composite` as command lines.

use std::{collections::HashMap, fs, path::Path};

use exr::prelude::read_first_flat_layer_from_file;
use headtail_render::{
    image::{Image, Photograph, write_exr},
    scene::{FspyProject, UpAxis},
};

use super::{fail, folder, is_png, names, picture, succeed, text};

const VIEW: &str = "view --env window --width 60 --height 40 --out shot.exr";

#[test]
fn composite_inserts_an_object_into_a_view_of_a_map() {
    let here = folder();
    let path = here.path();
    succeed(path, VIEW);
    assert_eq!(names(path), ["shot.exr", "shot.fspy", "shot.png"]);
    let said = succeed(
        path,
        "composite --photo shot.exr --camera shot.fspy --env window --scene sphere --size 0.8 --spp 8 --out out",
    );
    assert!(said.contains("8 spp") && said.contains("composite.html"), "{said}");
    assert_eq!(
        names(&path.join("out")),
        ["composite.exr", "composite.html", "composite.png", "layers.exr", "mask.png"]
    );
    assert!(is_png(&path.join("out/composite.png")) && is_png(&path.join("out/mask.png")));
    let (before, after) = (picture(&path.join("shot.exr")), picture(&path.join("out/composite.exr")));
    assert_eq!((after.width, after.height), (60, 40));
    // The sky is unchanged bit by bit; the object is not.
    assert_eq!(before.pixels[..60 * 8], after.pixels[..60 * 8]);
    assert!(before != after && after.pixels.as_flattened().iter().all(|value| value.is_finite()));
    assert_eq!(picture(&path.join("out/layers.exr")), after);
    assert_layers_make(&path.join("out/layers.exr"), &before, &after);
}

/// Asserts that the layers of a file over the photograph yield the composite.
fn assert_layers_make(file: &Path, photograph: &Image, composite: &Image) {
    let layer = read_first_flat_layer_from_file(file).unwrap();
    let channels = layer.layer_data.channel_data.list;
    let channels: HashMap<String, Vec<f32>> =
        channels.into_iter().map(|own| (own.name.to_string(), own.sample_data.values_as_f32().collect())).collect();
    let alpha = &channels["object.A"];
    assert!(alpha.iter().any(|alpha| (0.01..0.99).contains(alpha)), "edges are covered in part");
    for (k, letter) in ["R", "G", "B"].into_iter().enumerate() {
        let [object, shadow, light, behind] =
            ["object", "shadow", "light", "photograph"].map(|name| &channels[&format!("{name}.{letter}")]);
        assert!(shadow.iter().any(|&shadow| shadow < 0.9) && light.iter().any(|&light| light > 0.0), "{letter}");
        for (index, alpha) in alpha.iter().enumerate() {
            assert_eq!(behind[index], photograph.pixels[index][k]);
            let expected = object[index] + (1.0 - alpha) * (behind[index] * shadow[index] + light[index]);
            let found = composite.pixels[index][k];
            // Allows a few roundings of sums of the terms' magnitude.
            assert!(
                (found - expected).abs() <= 1e-6 * (1.0 + expected.abs()),
                "{letter} {index}: {found}, not {expected}"
            );
        }
    }
}

#[test]
fn composites_of_project_pictures_and_previews_are_written() {
    let here = folder();
    let path = here.path();
    succeed(path, "view --env studio --width 800 --height 400 --out shot.exr");
    succeed(
        path,
        "composite --camera shot.fspy --env studio --scene sphere --size 0.8 --preview --mask paper --grey-mask --out out",
    );
    let image = picture(&path.join("out/composite.exr"));
    assert_eq!((image.width, image.height), (200, 100));
    // An sRGB photograph keeps its codes where no shadow falls.
    let png = Photograph::decode(&fs::read(path.join("out/composite.png")).unwrap()).unwrap().image;
    for (code, value) in png.pixels[..400].as_flattened().iter().zip(image.pixels[..400].as_flattened()) {
        assert!((code - value).abs() < 0.01, "{code} {value}");
    }
}

/// The gain undoes the exposure of a PNG view, so that it is lit like the map.
#[test]
fn srgb_photographs_are_lit_like_radiance() {
    let here = folder();
    let path = here.path();
    succeed(path, VIEW);
    let composite = |photo: &str, out: &str| {
        succeed(
            path,
            &format!(
                "composite --photo {photo} --camera shot.fspy --env window --scene sphere --size 1.2 --spp 16 --out {out}"
            ),
        );
        let (photo, image) =
            (Photograph::read(&path.join(photo)).unwrap().image, picture(&path.join(out).join("composite.exr")));
        let sum = |image: &Image| image.pixels.iter().map(|pixel| f64::from(pixel[1])).sum::<f64>();
        sum(&image) / sum(&photo)
    };
    let (exact, coded) = (composite("shot.exr", "a"), composite("shot.png", "b"));
    // 8-bit codes are accurate to 0.5 %; clipped values are excluded from the gain, but not from the sums.
    assert!((exact / coded - 1.0).abs() < 0.1, "{exact} {coded}");
}

/// Remarks on photographs are shown, and warnings are errors under `--strict`.
#[test]
fn photographs_of_other_colors_and_values_are_read_with_remarks() {
    let here = folder();
    let path = here.path();
    let mut info = png::Info::with_size(24, 16);
    (info.color_type, info.bit_depth) = (png::ColorType::Rgb, png::BitDepth::Eight);
    info.icc_profile = Some(moxcms::ColorProfile::new_display_p3().encode().unwrap().into());
    let file = fs::File::create(path.join("p3.png")).unwrap();
    let mut writer = png::Encoder::with_info(file, info).unwrap().write_header().unwrap();
    writer.write_image_data(&[230, 40, 40].repeat(24 * 16)).unwrap();
    writer.finish().unwrap();
    let mut pixels = vec![[0.5; 3]; 24 * 16];
    pixels[0] = [f32::INFINITY, 3.0, -2.0];
    write_exr(&path.join("sun.exr"), &Image { width: 24, height: 16, pixels }, &[]).unwrap();
    let command = |photo: &str| {
        format!(
            "composite --photo {photo} --look-from 0,1,4 --look-at 0,1,0 --env window --scene sphere --size 0.8 --spp 2 --out {photo}.out"
        )
    };
    let stderr = |arguments: &str| text(&super::headtail(path, arguments).stderr);

    let said = stderr(&format!("--strict {}", command("p3.png")));
    assert!(said.contains("note: p3.png: converted colours from ICC profile 'Display P3'"), "{said}");
    // Linear Rec.709 by SMPTE EG 432-1; in the PNG, the nearest colour of sRGB.
    let first = picture(&path.join("p3.png.out/composite.exr")).pixels[0];
    assert!((0..3).all(|k| (first[k] - [0.9645, -0.0111, 0.0061][k]).abs() < 1e-3), "{first:?}");
    let png = Photograph::decode(&fs::read(path.join("p3.png.out/composite.png")).unwrap()).unwrap();
    assert_eq!(png.image.pixels[0].map(headtail_render::image::srgb_code), [251, 0, 18]);

    let said = stderr(&command("sun.exr"));
    assert!(said.contains("warning: sun.exr: 1 channel values were infinite"), "{said}");
    assert!(said.contains("warning: sun.exr: 1 channel values were negative"), "{said}");
    assert_eq!(picture(&path.join("sun.exr.out/composite.exr")).pixels[0], [f32::INFINITY, 3.0, -2.0]);
    let message = fail(path, &format!("--strict {}", command("sun.exr")));
    assert!(message.contains("were negative") && message.contains("(--strict)"), "{message}");
}

#[test]
fn catchers_are_selected_by_node_name() {
    let here = folder();
    let path = here.path();
    succeed(path, VIEW);
    // Two squares, one above the other, named by their nodes.
    let positions: Vec<u8> = [-0.3_f32, 0.0, 0.3, 0.3, 0.0, 0.3, 0.3, 0.0, -0.3, -0.3, 0.0, -0.3]
        .iter()
        .flat_map(|x| x.to_le_bytes())
        .collect();
    fs::write(path.join("data.bin"), [positions, [0_u8, 1, 2, 0, 2, 3].to_vec()].concat()).unwrap();
    let gltf = r#"{"asset":{"version":"2.0"},"scenes":[{"nodes":[0,1]}],
        "nodes":[{"mesh":0,"name":"Floor","scale":[9,1,9]},{"mesh":0,"name":"Lid","translation":[0,0.4,0]}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[-0.3,0,-0.3],"max":[0.3,0,0.3]},
                     {"bufferView":1,"componentType":5121,"count":6,"type":"SCALAR"}],
        "bufferViews":[{"buffer":0,"byteLength":48},{"buffer":0,"byteOffset":48,"byteLength":6}],
        "buffers":[{"uri":"data.bin","byteLength":54}]}"#;
    fs::write(path.join("lid.gltf"), gltf).unwrap();
    let command = "composite --photo shot.exr --camera shot.fspy --env window --scene lid.gltf --spp 8";
    succeed(path, &format!("{command} --catcher Floor --out out"));
    assert_ne!(picture(&path.join("out/composite.exr")), picture(&path.join("shot.exr")));
    let message = fail(path, &format!("{command} --catcher Wall --out wall"));
    assert!(message.contains("mesh 'Wall'") && message.contains("Floor, Lid"), "{message}");
}

#[test]
fn invalid_projects_and_pictures_are_rejected() {
    let here = folder();
    let path = here.path();
    succeed(path, VIEW);
    let good = fs::read(path.join("shot.fspy")).unwrap();
    let command = "composite --photo shot.exr --env window --scene sphere --spp 1 --out out --camera";
    let refused = |name: &str, bytes: &[u8], word: &str| {
        fs::write(path.join(name), bytes).unwrap();
        let message = fail(path, &format!("{command} {name}"));
        assert!(message.contains(name) && message.contains(word), "{message}");
    };
    refused("cut.fspy", &good[..200], "but 184 follow the header");
    refused("large.fspy", &[&good[..8], &[0xff; 4], &good[12..]].concat(), "state size");
    refused("version.fspy", &[b"fspy\x02\0\0\0", &good[8..]].concat(), "version");
    let state = br#"{"cameraParameters":null}"#;
    let null = [b"fspy\x01\0\0\0", &(state.len() as u32).to_le_bytes()[..], &[0; 4], state].concat();
    refused("null.fspy", &null, "the vanishing points give no camera");
    refused("empty.fspy", b"", "first bytes");
    let message = fail(path, "composite --photo shot.fspy --camera shot.fspy --env window --scene sphere --out out");
    assert!(message.contains("not an OpenEXR, Radiance, PNG or JPEG"), "{message}");
    let message = fail(path, &format!("{command} missing.fspy"));
    assert!(message.contains("missing.fspy"), "{message}");
    let mut narrow = FspyProject::decode(&good, UpAxis::Z).unwrap();
    (narrow.width, narrow.height) = (40, 60);
    refused("narrow.fspy", &narrow.encode(UpAxis::Z), "another shape");
}

#[test]
fn impossible_composites_are_rejected_with_a_reason() {
    let here = folder();
    let path = here.path();
    succeed(path, VIEW);
    let with = |arguments: &str| {
        fail(
            path,
            &format!(
                "composite --photo shot.exr --camera shot.fspy --env window --scene sphere --spp 1 {arguments} --out out"
            ),
        )
    };
    assert!(with("--move 0,0,900").contains("does not see the object"));
    assert!(with("--scale 0").contains("--scale"));
    assert!(with("--gain 0").contains("--gain"));
    assert!(with("--plane-normal 0,0,0").contains("--plane-normal"));
    write_exr(&path.join("dark.exr"), &Image::black(60, 40), &[]).unwrap();
    succeed(
        path,
        "composite --photo dark.exr --look-from 0,1,4 --look-at 0,0.5,0 --env window --scene sphere --spp 1 --out dark",
    );
}

/// JSON output prints only data on standard output.
#[test]
fn composite_prints_json() {
    let here = folder();
    let path = here.path();
    succeed(path, "view --env window --width 60 --height 40 --out shot.exr");
    let said = succeed(
        path,
        "composite --photo shot.exr --camera shot.fspy --env window --scene sphere --size 0.8 --spp 4 --json --out out",
    );
    let facts: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!((&facts["width"], &facts["height"], &facts["spp"]), (&60.into(), &40.into(), &4.into()));
    let mean = facts["mean_mask"].as_f64().unwrap();
    assert!((0.5..0.999).contains(&mean), "{said}");
}
