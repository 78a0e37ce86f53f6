//! Neural materials over surfaces, and the diffuse surfaces beside them.

use std::{f32::consts::TAU, sync::Arc};

use glam::{Vec2, Vec3, Vec3A};
use headtail_model::Condition;
use headtail_render::{
    brdf::{
        self, Brdf, BrdfTable, MAX_PARAMETERS, NeuralTexture, OF_MATERIAL,
        neural_texture::{FEATURES, Seen, TEXEL_WIDTH},
    },
    color::luminance,
    frame::Frame,
    head,
    one_point::{COPIES, OnePoint},
    random::Stream,
    simd::LANES,
    tile::ShadingPoint,
};

use super::{RenderedSurface, ShaderSurface, Surface, Viewpoints};

/// Offset of the texture's values and the handedness in a condition.
const MATERIAL: usize = head::MAX_CONDITION - OF_MATERIAL;
const HAND: usize = head::MAX_CONDITION - 1;

/// A neural material. Points of other surfaces in the camera's view are treated as diffuse: the head has to
/// serve them, too.
pub struct TexturedSurface {
    viewpoints: Viewpoints,
    texture: Arc<NeuralTexture>,
    table: BrdfTable,
    index: u32,
}

impl TexturedSurface {
    /// Builds the surface of a material seen from viewpoints.
    pub fn new(viewpoints: Viewpoints, texture: Arc<NeuralTexture>) -> Self {
        let (table, index) = BrdfTable::default().with(texture.clone());
        Self { viewpoints, texture, table, index }
    }

    /// Draws a random position of the texture, footprint and tangent.
    fn anywhere(&self, wo: Vec3A, n: Vec3A, stream: &mut Stream) -> [f32; OF_MATERIAL] {
        let Frame { s, t, n } = Frame::from_normal(n.into());
        let (sin, cos) = (TAU * stream.uniform()).sin_cos();
        let tangent = s * cos + t * sin;
        let wo = Vec3::from(wo);
        let local = Vec3::new(wo.dot(tangent), wo.dot(n.cross(tangent)), wo.dot(n));
        let side = self.texture.pyramid().side();
        let level = side.ilog2() as f32 * stream.uniform().powi(2);
        let width = TEXEL_WIDTH / side as f32 * level.exp2();
        let features =
            self.texture.features(&Seen { uv: stream.uniform2(), width, wo: local, tangent: [cos, sin, 1.0] });
        let mut numbers = [0.0; OF_MATERIAL];
        numbers[..FEATURES].copy_from_slice(&features);
        numbers[FEATURES..].copy_from_slice(&[tangent.x, tangent.y, tangent.z, 1.0]);
        numbers
    }

    /// Returns the shading point of a condition, for lists of `length`.
    fn points(&self, condition: &[f32], length: usize) -> OnePoint {
        let (wo, n) = (Vec3A::from_slice(condition), Vec3A::from_slice(&condition[3..]));
        let surface = if condition[HAND] == 0.0 {
            brdf::Lambert { albedo: Vec3::ONE }.into()
        } else {
            let mut parameters = [0.0; MAX_PARAMETERS];
            let (features, tangent) = condition[MATERIAL..].split_at(FEATURES);
            parameters[..FEATURES].copy_from_slice(features);
            let (frame, tangent) = (Frame::from_normal(n.into()), Vec3::from_slice(tangent));
            let in_frame = [tangent.dot(frame.s), tangent.dot(frame.t), condition[HAND]];
            parameters[FEATURES..FEATURES + 3].copy_from_slice(&in_frame);
            brdf::Surface { brdf: self.index, parameters }
        };
        let at = ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, surface };
        OnePoint::of_table(&at, length.clamp(1, COPIES), &self.table)
    }
}

impl Surface for TexturedSurface {
    fn condition(&self) -> Condition {
        Condition::Texture
    }

