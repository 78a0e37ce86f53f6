//! Small valid inputs, generated here.

use std::{
    fs,
    io::Cursor,
    path::Path,
    sync::{Arc, atomic::AtomicBool},
};

use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Layer, LayerAttributes, LineOrder, SmallVec,
    Vec2, WritableImage, f16,
};
use glam::Vec3A;
use headtail_model::HeadConfig;
use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    brdf::neural_texture::{
        Description, FEATURES, MIXTURE_SIZES, Networks, NeuralTexture, Pyramid, REFLECTANCE_SIZES, SHIFT_SIZES,
    },
    environment::{Environment, built_in},
    estimator::LearnedVisibility,
    export::{ExportedSampler, Intermediate},
    head::Linear,
    image::{Attribute, Image, encode_exr, encode_png_rgb8},
    integrator::{View, learn_visibility},
    patches::Detail,
    portals::{Portal, to_json},
    rival::{Rival, RivalFile, RivalKind},
    scene::{Camera, FspyProject, Scene, UpAxis},
    tail::{Tail, TailKind},
};
use headtail_train::{CheckpointFolder, FitConfig, Run, Viewpoints, build_target, exported_sampler, fit_with};
use image::{ExtendedColorType, ImageEncoder, codecs::jpeg::JpegEncoder};
use moxcms::{ColorProfile, ToneReprCurve};
use png::{BitDepth, ColorType, Info, ScaledFloat, SourceChromaticities};

/// A small picture of arbitrary values.
fn picture(width: usize, height: usize) -> Image {
    let value = |k: usize| ((k * 37) % 19) as f32 * 0.25;
    Image { width, height, pixels: (0..width * height).map(|k| [value(k), value(k + 7), value(3 * k)]).collect() }
}

/// A file of two portals.
pub fn portals() -> Vec<u8> {
    let portal = |x: f32| Portal { center: Vec3A::X * x, normal: Vec3A::NEG_X, up: Vec3A::Y, width: 1.5, height: 2.0 };
    to_json(&[portal(1.0), portal(-3.5)]).into_bytes()
}

/// Radiance files: flat, and run-length coded.
pub fn radiance() -> Vec<Vec<u8>> {
    let header = |width: usize, height: usize| {
        format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=1.0\n\n-Y {height} +X {width}\n").into_bytes()
    };
    let mut flat = header(5, 3);
    flat.extend([40_u8, 80, 120, 129].repeat(15));
    let mut coded = header(12, 2);
    for _ in 0..2 {
        coded.extend([2, 2, 0, 12]);
        for channel in 0..4_u8 {
            // A run of 7, then 5 literals.
            coded.extend([128 + 7, 100 + channel, 5, 1, 2, 3, 4, 5]);
        }
    }
    vec![flat, coded]
}

