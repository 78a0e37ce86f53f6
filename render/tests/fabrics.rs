//! The project's neural materials: they load, are assigned to the correct meshes, and every sampler renders
//! the same picture of them.

mod layers;

use std::{
    path::Path,
    sync::{Arc, atomic::AtomicBool},
};

use glam::{Vec2, Vec3, Vec3A};
use headtail_render::{
    brdf::{NeuralTexture, neural_texture::Seen},
    environment::{Environment, built_in},
    export::{ExportedSampler, Intermediate, TrainingSummary},
    head::{Condition, Head, Linear, Mode},
    image::Image,
    integrator::{Budget, View, render},
    patches::Detail,
    points::{PointSet, Points},
    random::{Purpose, Stream},
    rival::{Rival, RivalFile, RivalKind},
    scene::{MaterialSpec, Ray, Scene},
    spec::{BuildContext, SamplerSpec},
    statistics::{compare_images, sidak},
    tail::TailKind,
};
use layers::random_layers;

/// Returns the specification of a shipped material.
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
fn shipped_materials_have_a_description() {
    for name in ["welt", "satin", "velvet", "jersey"] {
        let MaterialSpec::Neural(spec) = spec(name, "") else { panic!("{name}") };
        let material = NeuralTexture::read(&spec.file).unwrap();
        assert_eq!((material.description().name.as_str(), material.pyramid().side()), (name, 64));
        assert!(material.description().psnr.is_some());
    }
}

/// Writes files of a head with random weights that is conditioned on the features at the point, and of one
/// over patches, and returns the samplers' specifications.
fn heads(environment: &Environment, folder: &Path) -> Vec<String> {
    let mut random = Stream::new(5, Purpose::Weights, 0);
    let mut network = |sizes: &[usize]| random_layers(sizes, &mut random, |inputs| [2.0 / (inputs as f32).sqrt(); 2]);
    let seen = Condition::Texture.length();
    let networks = [network(&[seen + 2, 16, 16, 13]), network(&[seen + 1, 16, 16, 13])];
    let head = Head::new(Condition::Texture, Mode::Coupled, 0.01, Vec::new(), networks).unwrap();
    let head = head.with_mixture_weight(network(&[seen, 8, 1])).unwrap();
    let file = |name: &str, patches: bool| {
        let head = Intermediate::Head(head.clone());
        let training = TrainingSummary::default();
        let sampler = ExportedSampler::new(head, TailKind::Hierarchical, environment, Some(training)).unwrap();
        let sampler = if patches { sampler.over_patches(Detail::Leaves) } else { sampler };
        let path = folder.join(name);
        sampler.write(&path).unwrap();
        path.display().to_string()
    };
    let (tail, patches) = (file("over-tail", false), file("over-patches", true));
    vec![
        format!("head:{tail}"),
        format!("head+mis:{tail}"),
        format!("head+patches:{patches}"),
        "patches+vis".into(),
        format!("head+patches+vis:{patches}"),
    ]
}

#[test]
fn every_sampler_renders_the_same_picture_of_every_fabric() {
    const SCENES: [(&str, &str, &str); 3] =
        [("bedroom", "welt", ",repeat=24"), ("cloth", "satin", ",repeat=20"), ("cloth", "velvet", ",repeat=12")];
    let environment = Arc::new(built_in("window").unwrap());
    let folder = tempfile::tempdir().unwrap();
    let mut samplers = ["brdf", "emitter", "mis", "ris:4", "patches"].map(str::to_owned).to_vec();
    samplers.extend(heads(&environment, folder.path()));
    let pairs = samplers.len() * (samplers.len() - 1) / 2;
    for (scene, name, settings) in SCENES {
        let scene = dressed(scene, name, settings).unwrap();
        let camera = scene.camera();
        let image = |(k, sampler): (usize, &String)| -> (String, Image) {
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
            let context = BuildContext { always: true, ..BuildContext::default() };
            let estimator = sampler.build_in(&environment, context).unwrap();
            let points = Points::new(PointSet::Sobol, 10 + k as u64);
            let stop = AtomicBool::new(false);
            (sampler.to_string(), render(view, &*estimator, Budget::Spp(64), points, &stop, &|_| {}).surfaces)
        };
        let images: Vec<(String, Image)> = samplers.iter().enumerate().map(image).collect();
        for (k, (first, a)) in images.iter().enumerate() {
            for (second, b) in &images[k + 1..] {
                let test = compare_images(a, b, 16, sidak(0.01, SCENES.len() * pairs)).unwrap();
                assert!(test.passed(), "{name}, {first} against {second}: {test}");
            }
        }
    }
}

#[test]
fn materials_are_assigned_to_meshes_with_coordinates_or_by_name() {
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
fn the_tangent_frame_is_that_of_the_surface_and_features_shift_with_the_view() {
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

/// Writes a glTF file with one quad, 2 m along x and 1 m along -z, whose texture coordinates fill the unit
/// square.
fn quad(folder: &std::path::Path) -> std::path::PathBuf {
    let floats: [f32; 32] = [
        0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 2.0, 0.0, -1.0, 0.0, 0.0, -1.0, // positions
        0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, // normals
        0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0, // texture coordinates
    ];
    let mut bytes: Vec<u8> = floats.iter().flat_map(|number| number.to_le_bytes()).collect();
    bytes.extend([0_u16, 1, 2, 0, 2, 3].iter().flat_map(|index| index.to_le_bytes()));
    std::fs::write(folder.join("quad.bin"), bytes).unwrap();
    let text = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "name": "cushion"}],
        "meshes": [{"name": "cushion", "primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "indices": 3}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, -1], "max": [2, 0, 0]},
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 2, "componentType": 5126, "count": 4, "type": "VEC2"},
            {"bufferView": 3, "componentType": 5123, "count": 6, "type": "SCALAR"}],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 48},
            {"buffer": 0, "byteOffset": 96, "byteLength": 32}, {"buffer": 0, "byteOffset": 128, "byteLength": 12}],
        "buffers": [{"uri": "quad.bin", "byteLength": 140}]}"#;
    let file = folder.join("quad.gltf");
    std::fs::write(&file, text).unwrap();
    file
}

