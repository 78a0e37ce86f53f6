//! Placement of object, catcher, camera and light in `composite`.

use std::{fs, path::Path};

use headtail_render::{
    image::{Image, write_exr},
    scene::{FspyProject, UpAxis},
};

use super::{fail, folder, picture, succeed};

/// A dim sky with a lamp of a few texels, multiplied by factors.
fn write_map(path: &Path, factors: [f32; 3]) {
    let level = |k: usize| if (8..12).contains(&(k % 64)) && (6..9).contains(&(k / 64)) { 60.0 } else { 0.5 };
    let pixels = (0..64 * 32).map(|k| factors.map(|factor| factor * level(k))).collect();
    write_exr(path, &Image { width: 64, height: 32, pixels }, &[]).unwrap();
}

/// Writes a map, a grey photograph, and scenes of a long lid over a wide floor, level and tilted.
fn write_inputs(path: &Path) {
    write_map(&path.join("map.exr"), [1.0; 3]);
    write_exr(&path.join("photo.exr"), &Image { width: 48, height: 32, pixels: vec![[0.5; 3]; 48 * 32] }, &[]).unwrap();
    let corners = [-0.3_f32, 0.0, 0.3, 0.3, 0.0, 0.3, 0.3, 0.0, -0.3, -0.3, 0.0, -0.3];
    let bytes = corners.into_iter().flat_map(f32::to_le_bytes).chain([0, 1, 2, 0, 2, 3]);
    fs::write(path.join("data.bin"), bytes.collect::<Vec<u8>>()).unwrap();
    let lid = r#"{"mesh":0,"name":"Lid","scale":[1,1,0.4],"translation":[0,0.4,0]}"#;
    let floor = r#"{"mesh":0,"name":"Floor","scale":[90,1,90]}"#;
    let root = |degrees: f32, children: &str| {
        let (sin, cos) = (0.5 * degrees.to_radians()).sin_cos();
        format!(r#"{{"rotation":[0,0,{sin},{cos}],"children":{children}}}"#)
    };
    for (name, nodes) in [
        ("lid", format!("{},{lid}", root(0.0, "[1]"))),
        ("tilted", format!("{},{lid}", root(20.0, "[1]"))),
        ("floor", format!("{},{lid},{floor}", root(20.0, "[1,2]"))),
    ] {
        let gltf = format!(
            r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{nodes}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1}}]}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[-0.3,0,-0.3],"max":[0.3,0,0.3]}},
                         {{"bufferView":1,"componentType":5121,"count":6,"type":"SCALAR"}}],
            "bufferViews":[{{"buffer":0,"byteLength":48}},{{"buffer":0,"byteOffset":48,"byteLength":6}}],
            "buffers":[{{"uri":"data.bin","byteLength":54}}]}}"#
        );
        fs::write(path.join(name).with_extension("gltf"), gltf).unwrap();
    }
}

/// Renders a composite over the grey photograph.
fn composite(path: &Path, arguments: &str) -> Image {
    succeed(path, &format!("composite --photo photo.exr --spp 16 {arguments} --out out"));
    picture(&path.join("out/composite.exr"))
}

/// The mean absolute difference of two pictures.
fn apart(a: &Image, b: &Image) -> f64 {
    let pairs = a.pixels.as_flattened().iter().zip(b.pixels.as_flattened());
    pairs.map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / a.pixels.as_flattened().len() as f64
}

/// Turning map, object and camera together leaves the picture unchanged; turning map or object alone moves
/// the shadow.
#[test]
fn maps_and_objects_rotate_consistently() {
    let here = folder();
    let path = here.path();
    write_inputs(path);
    let at = |turn: f32, options: &str| {
        let (sin, cos) = turn.to_radians().sin_cos();
        let camera = format!("--look-from {},1.6,{} --look-at 0,0.1,0 --fov 30", 2.0 * sin, 2.0 * cos);
        composite(path, &format!("--env map.exr --scene lid.gltf --move 0,0.4,0 {camera} {options}"))
    };
    let first = at(0.0, "");
    let all = apart(&at(40.0, "--turn 40 --env-rotate 40"), &first);
    for options in ["--turn 40", "--env-rotate 40", "--turn 40 --env-rotate -40", "--turn -40 --env-rotate 40"] {
        let other = apart(&at(40.0, options), &first);
        // Samples are the same, except where rounding matters at an edge.
        assert!(other > 4e-3 && all < 0.1 * other, "{options}: {other}, all {all}");
    }
    // An alias of the same option.
    assert_eq!(at(40.0, "--turn 40 --turn-env 40"), at(40.0, "--turn 40 --env-rotate 40"));
}