/// OpenEXR files: every compression that can be written, tiles, and several layers.
pub fn openexr() -> Vec<Vec<u8>> {
    use Compression::{B44, DWAA, DWAB, PIZ, PXR24, RLE, Uncompressed, ZIP1, ZIP16};
    let image = picture(12, 9);
    let file = |encoding: Encoding, names: [&str; 3], is_half: bool| {
        let channel = |c: usize| {
            let values: Vec<f32> = image.pixels.iter().map(|pixel| pixel[c]).collect();
            let half = || FlatSamples::F16(values.iter().map(|&value| f16::from_f32(value)).collect());
            let samples = if is_half { half() } else { FlatSamples::F32(values.clone()) };
            AnyChannel::new(names[c], samples)
        };
        let channels = AnyChannels::sort(SmallVec::from_vec(vec![channel(0), channel(1), channel(2)]));
        let layer = Layer::new((12, 9), LayerAttributes::default(), encoding, channels);
        let mut bytes = Cursor::new(Vec::new());
        exr::prelude::Image::from_layer(layer).write().non_parallel().to_buffered(&mut bytes).unwrap();
        bytes.into_inner()
    };
    let lines = |compression| Encoding { compression, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let mut files: Vec<Vec<u8>> = [Uncompressed, RLE, ZIP1, ZIP16, PIZ, PXR24, B44, DWAA(None), DWAB(None)]
        .into_iter()
        .flat_map(|compression| [true, false].map(|is_half| file(lines(compression), ["R", "G", "B"], is_half)))
        .collect();
    let tiles = Encoding { compression: ZIP16, blocks: Blocks::Tiles(Vec2(5, 4)), line_order: LineOrder::Unspecified };
    files.push(file(tiles, ["beauty.R", "beauty.G", "beauty.B"], true));
    files.push(file(lines(ZIP1), ["RY", "Y", "BY"], false));
    files.push(encode_exr(&image, &[]).unwrap());
    for id in ["lin_rec2020_scene", "srgb_p3d65_scene", "unknown"] {
        files.push(encode_exr(&image, &[Attribute::new("colorInteropID", id)]).unwrap());
    }
    files
}

/// Photographs: JPEG and PNG files with ICC profiles of matrices, tables and grey, and PNG files with other
/// descriptions of their colours.
pub fn photographs() -> Vec<Vec<u8>> {
    let mut tables = ColorProfile::new_adobe_rgb();
    tables.green_trc = Some(ToneReprCurve::Lut((0..64).map(|k| 1024 * k).collect()));
    let p3 = ColorProfile::new_display_p3();
    let jpeg = |profile: &ColorProfile| {
        let mut bytes = Vec::new();
        let mut encoder = JpegEncoder::new(&mut bytes);
        encoder.set_icc_profile(profile.encode().unwrap()).unwrap();
        encoder.encode(&[90; 8 * 8 * 3], 8, 8, ExtendedColorType::Rgb8).unwrap();
        bytes
    };
    let png = |color: ColorType, profile: Option<&ColorProfile>| {
        let mut info = Info::with_size(3, 2);
        (info.color_type, info.bit_depth) = (color, BitDepth::Sixteen);
        info.icc_profile = profile.map(|profile| profile.encode().unwrap().into());
        info.source_gamma = Some(ScaledFloat::new(0.6));
        let of = |x: f32| (x, 0.3);
        info.source_chromaticities = Some(SourceChromaticities::new((0.31, 0.33), of(0.7), (0.2, 0.7), of(0.1)));
        let mut bytes = Vec::new();
        let mut writer = png::Encoder::with_info(&mut bytes, info).unwrap().write_header().unwrap();
        writer.write_image_data(&vec![77; 6 * 2 * color.samples()]).unwrap();
        writer.finish().unwrap();
        bytes
    };
    let gray = ColorProfile::new_gray_with_gamma(1.8);
    let mut files = vec![jpeg(&tables), jpeg(&p3), jpeg(&gray)];
    files.extend([png(ColorType::Rgb, Some(&p3)), png(ColorType::Grayscale, Some(&gray)), png(ColorType::Rgba, None)]);
    files.extend([openexr().pop().unwrap(), radiance().pop().unwrap()]);
    files
}

/// A textured triangle as `.glb`, files of rarer features and of broken unused parts, and the first one as
/// `.gltf`.
pub fn gltf() -> Vec<Vec<u8>> {
    let mut bin = Vec::new();
    for value in [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0] {
        bin.extend(value.to_le_bytes());
    }
    for index in [0_u16, 1, 2, 0] {
        bin.extend(index.to_le_bytes());
    }
    let png = encode_png_rgb8(2, 2, &[[255, 0, 0], [0, 255, 0], [0, 0, 255], [9, 9, 9]]).unwrap();
    let image = bin.len();
    bin.extend(&png);
    bin.resize(bin.len().next_multiple_of(4), 0);
    let json = |uri: &str| {
        format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0,1]}}],