#[test]
fn a_gltf_mesh_maps_a_material_by_its_texture_coordinates() {
    let folder = tempfile::tempdir().unwrap();
    let file = quad(folder.path());
    for settings in [",repeat=3", ",repeat=3,on=cushion"] {
        let MaterialSpec::Neural(neural) = spec("satin", settings) else { panic!("{settings}") };
        let texture = NeuralTexture::read(&neural.file).unwrap();
        let scene = Scene::load(&file).unwrap();
        let bounds = scene.bounds();
        let scene = spec("satin", settings).dress(scene, &bounds).unwrap();
        let wo = Vec3A::new(0.48, 0.6, 0.64);
        let target = Vec3A::new(0.31, 0.0, -0.77);
        let at = scene.intersect(&Ray::new(target + wo, -wo)).unwrap();
        // u is x / 2, v is -z; the tangents are x and -z.
        let uv = 3.0 * Vec2::new(0.5 * 0.31, 0.77);
        let local = Vec3::new(wo.x, -wo.z, wo.y);
        let expected = texture.features(&Seen { uv, width: 0.0, wo: local, tangent: [1.0, 0.0, 1.0] });
        // Rounding of positions and views by 1e-6, over 64 texels per tile.
        let apart = at.surface.parameters.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(apart < 1e-3, "{settings}: {:?} {expected:?}", at.surface.parameters);
        assert_eq!(at.surface.parameters[10], 1.0);
    }
    let scene = Scene::load(&file).unwrap();
    let bounds = scene.bounds();
    let error = spec("satin", ",on=hat").dress(scene, &bounds).err().unwrap().to_string();
    assert!(error.contains("meshes are cushion"), "{error}");
}

/// Returns a sampler of random weights for a material. The flow's Gaussian is about as wide as the disk, so
/// that weights have finite variance.
fn random_rival(kind: RivalKind, random: &mut Stream) -> Rival {
    let mut layer = |name: &str, inputs: usize, outputs: usize| {
        let size = 1.0 / (inputs as f32).sqrt();
        let weight: Vec<f32> = (0..inputs * outputs).map(|_| size * (random.uniform() - 0.5)).collect();
        let middle = |output: usize| if name == "prior" && outputs == 4 && output >= 2 { 0.85 } else { 0.0 };
        let bias = (0..outputs).map(|output| middle(output) + 0.2 * (random.uniform() - 0.5)).collect();
        Linear::new(name, inputs, outputs, &weight, bias).unwrap()
    };
    let networks = kind.networks().iter();
    Rival::new(
        kind,
        networks.map(|(name, sizes)| sizes.windows(2).map(|s| layer(name, s[0], s[1])).collect()).collect(),
    )
    .unwrap()
}

/// Rivals alone and in one-sample MIS with emitter sampling; points on other materials use BRDF sampling.
#[test]
fn rivals_render_the_same_picture_as_mis() {
    let environment = Arc::new(built_in("overcast").unwrap());
    let scene = dressed("bedroom", "satin", ",repeat=20").unwrap();
    let MaterialSpec::Neural(neural) = spec("satin", "") else { panic!("satin") };
    let identity = NeuralTexture::read(&neural.file).unwrap().hash();
    let folder = tempfile::tempdir().unwrap();
    let mut random = Stream::new(4, Purpose::Test, 0);
    let mut samplers = vec!["mis".to_owned()];
    for kind in RivalKind::ALL {
        let file = folder.path().join(kind.name());
        let rivals = vec![("satin".to_owned(), identity, random_rival(kind, &mut random))];
        RivalFile { kind, rivals, seconds: None }.write(&file).unwrap();
        let name = if kind == RivalKind::Reparam { "reparam" } else { "neusample" };
        samplers.extend([format!("{name}:{}", file.display()), format!("{name}+emitter:{}", file.display())]);
    }
    let camera = scene.camera();
    let image = |(k, sampler): (usize, &String)| -> Image {
        let (width, height) = (48, 32);
        let view = View {
            scene: &scene,
            camera: &camera,
            environment: &environment,
            width,
            height,
            unshadowed: false,
            depth: 1,
        };
        let sampler: SamplerSpec = sampler.parse().unwrap();
        assert_eq!(sampler.to_string(), samplers[k]);
        let context = BuildContext { scene: Some(&scene), ..BuildContext::default() };
        let estimator = sampler.build_in(&environment, context).unwrap();
        let points = Points::new(PointSet::Independent, 20 + k as u64);
        let stop = AtomicBool::new(false);
        render(view, &*estimator, Budget::Spp(128), points, &stop, &|_| {}).surfaces
    };
    let images: Vec<Image> = samplers.iter().enumerate().map(image).collect();
    for (sampler, other) in samplers.iter().zip(&images).skip(1) {
        let test = compare_images(&images[0], other, 16, sidak(0.01, samplers.len() - 1)).unwrap();
        assert!(test.passed(), "{sampler}: {test}");
    }
    let context = BuildContext { scene: Some(&Scene::built_in("bedroom").unwrap()), ..BuildContext::default() };
    let error = samplers[1].parse::<SamplerSpec>().unwrap().build_in(&environment, context).err().unwrap().to_string();
    assert!(error.contains("a material that the scene does not have"), "{error}");
}
