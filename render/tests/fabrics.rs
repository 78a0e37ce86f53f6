//! The neural materials that ship with the project: they load, go where they belong, and every sampler renders the same picture of them.

use std::sync::{Arc, atomic::AtomicBool};

use glam::Vec3A;
use headtail_render::{
    brdf::NeuralTexture,
    environment::built_in,
    image::Image,
    integrator::{Budget, View, render},
    points::{PointSet, Points},
    scene::{MaterialSpec, Ray, Scene},
    spec::SamplerSpec,
    statistics::{compare_images, sidak},
};

/// The specification of a shipped material.
fn spec(name: &str, settings: &str) -> MaterialSpec {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../checkpoints");
    format!("neural:{folder}/{name}.safetensors{settings}").parse().unwrap()
}

fn dressed(scene: &str, name: &str, settings: &str) -> headtail_render::Result<Scene> {
    let scene = Scene::built_in(scene).unwrap();
    let bounds = scene.bounds();
    spec(name, settings).dress(scene, &bounds)
}

#[test]
fn shipped_materials_say_what_they_are() {
    for name in ["welt", "satin", "velvet"] {
        let MaterialSpec::Neural(spec) = spec(name, "") else { panic!("{name}") };
        let material = NeuralTexture::read(&spec.file).unwrap();
        assert_eq!((material.description().name.as_str(), material.pyramid().side()), (name, 64));
        assert!(material.description().psnr.is_some());
    }
}

#[test]
fn every_sampler_renders_the_same_picture_of_every_fabric() {
    const SAMPLERS: [&str; 5] = ["brdf", "emitter", "mis", "ris:4", "patches"];
    const SCENES: [(&str, &str, &str); 3] =
        [("bedroom", "welt", ",repeat=24"), ("cloth", "satin", ",repeat=20"), ("cloth", "velvet", ",repeat=12")];
    let environment = Arc::new(built_in("window").unwrap());
    let pairs = SAMPLERS.len() * (SAMPLERS.len() - 1) / 2;
    for (scene, name, settings) in SCENES {
        let scene = dressed(scene, name, settings).unwrap();
        let camera = scene.camera();
        let image = |(k, sampler): (usize, &&str)| -> (String, Image) {
            let view = View {
                scene: &scene,
                camera: &camera,
                environment: &environment,
                width: 48,
                height: 32,
                unshadowed: false,
                depth: 1,
            };
            let sampler: SamplerSpec = sampler.parse().unwrap();
            let estimator = sampler.build(&environment).unwrap();
            let points = Points::new(PointSet::Sobol, 10 + k as u64);
            let stop = AtomicBool::new(false);
            (sampler.to_string(), render(view, &*estimator, Budget::Spp(64), points, &stop, &|_| {}).surfaces)
        };
        let images: Vec<(String, Image)> = SAMPLERS.iter().enumerate().map(image).collect();
        for (k, (first, a)) in images.iter().enumerate() {
            for (second, b) in &images[k + 1..] {
                let test = compare_images(a, b, 16, sidak(0.01, SCENES.len() * pairs)).unwrap();
                assert!(test.passed(), "{name}, {first} against {second}: {test}");
            }
        }
    }
}

#[test]
fn a_material_goes_on_what_has_coordinates_and_on_what_is_named() {
    assert!(dressed("plane", "satin", "").is_ok());
    let error = |scene: &str, settings: &str| dressed(scene, "satin", settings).err().unwrap().to_string();
    assert!(error("sphere", "").contains("no mesh of the scene has texture coordinates"));
    assert!(error("sphere", ",on=hat").contains("no mesh is called hat: none has a name"));
    assert!(error("cloth", ",on=hat").contains("no mesh is called hat; meshes are fabric"));
    let missing: MaterialSpec = "neural:nowhere.safetensors".parse().unwrap();
    let plane = Scene::built_in("plane").unwrap();
    let bounds = plane.bounds();
    assert!(missing.dress(plane, &bounds).err().unwrap().to_string().starts_with("nowhere.safetensors: "));
    assert_ne!(
        dressed("plane", "satin", "").unwrap().content_hash(),
        dressed("plane", "velvet", "").unwrap().content_hash()
    );
}

#[test]
fn the_tangent_frame_is_the_surfaces_and_features_shift_with_the_view() {
    let scene = dressed("plane", "satin", ",repeat=3").unwrap();
    let seen = |offset: Vec3A| {
        let target = Vec3A::new(0.13, 0.0, -0.21);
        scene.intersect(&Ray::new(target + offset, -offset.normalize())).unwrap().surface.parameters
    };
    let (along, across) = (seen(Vec3A::new(0.6, 0.8, 0.0)), seen(Vec3A::new(0.0, 0.8, 0.6)));
    assert_eq!(along[8..], across[8..]);
    assert_ne!(along[..8], across[..8]);
    assert!((along[8].hypot(along[9]) - 1.0).abs() < 1e-6 && along[10].abs() == 1.0);
}