"nodes":[{{"mesh":0,"children":[2],"scale":[1,2,1]}},{{"camera":0,"translation":[0,0,3]}},{{"mesh":0,"rotation":[0,0,0,1]}}],
"cameras":[{{"type":"perspective","perspective":{{"yfov":0.6,"znear":0.1}}}}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":2}},"indices":1,"material":0}}]}}],
"materials":[{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}},"metallicFactor":0.5,"roughnessFactor":0.4}},"normalTexture":{{"index":0,"scale":0.5}}}}],
"textures":[{{"source":0,"sampler":0}}],"samplers":[{{"wrapS":33071}}],"images":[{{"bufferView":2,"mimeType":"image/png"}}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}},
{{"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"}},{{"bufferView":0,"byteOffset":36,"componentType":5126,"count":3,"type":"VEC2"}}],
"bufferViews":[{{"buffer":0,"byteLength":60}},{{"buffer":0,"byteOffset":60,"byteLength":6}},{{"buffer":0,"byteOffset":{image},"byteLength":{}}}],
"buffers":[{{"byteLength":{}{uri}}}]}}"#,
            png.len(),
            bin.len()
        )
        .into_bytes()
    };
    let [rare, loose] = [RARE, LOOSE].map(|json| glb(json.as_bytes(), &rare_numbers()));
    vec![glb(&json(""), &bin), rare, loose, json(r#","uri":"data:application/octet-stream;base64,AAAAAAAAAAAAAAAA""#)]
}

fn glb(json: &[u8], bin: &[u8]) -> Vec<u8> {
    let chunk = |kind: &[u8; 4], data: &[u8], fill: u8| {
        let mut padded = data.to_vec();
        padded.resize(data.len().next_multiple_of(4), fill);
        [&(padded.len() as u32).to_le_bytes()[..], kind, &padded].concat()
    };
    let chunks = [chunk(b"JSON", json, b' '), chunk(b"BIN\0", bin, 0)].concat();
    [&b"glTF"[..], &2_u32.to_le_bytes(), &(12 + chunks.len() as u32).to_le_bytes(), &chunks].concat()
}

/// A skin, morph targets, instances, sparse elements, an alpha mask, vertex colours, and two scenes.
const RARE: &str = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0,1,2]},{"name":"other","nodes":[3]}],
"nodes":[{"mesh":0,"skin":0},{"children":[4],"translation":[0,0,1]},
{"mesh":0,"extensions":{"EXT_mesh_gpu_instancing":{"attributes":{"TRANSLATION":4,"SCALE":0}}},"weights":[0.5]},
{"mesh":0},{"rotation":[0,0.6,0,0.8]}],
"skins":[{"joints":[1,4],"inverseBindMatrices":5}],
"meshes":[{"weights":[0.25],"primitives":[{"attributes":{"POSITION":0,"NORMAL":6,"TEXCOORD_0":1,"COLOR_0":7,"JOINTS_0":3,"WEIGHTS_0":2},
"targets":[{"POSITION":4}],"material":0,"mode":5}]}],
"materials":[{"alphaMode":"MASK","alphaCutoff":0.6,"emissiveFactor":[1,0.5,0],"extensions":{"KHR_materials_emissive_strength":{"emissiveStrength":3}},
"pbrMetallicRoughness":{"baseColorFactor":[1,1,1,0.7]}}],
"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},{"bufferView":0,"componentType":5126,"count":3,"type":"VEC2"},
{"bufferView":0,"componentType":5126,"count":3,"type":"VEC4"},{"bufferView":1,"componentType":5121,"count":3,"type":"VEC4"},
{"componentType":5126,"count":3,"type":"VEC3","sparse":{"count":1,"indices":{"bufferView":1,"componentType":5121},"values":{"bufferView":0}}},
{"bufferView":0,"componentType":5126,"count":2,"type":"MAT4"},{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},
{"bufferView":0,"byteOffset":8,"componentType":5126,"count":3,"type":"VEC4"}],
"bufferViews":[{"buffer":0,"byteLength":128},{"buffer":0,"byteOffset":128,"byteLength":12}],
"buffers":[{"byteLength":140}]}"#;