/// A tilted floor of the scene, and a plane instead: --plane-at, --plane-normal and --move place both
/// equally.
#[test]
fn planes_and_meshes_are_placed_alike() {
    let here = folder();
    let path = here.path();
    write_inputs(path);
    let view = "--env map.exr --depth 1 --look-from 0,1.6,3 --look-at 0,0.4,0 --fov 30";
    let mesh = composite(path, &format!("{view} --scene floor.gltf --catcher Floor --move 0.1,0.2,0"));
    // The normal is (-sin 20, cos 20, 0). The middle of the lid is 0.4 along it, and its underside 0.3 sin 20
    // lower.
    let (sin, cos) = 20_f32.to_radians().sin_cos();
    let place = format!("--move {},{},0", 0.1 - 0.4 * sin, 0.2 + 0.4 * cos - 0.3 * sin);
    let plane = |plane: &str| composite(path, &format!("{view} --scene tilted.gltf {place} {plane}"));
    let placed = apart(&plane(&format!("--plane-at 0.1,0.2,0 --plane-normal {},{cos},0", -sin)), &mesh);
    for wrong in ["", "--plane-at 0.1,0.2,0", &format!("--plane-normal {},{cos},0", -sin)] {
        let other = apart(&plane(wrong), &mesh);
        // Samples are the same; the mesh's irradiance is from a table with an error below 0.1 %.
        assert!(other > 4e-3 && placed < 0.1 * other, "{wrong}: {other}, in its place {placed}");
    }
}

/// A project with +Y up equals the rotated one with +Z up.
#[test]
fn y_up_projects_equal_rotated_z_up_projects() {
    let here = folder();
    let path = here.path();
    write_map(&path.join("map.exr"), [1.0; 3]);
    succeed(path, "view --env map.exr --width 48 --height 32 --out photo.exr");
    let bytes = fs::read(path.join("photo.fspy")).unwrap();
    let project = FspyProject::decode(&bytes, UpAxis::Z).unwrap();
    fs::write(path.join("y.fspy"), project.encode(UpAxis::Y)).unwrap();
    let of = |camera: &str| composite(path, &format!("--env map.exr --scene sphere --size 0.8 {camera}"));
    let z = of("--camera photo.fspy");
    let (y, wrong) = (apart(&of("--camera y.fspy --up y"), &z), apart(&of("--camera y.fspy"), &z));
    assert!(y < 1e-4 && wrong > 0.01, "{y}, read as with Z up {wrong}");
}

/// Scaling the light equals scaling the map: for the object, interreflection, and both kinds of masks.
#[test]
fn scaling_light_equals_scaling_the_map() {
    let here = folder();
    let path = here.path();
    write_inputs(path);
    write_map(&path.join("tinted.exr"), [3.0, 1.0, 0.25]);
    // BRDF sampling does not depend on the light, so the samples are the same.
    let view = "--scene sphere --size 0.8 --sampler brdf --depth 3 --look-from 0,1.6,3 --look-at 0,0.4,0 --fov 30";
    for mask in ["", "--grey-mask"] {
        let of = |light: &str| composite(path, &format!("{view} {mask} {light}"));
        let (expected, plain) = (of("--env tinted.exr"), of("--env map.exr"));
        let scaled = of("--env map.exr --env-scale 3,1,0.25");
        let (off, other) = (apart(&scaled, &expected), apart(&plain, &expected));
        assert!(other > 0.01 && off < 1e-5, "{mask}: {off}, unscaled {other}");
    }
    let command = format!("composite --photo photo.exr {view} --env map.exr --out no");
    assert!(fail(path, &format!("{command} --env-scale 1,1,0")).contains("--env-scale"));
}
