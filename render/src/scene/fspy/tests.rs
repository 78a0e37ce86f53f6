use glam::Quat;

use super::*;
use crate::{
    image::encode_png_rgb8,
    random::{Purpose, Stream},
};

fn project(width: u32, height: u32, principal_point: Vec2) -> FspyProject {
    let turn = Quat::from_euler(glam::EulerRot::YXZ, 0.6, -0.35, 0.1);
    let to_world = Affine3A::from_rotation_translation(turn, Vec3::new(3.0, 1.6, 4.0));
    let camera = Camera::of_photograph(to_world, 0.55, principal_point).unwrap();
    let pixels = vec![[90, 120, 200]; (width * height) as usize];
    let image = encode_png_rgb8(width as usize, height as usize, &pixels).unwrap();
    FspyProject { camera, width, height, image }
}

/// Bytes of a project whose state was changed.
fn with_state(change: impl Fn(&mut serde_json::Value)) -> Vec<u8> {
    changed(&project(40, 30, Vec2::ZERO), change)
}

fn changed(project: &FspyProject, change: impl Fn(&mut serde_json::Value)) -> Vec<u8> {
    let mut state = project.state(UpAxis::Z);
    change(&mut state);
    let state = state.to_string();
    let mut bytes = MAGIC.to_vec();
    for number in [VERSION, state.len() as u32, project.image.len() as u32] {
        bytes.extend(number.to_le_bytes());
    }
    [bytes, state.into_bytes(), project.image.clone()].concat()
}

#[test]
fn projects_round_trip() {
    for (width, height) in [(60, 40), (40, 60), (50, 50)] {
        for up in [UpAxis::Y, UpAxis::Z] {
            let project = project(width, height, Vec2::new(0.2, -0.15));
            let read = FspyProject::decode(&project.encode(up), up).unwrap();
            assert_eq!((read.width, read.height, &read.image), (width, height, &project.image));
            let (from, to) = (project.camera, read.camera);
            assert!((from.look_from() - to.look_from()).length() < 1e-5);
            for (x, y) in [(0.0, 0.0), (11.0, 30.0)] {
                let [a, b] = [from, to].map(|camera| camera.ray(x, y, width as usize, height as usize).direction);
                // About ten roundings of numbers below 1.
                assert!((a - b).length() < 1e-5, "{a} {b}");
            }
            let image = read.photograph().unwrap().image;
            assert_eq!((image.width, image.height), (width as usize, height as usize));
        }
    }
}

/// The world's axes vanish at the file's vanishing points, from which fSpy computes the camera, for any
/// principal point.
#[test]
fn axes_of_the_world_vanish_where_the_file_says() {
    // A landscape and a portrait of a rotated world, with the principal point far from the middle.
    let transforms = [
        ([[0.8, 0.0, 0.6], [0.36, 0.8, -0.48], [-0.48, 0.6, 0.64]], (2592, 1728)),
        ([[0.36, 0.8, -0.48], [-0.48, 0.6, 0.64], [0.8, 0.0, 0.6]], (1728, 2592)),
    ];
    let (focal, point) = (1.5_f64, (0.4_f64, -0.3_f64));
    for (rows, (width, height)) in transforms {
        let bytes = with_state(|state| {
            let parameters = &mut state["cameraParameters"];
            let full: Vec<Vec<f64>> =
                rows.iter().map(|row| [&row[..], &[0.0]].concat()).chain([vec![0.0, 0.0, 0.0, 1.0]]).collect();
            parameters["cameraTransform"]["rows"] = serde_json::json!(full);
            parameters["principalPoint"] = serde_json::json!({ "x": point.0, "y": point.1 });
            parameters["relativeFocalLength"] = serde_json::json!(focal);
            parameters["imageWidth"] = serde_json::json!(width);
            parameters["imageHeight"] = serde_json::json!(height);
        });
        let camera = FspyProject::decode(&bytes, UpAxis::Y).unwrap().camera;
        for axis in 0..3 {
            // Row `axis` of the camera's transform is the axis in the camera's coordinates.
            let [x, y, z] = rows[axis];
            let expected = (point.0 - focal * x / z, point.1 - focal * y / z);
            // The end of the axis in front of the camera.
            let mut far = Vec3A::ZERO;
            far[axis] = if z < 0.0 { 1e6 } else { -1e6 };
            let seen = camera.project(far, width, height).unwrap();
            let longer = width.max(height) as f64;
            let found =
                ((2.0 * f64::from(seen.x) - width as f64) / longer, (height as f64 - 2.0 * f64::from(seen.y)) / longer);
            assert!(
                (found.0 - expected.0).abs() < 1e-4 && (found.1 - expected.1).abs() < 1e-4,
                "{found:?} {expected:?}"
            );
        }
    }
}