/// Cameras, sides, compression with a fallback, broken parts that nothing uses, and a texture of the parent folder.
const LOOSE: &str = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0,1,2]},{"nodes":7}],
"nodes":[{"mesh":0,"scale":[-1,1,1]},{"camera":1,"scale":[0,1,-1]},{"camera":-1},{"mesh":9,"rotation":[0,0,0,0]}],
"cameras":[{"type":"orthographic","orthographic":{"ymag":0}},{"type":"orthographic","orthographic":{"ymag":2}},3],
"meshes":[{"name":"ball","extensions":{"A":{}},"primitives":[{"attributes":{"POSITION":0,"TEXCOORD_0":1},"material":0,
"extensions":{"KHR_draco_mesh_compression":{"bufferView":0,"attributes":{"POSITION":0}}}}]},{"primitives":"none"}],
"materials":[{"doubleSided":true,"alphaMode":"MASK","pbrMetallicRoughness":{"baseColorFactor":[1,1,1,0.7]}},
{"doubleSided":false,"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}}],"skins":[{"joints":"x"}],
"textures":[{"source":0,"sampler":0}],"samplers":[{"magFilter":9728,"minFilter":9984,"wrapS":33648}],"images":[{"uri":"../a/%C3%A9.png"}],
"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},{"bufferView":1,"componentType":5126,"count":3,"type":"VEC2"},
{"componentType":5126,"count":3,"type":"VEC3","extensions":{"A":{}}},{"count":"many"}],
"bufferViews":[{"buffer":0,"byteLength":128,"extensions":{"EXT_meshopt_compression":{"buffer":1}}},{"buffer":0,"byteLength":128},{"buffer":1,"byteLength":9}],
"buffers":[{"byteLength":140},{"byteLength":9,"extensions":{"EXT_meshopt_compression":{"fallback":true}}}]}"#;

/// Numbers for positions, weights and matrices, then joints and an index.
fn rare_numbers() -> Vec<u8> {
    let number = |k: u32| if k.is_multiple_of(5) { 1.0 } else { 0.25 * (k * 7 % 4) as f32 };
    (0..32).flat_map(|k| number(k).to_le_bytes()).chain([1, 0, 1, 0, 0, 1, 0, 0, 1, 1, 0, 0]).collect()
}

/// Precomputed visibility of a scene, with few cells.
pub fn visibility(folder: &Path) -> Vec<u8> {
    let environment = Arc::new(built_in("overcast").unwrap());
    let scene = Scene::built_in("plane").unwrap();
    // Enough rays for about ten cells.
    let estimator = LearnedVisibility::new(environment.clone(), Detail::Leaves, 60_000).unwrap();
    let camera = scene.camera();
    let (scene, camera, environment) = (&scene, &camera, &*environment);
    let view = View { scene, camera, environment, width: 16, height: 12, unshadowed: false, depth: 1 };
    let learned = learn_visibility(view, &estimator, None, (1, 0), &AtomicBool::new(false), &|_| {});
    let path = folder.join("visibility");
    learned.write(&path).unwrap();
    fs::read(&path).unwrap()
}

/// Two rows of small weights.
pub fn measured() -> Vec<u8> {
    (0..2 * 675).flat_map(|k| (((k * 37) % 19) as f32 * 0.01 - 0.09).to_le_bytes()).collect()
}

/// Network layers with small weights.
fn layers(sizes: &[usize]) -> Vec<Linear> {
    let weight = |k: usize| ((k * 37) % 19) as f32 * 0.01 - 0.09;
    let layer = |size: &[usize]| {
        let weights: Vec<f32> = (0..size[0] * size[1]).map(weight).collect();
        Linear::new("layer", size[0], size[1], &weights, vec![0.1; size[1]]).unwrap()
    };
    sizes.windows(2).map(layer).collect()
}

/// Published samplers trained for materials, of every kind.
pub fn rivals(folder: &Path) -> Vec<Vec<u8>> {
    let file = |kind: RivalKind| {
        let networks = kind.networks().iter().map(|(_, sizes)| layers(sizes)).collect();
        let rival = Rival::new(kind, networks).unwrap();
        let path = folder.join("rival");
        let rivals = vec![("cloth".to_owned(), blake3::hash(b"cloth"), rival)];
        RivalFile { kind, rivals, seconds: None }.write(&path).unwrap();
        fs::read(path).unwrap()
    };
    RivalKind::ALL.into_iter().map(file).collect()
}

