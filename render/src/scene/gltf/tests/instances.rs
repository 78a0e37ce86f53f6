//! Meshes that several nodes show: copied, or by reference.

use glam::Vec3A;
use serde_json::json;

use super::{
    glb,
    masks::square,
    set,
    unusual::{add_floats, warnings},
};
use crate::scene::{LoadOptions, Ray, Scene, gltf::MOST_COPIED};

#[test]
fn copies_by_reference_equal_copied_meshes() {
    // A square with holes, in four places, one of them mirrored; another square, shown once; a flat one that
    // cannot be a reference.
    let (mut json, mut bin) = square([255, 0, 0, 255]);
    let places = add_floats(&mut json, &mut bin, "VEC3", &[0.0, 0.0, 0.0, 1.5, 0.0, 0.5, 0.2, 0.9, -0.5]);
    let sizes = add_floats(&mut json, &mut bin, "VEC3", &[1.0, 1.0, 1.0, -0.7, 2.0, 1.5, 1.0, 0.5, 0.0]);
    let extension = json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places, "SCALE": sizes}}});
    let mut nodes = json!([
        {"name": "first", "mesh": 0, "extensions": extension},
        {"name": "second", "mesh": 0, "rotation": [0.0, 0.3, 0.0, 0.954], "translation": [-0.5, 0.2, 0.3]},
        {"name": "floor", "mesh": 1, "translation": [0, 0, -1], "scale": [3, 3, 1]}
    ]);
    let mut floor = json["meshes"][0].clone();
    floor["primitives"][0].as_object_mut().unwrap().remove("material");
    json["meshes"].as_array_mut().unwrap().push(floor);
    set(&mut json, "/scenes/0/nodes", json!([0, 1, 2]));
    for far in [0.0, 5e6] {
        for k in 0..3 {
            let z = [0.0, 0.3, -1.0][k];
            let x = if k == 1 { -0.5 } else { 0.0 };
            nodes[k]["translation"] = json!([x + far, 0.2, z]);
        }
        set(&mut json, "/nodes", nodes.clone());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.glb");
        std::fs::write(&path, glb(json.to_string().as_bytes(), &bin)).unwrap();
        let scenes = [0, MOST_COPIED].map(|most| Scene::load_within(&path, &LoadOptions::default(), most).unwrap());
        let [shared, copied] = &scenes;
        assert_eq!(shared.meshes.iter().map(|mesh| mesh.places.len()).collect::<Vec<_>>(), [3, 0, 0]);
        assert_eq!(shared.mesh_names().into_iter().collect::<Vec<_>>(), ["first", "floor"]);
        assert_eq!(shared.triangle_count(), copied.triangle_count());
        assert_eq!(shared.remarks().len(), copied.remarks().len());
        assert!(warnings(shared).is_empty());
        let center = copied.bounds().center();
        let (mut hits, mut shadows) = (0, 0);
        for k in 0..2500 {
            let (x, y) = ((k % 50) as f32 / 25.0 - 1.0, (k / 50) as f32 / 25.0 - 1.0);
            let origin = center + Vec3A::new(2.003 * x, 1.507 * y, 3.0);
            let ray = Ray::new(origin, Vec3A::new(0.01, -0.02, -1.0).normalize());
            let [a, b] = scenes.each_ref().map(|scene| scene.intersect(&ray));
            assert_eq!(a.is_some(), b.is_some(), "{x}, {y}");
            let Some((a, b)) = a.zip(b) else { continue };
            hits += 1;
            assert!(a.p.distance(b.p) < 1e-5 && a.ng.dot(b.ng) > 0.9999 && a.ns.dot(b.ns) > 0.9999, "{x}, {y}");
            assert_eq!(a.surface.brdf, b.surface.brdf);
            let up = Vec3A::new(0.3, 0.2, 0.9).normalize();
            let visible = scenes.each_ref().map(|scene| {
                let mut visible = [false];
                scene.visible_batch(&[scene.leaving(b.p, b.ng, up)], &mut visible);
                visible[0]
            });
            shadows += usize::from(!visible[1]);
            assert_eq!(visible[0], visible[1], "{x}, {y}");
        }
        assert!(hits > 1000 && shadows > 100, "{hits}, {shadows}");
    }
}