#[test]
fn without_a_focal_length_the_field_of_view_is_that_of_the_longer_side() {
    for (width, height) in [(60, 40), (40, 60)] {
        let project = project(width, height, Vec2::ZERO);
        let bytes = changed(&project, |state| {
            state["cameraParameters"].as_object_mut().unwrap().remove("relativeFocalLength");
        });
        let derived = FspyProject::decode(&bytes, UpAxis::Z).unwrap().camera;
        assert!((project.camera.half_height() / derived.half_height() - 1.0).abs() < 1e-6);
    }
}

#[test]
fn up_axis_is_applied() {
    let bytes = project(40, 30, Vec2::ZERO).encode(UpAxis::Z);
    let [z_up, as_it_is] = [UpAxis::Z, UpAxis::Y].map(|up| FspyProject::decode(&bytes, up).unwrap().camera.look_from());
    assert!((z_up - Vec3A::new(3.0, 1.6, 4.0)).length() < 1e-5);
    assert!((as_it_is - Vec3A::new(3.0, -4.0, 1.6)).length() < 1e-5);
}

fn refused(bytes: &[u8], word: &str) {
    let message = FspyProject::decode(bytes, UpAxis::Z).unwrap_err().to_string();
    assert!(message.contains(word) && !message.contains('\n'), "{word}: {message}");
}

#[test]
fn invalid_files_are_rejected_with_one_line() {
    let good = project(40, 30, Vec2::ZERO).encode(UpAxis::Z);
    refused(b"", "first bytes");
    refused(b"glTF0000", "first bytes");
    refused(&good[..10], "cut off");
    refused(&good[..good.len() - 1], "sizes");
    refused(&[&good[..], b"x"].concat(), "sizes");
    let number = |place: usize, value: u32| {
        let mut bytes = good.clone();
        bytes[place..place + 4].copy_from_slice(&value.to_le_bytes());
        bytes
    };
    refused(&number(4, 153), "version: is 153");
    refused(&number(8, u32::MAX), "state size");
    refused(&number(12, u32::MAX), "sizes");
    refused(&number(8, 1000), "sizes");
    refused(&with_state(|state| state["cameraParameters"] = serde_json::Value::Null), "is null");
    refused(&with_state(|state| *state = serde_json::json!({})), "is null");
    refused(&with_state(|state| *state = serde_json::json!([1, 2])), "is not what fSpy writes");
    let parameter =
        |name: &str, value: serde_json::Value| with_state(|state| state["cameraParameters"][name] = value.clone());
    refused(&parameter("imageWidth", 0.into()), "0 x 30");
    refused(&parameter("imageHeight", u64::MAX.into()), "is not what fSpy writes");
    refused(&parameter("relativeFocalLength", (-1.0).into()), "focal length");
    refused(&parameter("principalPoint", serde_json::json!({ "x": 1e300, "y": 0 })), "principal point");
    refused(&parameter("cameraTransform", serde_json::json!({ "rows": [[1, 0], [0, 1]] })), "is not what fSpy writes");
    let rows = serde_json::json!([[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]);
    refused(&parameter("cameraTransform", serde_json::json!({ "rows": rows })), "rotation");
    let deep = "[".repeat(100_000);
    let header = [&MAGIC[..], &1_u32.to_le_bytes(), &(deep.len() as u32).to_le_bytes(), &0_u32.to_le_bytes()].concat();
    refused(&[header, deep.into_bytes()].concat(), "is not what fSpy writes");
}

#[test]
fn missing_and_unsupported_photographs_are_errors() {
    let mut bare = project(40, 30, Vec2::ZERO);
    bare.image.clear();
    let read = FspyProject::decode(&bare.encode(UpAxis::Z), UpAxis::Z).unwrap();
    assert!(read.photograph().unwrap_err().to_string().contains("holds none"));
    bare.image = b"GIF89a".to_vec();
    assert!(bare.photograph().unwrap_err().to_string().contains("neither PNG nor JPEG"));
}

/// Any bytes give an error or a project that can be rendered.
#[test]
fn damaged_files_never_panic() {
    let good = project(24, 18, Vec2::new(0.1, 0.0)).encode(UpAxis::Z);
    let check = |bytes: &[u8]| {
        if let Ok(project) = FspyProject::decode(bytes, UpAxis::Z) {
            let ray = project.camera.ray(1.0, 2.0, project.width as usize, project.height as usize);
            assert!(ray.origin.is_finite());
            let _ = project.photograph();
        }
    };
    for cut in 0..good.len() {
        check(&good[..cut]);
    }
    let mut random = Stream::new(15, Purpose::Test, 0);
    for _ in 0..20_000 {
        let mut bytes = good.clone();
        for _ in 0..=(4.0 * random.uniform()) as usize {
            let place = (random.uniform() * bytes.len() as f32) as usize % bytes.len();
            bytes[place] = match (random.uniform() * 4.0) as u32 {
                0 => (random.uniform() * 256.0) as u8,
                1 => b'9',
                2 => bytes[place] ^ 1 << ((random.uniform() * 8.0) as u32 % 8),
                _ => b'-',
            };
        }
        check(&bytes);
    }
}