    fn draw_condition(&self, stream: &mut Stream, condition: &mut [f32]) {
        let (wo, n, material) = match self.viewpoints.draw_seen(stream) {
            Some(seen) => (seen.wo, seen.n, seen.texture),
            None => {
                let [wo, n] = self.viewpoints.draw(stream);
                (wo, n, self.anywhere(wo, n, stream))
            }
        };
        condition.copy_from_slice(&head::Condition::encode_texture(wo.into(), n.into(), &material));
    }

    fn lobes(&self, condition: &[f32], wi: &[Vec3A]) -> Vec<f32> {
        self.points(condition, wi.len()).brdf_cosines(wi).into_iter().map(luminance).collect()
    }

    fn samples(&self, condition: &[f32], u: &[Vec2]) -> Vec<Option<Vec3A>> {
        self.points(condition, u.len()).sample_brdf(u).into_iter().map(|drawn| Some(drawn?.0)).collect()
    }

    fn pdfs(&self, condition: &[f32], wi: &[Vec3A]) -> Vec<f32> {
        self.points(condition, wi.len()).brdf_pdfs(wi)
    }

    fn in_shaders(&self) -> Option<ShaderSurface> {
        ShaderSurface::fitted([&*self.texture as &dyn Brdf])
    }
}

impl RenderedSurface for TexturedSurface {
    fn point(&self, condition: &[f32]) -> OnePoint {
        self.points(condition, LANES)
    }
}

#[cfg(test)]
mod tests {
    use headtail_render::{
        random::Purpose,
        scene::{MaterialSpec, Scene},
        tile::MAX_POINTS,
    };

    use super::*;

    #[test]
    fn conditions_match_the_renderers_head_inputs() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../checkpoints/satin.safetensors");
        let text = format!("neural:{file},repeat=5");
        let texture = Arc::new(NeuralTexture::read(file.as_ref()).unwrap());
        let scene = Scene::built_in("bedroom").unwrap();
        let bounds = scene.bounds();
        let scene = text.parse::<MaterialSpec>().unwrap().dress(scene, &bounds).unwrap();
        let viewpoints = Viewpoints::of_scene(&scene, &scene.camera(), 64, 48, 0).unwrap();
        let mut stream = Stream::new(0, Purpose::Test, 0);
        let mut condition = [0.0; head::MAX_CONDITION];
        let (mut on_cloth, mut beside) = (0, 0);
        let everywhere = TexturedSurface::new(Viewpoints::Sphere, texture.clone());
        let surface = TexturedSurface::new(viewpoints, texture);
        for k in 0..400 {
            let from = if k % 2 == 0 { &surface } else { &everywhere };
            from.draw_condition(&mut stream, &mut condition);
            if condition[HAND] == 0.0 {
                beside += 1;
                assert!(k % 2 == 0 && condition[MATERIAL..].iter().all(|&number| number == 0.0));
                continue;
            }
            on_cloth += 1;
            let (n, tangent) =
                (Vec3A::from_slice(&condition[3..]), Vec3A::from_slice(&condition[MATERIAL + FEATURES..]));
            assert!(
                condition[HAND].abs() == 1.0 && n.dot(tangent).abs() < 1e-5 && (tangent.length() - 1.0).abs() < 1e-5
            );
            // The head's input in the renderer is the condition itself.
            let one = surface.points(&condition, 1);
            let seen: Vec<[f32; OF_MATERIAL]> =
                one.map(&[Vec2::ZERO], |_: [&[_]; 2], out| one.tile().rows().textures(out, &one.arena)).collect();
            let apart = seen[0].iter().zip(&condition[MATERIAL..]).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(apart < 1e-5, "{apart}");
            let u = stream.uniform2();
            let Some(wi) = surface.samples(&condition, &[u])[0] else { continue };
            assert!(surface.pdfs(&condition, &[wi])[0] > 0.0 && surface.lobes(&condition, &[wi])[0] >= 0.0);
        }
        assert!(on_cloth > 210 && beside > 20, "{on_cloth} {beside}");
        // Tables have more cells than a tile has points.
        for count in [0, MAX_POINTS + 1] {
            assert_eq!(surface.lobes(&condition, &vec![Vec3A::Y; count]).len(), count);
        }
    }
}
