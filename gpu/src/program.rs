//! Scenes under maps, and the whole shader of a sampler there, with the buffers that they read.

use std::{fmt::Write, sync::Arc};

use headtail_render::{
    environment::Environment,
    memory,
    points::Dimension,
    scene::Scene,
    spec::{BuildContext, SamplerSpec},
};
use headtail_shaders::{BRDF, FITTED, Shader};

use crate::{error::Result, geometry::Geometry, map, sampler::DeviceSampler, surfaces::Surfaces};

const POINTS: &str = include_str!("../wgsl/points.wgsl");
const RAYS: &str = include_str!("../wgsl/rays.wgsl");
const MAP: &str = include_str!("../wgsl/map.wgsl");
const SURFACE: &str = include_str!("../wgsl/surface.wgsl");
const REFLECTION: &str = include_str!("../wgsl/reflection.wgsl");
const ON_TEXTURES: [&str; 2] = [include_str!("../wgsl/neural_texture.wgsl"), include_str!("../wgsl/fitted_point.wgsl")];
const NO_FITTED: &str = include_str!("../wgsl/no_fitted.wgsl");
const PATH: &str = include_str!("../wgsl/path.wgsl");

/// The compute shader's entry point: one invocation per pixel, in workgroups of 8 x 8.
pub const ENTRY_POINT: &str = "headtail_render";
/// Pixels along a side of a workgroup.
pub const WORKGROUP_SIDE: u32 = 8;
/// Vectors of four numbers for each pixel of the film.
pub const FILM_VECTORS: usize = 3;

/// Bytes of a face while it is flattened, hierarchy and words included.
const BYTES_PER_FACE: usize = 1000;

/// A storage buffer of the shader, in the order of the bindings of group 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Binding {
    /// [`Program::floats`].
    Floats,
    /// [`Program::integers`].
    Integers,
    /// [`LitScene::geometry`].
    Geometry,
    /// [`LitScene::surfaces`].
    Surfaces,
    /// [`LitScene::texels`].
    Texels,
    /// The film: three vectors of four numbers for each pixel of the part, to which samples are added: light from
    /// surfaces and number of shadow rays; background and number of camera rays that hit; largest luminance of a
    /// contribution. The only one that is written.
    Film,
    /// [`ViewWords`](crate::ViewWords).
    View,
    /// [`visibility_words`](crate::visibility_words); any words for programs without visibility.
    Visibility,
}

/// The bindings of group 0, from 0 on.
pub const BINDINGS: [Binding; 8] = [
    Binding::Floats,
    Binding::Integers,
    Binding::Geometry,
    Binding::Surfaces,
    Binding::Texels,
    Binding::Film,
    Binding::View,
    Binding::Visibility,
];

/// A scene under a map, for the programs of any number of samplers.
#[derive(Clone, Debug)]
pub struct LitScene {
    geometry: Geometry,
    surfaces: Surfaces,
    environment: Arc<Environment>,
    texels: Vec<f32>,
}

impl LitScene {
    /// Flattens a scene and a map.
    ///
    /// # Errors
    /// If the shaders do not cover a material, or the scene is too large.
    pub fn new(scene: &Scene, environment: Arc<Environment>) -> Result<Self> {
        let bytes = (scene.triangle_count() * BYTES_PER_FACE) as u64;
        memory::require(bytes, || "the scene's triangles for a device".into())?;
        let faces: Vec<_> = scene.flat_faces().collect();
        let (geometry, surfaces) = (Geometry::build(&faces)?, Surfaces::new(scene, &faces)?);
        Ok(Self { geometry, surfaces, texels: map::texels(&environment), environment })
    }

    /// Hierarchy and triangles.
    pub fn geometry(&self) -> &[[f32; 4]] {
        &self.geometry.numbers
    }

    /// Attributes, materials and textures.
    pub fn surfaces(&self) -> &[u32] {
        &self.surfaces.words
    }

    /// Radiance of the map, three numbers per texel.
    pub fn texels(&self) -> &[f32] {
        &self.texels
    }
}

/// The shader of a sampler in a scene, and the buffers that it reads beside those of the scene.
#[derive(Clone, Debug)]
pub struct Program {
    /// The WGSL source.
    pub source: String,
    /// Floats of the sampler.
    pub floats: Vec<f32>,
    /// Integers of the sampler.
    pub integers: Vec<u32>,
    /// The groups of numbers of a light estimate.
    pub groups: Vec<Dimension>,
    /// Whether it reads weights of visibility, of a file or learned before each picture.
    pub has_visibility: bool,
}

