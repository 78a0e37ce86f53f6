//! Cameras: which one is used, their transforms, and broken ones.

use glam::Vec3A;
use serde_json::{Value, json};

use super::{load, set, triangle, unusual::warnings};
use crate::scene::{Camera, Scene};

/// A scene with cameras, each in a node of its own at (0, 0, 4) with further properties.
fn with_cameras(cameras: &[Value], nodes: &[Value]) -> Scene {
    let (mut json, bin) = triangle();
    set(&mut json, "/cameras", json!(cameras));
    let own = nodes.iter().enumerate().map(|(k, node)| {
        let mut own = json!({"camera": k, "name": format!("camera {k}"), "translation": [0, 0, 4]});
        node.as_object().unwrap().iter().for_each(|(key, value)| own[key] = value.clone());
        own
    });
    let all: Vec<Value> = std::iter::once(json!({"mesh": 0})).chain(own).collect();
    set(&mut json, "/scenes/0/nodes", json!((0..all.len()).collect::<Vec<_>>()));
    set(&mut json, "/nodes", json!(all));
    load(&json, &bin).unwrap()
}

fn perspective(yfov: f32) -> Value {
    json!({"type": "perspective", "perspective": {"yfov": yfov, "znear": 0.1}})
}

fn orthographic(ymag: f32) -> Value {
    json!({"type": "orthographic", "orthographic": {"xmag": 1, "ymag": ymag, "zfar": 9, "znear": 0}})
}

/// The camera's view axis and vertical.
fn axes(camera: &Camera) -> [Vec3A; 2] {
    let axes = camera.to_world().matrix3;
    [-axes.z_axis, axes.y_axis]
}

#[test]
fn first_perspective_camera_of_the_scene_is_selected() {
    let scene = with_cameras(&[orthographic(1.0), perspective(0.5)], &[json!({}), json!({"translation": [1, 2, 5]})]);
    let camera = scene.camera();
    assert!((camera.look_from() - Vec3A::new(1.0, 2.0, 5.0)).length() < 1e-6);
    assert!((camera.vertical_fov() - 0.5_f32.to_degrees()).abs() < 1e-4);
    assert!((camera.ray(50.0, 50.0, 100, 100).direction + Vec3A::Z).length() < 1e-6);
}

#[test]
fn broken_cameras_matter_only_when_they_are_chosen() {
    let broken = [
        (orthographic(0.0), "cameras[1]: orthographic.ymag: 0 is not a height"),
        (perspective(4.0), "cameras[1]: vertical field of view"),
        (json!({"type": "perspective", "perspective": {}}), "cameras[1]: missing field `yfov`"),
        (json!({"type": "orthographic"}), "cameras[1]: has none of its projection"),
        (json!({"type": "fisheye"}), "cameras[1]: type"),
        (json!(5), "nodes[2].camera: element 1 cannot be read"),
    ];
    for (camera, reason) in broken {
        let mut scene = with_cameras(&[perspective(0.5), camera.clone()], &[json!({}), json!({})]);
        assert!(warnings(&scene).is_empty() && scene.camera().look_from().z == 4.0, "{reason}");
        let error = scene.use_camera("camera 1").unwrap_err().to_string();
        assert!(error.contains("camera 'camera 1'") && error.contains(reason), "{error}");
        scene.use_camera("camera 0").unwrap();
    }
    for (node, reason) in [
        (json!({"camera": 7}), "nodes[2].camera: index 7 is out of range"),
        (json!({"camera": -1}), "nodes[2].camera: invalid type: integer `-1`"),
        (json!({"scale": [0, 0, 0]}), "cameras[1]: camera"),
    ] {
        let mut scene = with_cameras(&[perspective(0.5), perspective(0.5)], &[json!({}), node]);
        assert!(warnings(&scene).is_empty(), "{reason}");
        let error = scene.use_camera("1").unwrap_err().to_string();
        assert!(error.contains(reason), "{error}");
    }
    // The file's first choice is broken: the next one is used, with a warning.
    let scene = with_cameras(&[orthographic(1.0), perspective(4.0)], &[json!({}), json!({})]);
    assert!(scene.camera().is_orthographic());
    let warnings = warnings(&scene);
    assert!(warnings.len() == 1 && warnings[0].starts_with("left out a camera: cameras[1]"), "{warnings:?}");
}

#[test]
fn cameras_ignore_the_scaling_of_their_nodes() {
    // As three.js decomposes them; a mirrored axis x is not visible in the image.
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let cases = [
        (json!({}), [-Vec3A::Z, Vec3A::Y]),
        (json!({"scale": [1, 0.5, 1]}), [-Vec3A::Z, Vec3A::Y]),
        (json!({"scale": [3, 0.5, 1e-30]}), [-Vec3A::Z, Vec3A::Y]),
        (json!({"scale": [-1, 1, 1]}), [-Vec3A::Z, Vec3A::Y]),
        (json!({"scale": [1, 1, -1]}), [Vec3A::Z, Vec3A::Y]),
        (json!({"scale": [0, 1, 1]}), [-Vec3A::Z, Vec3A::Y]),
        (json!({"scale": [1, 0, 1]}), [-Vec3A::Z, Vec3A::Y]),
        (json!({"scale": [1, 1, 0]}), [-Vec3A::Z, Vec3A::Y]),
        // A quarter turn about the view axis: up in the image is -x.
        (json!({"rotation": [0, 0, half, half], "scale": [2, 3, 4]}), [-Vec3A::Z, -Vec3A::X]),
        // A quarter turn about x: the camera looks up, and up in the image is +z.
        (json!({"rotation": [half, 0, 0, half], "scale": [5, 1, 1]}), [Vec3A::Y, Vec3A::Z]),
    ];
    for (node, expected) in cases {
        let mut scene = with_cameras(&[perspective(1.0), orthographic(2.0)], &[node.clone(), node.clone()]);
        for name in ["0", "1"] {
            scene.use_camera(name).unwrap();
            let camera = scene.camera();
            let found = axes(&camera);
            assert!((0..2).all(|k| found[k].distance(expected[k]) < 1e-6), "{node}: {found:?}");
            let half_height = if name == "0" { 0.5_f32.tan() } else { 2.0 };
            assert!((camera.half_height() - half_height).abs() < 1e-6, "{node}: {}", camera.half_height());
        }
    }
}

#[test]
fn orthographic_cameras_have_parallel_rays() {
    let scene = with_cameras(&[orthographic(2.0)], &[json!({"translation": [0.2, 0.2, 4], "scale": [1, 0.5, 1]})]);
    let camera = scene.camera();
    assert!(camera.is_orthographic() && camera.pixel_spread(100) == 0.0);
    for (x, y, expected) in [(50.0, 50.0, Vec3A::new(0.2, 0.2, 4.0)), (100.0, 0.0, Vec3A::new(2.2, 2.2, 4.0))] {
        let ray = camera.ray(x, y, 100, 100);
        assert!((ray.origin - expected).length() < 1e-6 && (ray.direction + Vec3A::Z).length() < 1e-6);
        let seen = camera.project(ray.origin + 3.0 * ray.direction, 100, 100).unwrap();
        assert!((seen.x - x).abs() < 1e-4 && (seen.y - y).abs() < 1e-4, "{seen}");
    }
}