/// A neural material of four texels.
pub fn neural_texture(folder: &Path) -> Vec<u8> {
    let texels = vec![[0.25; FEATURES]; Pyramid::texel_count(2)];
    let (shift, reflectance, mixture) = (layers(&SHIFT_SIZES), layers(&REFLECTANCE_SIZES), layers(&MIXTURE_SIZES));
    let networks = Networks { shift, reflectance, mixture, leaky_slope: 0.01 };
    let pyramid = Pyramid::new(2, texels).unwrap();
    let material = NeuralTexture::new(pyramid, networks, Description::new("cloth", 0.01)).unwrap();
    let path = folder.join("cloth");
    material.rounded().unwrap().write(&path).unwrap();
    fs::read(path).unwrap()
}

/// A project of fSpy with a small picture.
pub fn fspy() -> Vec<Vec<u8>> {
    let camera = Camera::new(Vec3A::new(0.0, 1.6, 4.0), Vec3A::Y, 40.0).unwrap();
    let image = encode_png_rgb8(2, 2, &[[9, 8, 7]; 4]).unwrap();
    vec![FspyProject { camera, width: 640, height: 480, image }.encode(UpAxis::Z)]
}

/// Settings of an instant training.
pub fn config() -> FitConfig {
    let head = HeadConfig { bins: 4, hidden: 4, ..HeadConfig::COSINE };
    FitConfig {
        head,
        steps: 2,
        conditions: 4,
        strata: 2,
        validation_conditions: 2,
        validation_strata: 4,
        ..FitConfig::default()
    }
}

/// Returns a head and a table as exported files, the state of a checkpoint, and its number of weights.
pub fn trained(folder: &Path) -> (Vec<Vec<u8>>, Vec<u8>, usize) {
    let map = Environment::from_image("small", picture(16, 8)).unwrap();
    let config = config();
    let tail = Arc::new(Tail::of_environment(TailKind::Hierarchical, &map).unwrap());
    let target = build_target(&config, &tail, Viewpoints::Sphere).unwrap();
    let checkpoints =
        CheckpointFolder { folder: folder.join("made"), every: 1, resume: false, target: "target".into() };
    let (interrupt, warn) = (AtomicBool::new(false), &mut |_: &headtail_train::Error| {});
    let run = Run { progress: &mut |_| Ok(()), interrupt: &interrupt, checkpoints: Some(&checkpoints), warn };
    let fitted = fit_with(&config, &*target, run).unwrap();
    let checkpoint = fs::read(folder.join("made/step-000000002")).unwrap();
    let head = exported_sampler(&fitted.head, &config, &fitted.summary, &map, &tail, false).unwrap();
    let table = direct_bake(&tail, NormalGrid::new(2, 3).unwrap(), CellGrid::new(2, 4).unwrap()).unwrap();
    let table = ExportedSampler::new(Intermediate::DirectBake(table), TailKind::Hierarchical, &map, None).unwrap();
    let encode = |sampler: &ExportedSampler| {
        let path = folder.join("sampler");
        sampler.write(&path).unwrap();
        fs::read(path).unwrap()
    };
    (vec![encode(&head), encode(&table)], checkpoint, fitted.head.weight_count())
}

/// Settings as TOML, and individual assignments.
pub fn toml() -> Vec<Vec<u8>> {
    vec![
        config().to_toml().unwrap().into_bytes(),
        b"steps = 7\nhead.bins = 16\n[flow]\ncells = 64\n".to_vec(),
        b"material = \"ggx:alpha=0.2..0.8\"\nloss = 'forward-kl'\nlearning_rate = 1e-3\n".to_vec(),
    ]
}

/// Names of samplers, and of materials.
pub fn specs() -> Vec<Vec<u8>> {
    let names = [
        "mis",
        "mis2",
        "mis-comp",
        "mis2-comp",
        "brdf",
        "cosine",
        "emitter",
        "oracle",
        "patches",
        "patches:fine",
        "patches+vis",
        "ris:4",
        "ris:64:patches",
        "head:a/b.safetensors",
        "head+mis:a.safetensors",
        "ris:8:head:a.safetensors",
        "direct:x",
        "lambert",
        "lambert:albedo=0.5",
        "ggx:alpha=0.4",
        "ggx:alpha=0.2..0.8,f0=0.04",
    ];
    names.map(|name| name.as_bytes().to_vec()).to_vec()
}