impl Program {
    /// Makes the program of a sampler; of the context, it reads the portals.
    ///
    /// # Errors
    /// If the shaders do not have the SPEC, its file is for another map, or there are no portals.
    pub fn new(scene: &LitScene, spec: &SamplerSpec, context: BuildContext<'_>) -> Result<Self> {
        let LitScene { geometry, surfaces, environment, .. } = scene;
        let sampler = DeviceSampler::new(spec, (environment, surfaces.has_fitted), context)?;
        let groups = sampler.groups();
        let Shader { mut source, mut floats, mut integers, .. } = Shader::functions(&sampler.arrays, sampler.weights)?;
        let constants = [
            ("ROOT", geometry.root as usize),
            ("STACK", geometry.stack),
            ("TRIANGLES", geometry.triangles),
            ("MATERIALS", surfaces.materials),
            ("FACES", surfaces.faces),
            ("ALBEDO", surfaces.albedo),
            ("SRGB", surfaces.srgb),
            ("MAP_WIDTH", environment.width()),
            ("MAP_HEIGHT", environment.height()),
            ("DIRECTIONS", sampler.directions() as usize),
            ("LIGHT_GROUPS", groups.len()),
        ];
        for (name, value) in constants {
            // Writing to a string cannot fail.
            let _ = writeln!(source, "const HEADTAIL_{name}: u32 = {value}u;");
        }
        let _ = writeln!(source, "const HEADTAIL_IS_EMISSIVE: bool = {};", surfaces.is_emissive);
        let fitted = if surfaces.has_fitted { [&FITTED[..], &ON_TEXTURES].concat() } else { vec![NO_FITTED] };
        let parts = [BRDF, POINTS, RAYS, MAP, SURFACE, REFLECTION].into_iter().chain(fitted);
        for part in parts.chain(sampler.sources).chain([PATH]) {
            source.push('\n');
            source.push_str(part);
        }
        // Buffers cannot be empty.
        floats.resize(floats.len().max(4), 0.0);
        integers.resize(integers.len().max(1), 0);
        Ok(Self { source, floats, integers, groups, has_visibility: sampler.has_visibility })
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3A;
    use headtail_render::{
        brdf::{Lambert, NeuralTexture, OfKernel},
        portals::Portal,
        scene::MaterialSpec,
    };
    use headtail_shaders::Target;

    use super::*;

    fn lit(scene: &str) -> LitScene {
        LitScene::new(&Scene::open(scene).unwrap(), Arc::new(Environment::open("studio").unwrap())).unwrap()
    }

    #[test]
    fn programs_of_all_samplers_are_valid() {
        let scene = lit("droid");
        let head = "../checkpoints/studio-head.safetensors";
        let specs = [
            "brdf".into(),
            "emitter".into(),
            "split:2:mis-comp".into(),
            "split:3:mis2-comp".into(),
            "ris:4".into(),
            "patches:fine".into(),
            "mis2:patches".into(),
            "split:4:patches+vis".into(),
            format!("head:{head}"),
            format!("head+mis:{head}"),
            "mis2:portals".into(),
            "split:4:portals+mis".into(),
            "patches+vis:seen.safetensors".into(),
        ];
        let portals = [Portal { center: Vec3A::X, normal: Vec3A::NEG_X, up: Vec3A::Y, width: 1.0, height: 2.0 }];
        let context = BuildContext { portals: &portals, ..BuildContext::default() };
        let cloth = Scene::open("cloth").unwrap();
        let (satin, bounds) = ("neural:../checkpoints/satin.safetensors", cloth.bounds());
        let cloth = satin.parse::<MaterialSpec>().unwrap().dress(cloth, &bounds).unwrap();
        let fitted = LitScene::new(&cloth, scene.environment.clone()).unwrap();
        let specs = specs.iter().flat_map(|spec| [(&scene, spec), (&fitted, spec)]);
        for (scene, spec) in specs {
            let program = Program::new(scene, &spec.parse().unwrap(), context).unwrap();
            let Program { source, floats, integers, .. } = program;
            let shader = Shader { source, floats, integers, layout: String::new() };
            shader.translate(Target::Spirv).unwrap_or_else(|error| panic!("{spec}: {error}"));
        }
    }

    #[test]
    fn uncovered_parts_are_named() {
        let scene = lit("sphere");
        for spec in ["auto", "oracle"] {
            let spec: SamplerSpec = spec.parse().unwrap();
            let error = Program::new(&scene, &spec, BuildContext::default()).unwrap_err().to_string();
            assert!(error.contains(&spec.to_string()) && error.contains("not rendered on a device"), "{error}");
        }
        let portals = "mis2:portals".parse().unwrap();
        let error = Program::new(&scene, &portals, BuildContext::default()).unwrap_err().to_string();
        assert!(error.contains("no scene to find them in"), "{error}");
        let own = Scene::open("sphere").unwrap().with_brdfs(vec![Arc::new(OfKernel::<Lambert>::NEW)]);
        let error = LitScene::new(&own, scene.environment).unwrap_err().to_string();
        assert!(error.contains("OfKernel") && error.contains("--material lambert"), "{error}");
        // A neural material without the texture coordinates of its meshes.
        let satin = NeuralTexture::read("../checkpoints/satin.safetensors".as_ref()).unwrap();
        let bare = Scene::open("sphere").unwrap().with_brdfs(vec![Arc::new(satin)]);
        assert!(LitScene::new(&bare, lit("sphere").environment).is_err());
    }
}
