//! The distribution of view direction and normal.

use glam::Vec3A;
use headtail_render::{
    brdf::OF_MATERIAL,
    columns::{Arena, strips},
    random::{Purpose, Stream},
    scene::{Camera, Ray, Scene},
    simd::LANES,
    tile::Tile,
};

use crate::{Error, Result};

/// Smallest cosine between normal and view direction: that of the renderer's shading normals.
const MIN_COSINE: f32 = 1e-2;

/// Number of shading points taken from a scene.
const SEEN: usize = 1 << 15;

/// A distribution of `(wo, n)`, unit vectors in world space with `n . wo >= 0.01`.
#[derive(Clone, Debug)]
pub enum Viewpoints {
    /// Both uniform over the sphere, `wo` flipped to the side of `n` (as in the paper).
    Sphere,
    /// A uniformly chosen element of a list.
    Seen(Vec<SeenPoint>),
}

/// A shading point in a camera's view.
#[derive(Clone, Copy, Debug)]
pub struct SeenPoint {
    /// Direction to the viewer.
    pub wo: Vec3A,
    /// Shading normal.
    pub n: Vec3A,
    /// Texture values of a neural material at the point, see [`headtail_render::head::Condition::Texture`];
    /// zeros on other surfaces.
    pub texture: [f32; OF_MATERIAL],
}

impl Viewpoints {
    /// Collects a camera's shading points: those of rays that are uniform over its image.
    ///
    /// # Errors
    /// [`Error::NothingSeen`] if almost no ray hits a surface.
    pub fn of_scene(scene: &Scene, camera: &Camera, width: usize, height: usize, seed: u64) -> Result<Self> {
        let mut stream = Stream::new(seed, Purpose::Batch, u64::MAX);
        let (mut seen, mut rays) = (Vec::with_capacity(SEEN), Vec::with_capacity(SEEN));
        for _ in 0..64 * SEEN {
            let at = stream.uniform2();
            let ray = camera.ray(at.x * width as f32, at.y * height as f32, width, height);
            let point = scene.intersect(&ray).filter(|point| point.ns.dot(point.wo) >= MIN_COSINE);
            let texture = [0.0; OF_MATERIAL];
            rays.extend(point.is_some().then_some(ray));
            seen.extend(point.map(|point| SeenPoint { wo: point.wo, n: point.ns, texture }));
            if seen.len() == SEEN {
                if scene.brdfs().added().next().is_some() {
                    look_up_textures(scene, &rays, camera.pixel_spread(height), &mut seen);
                }
                return Ok(Self::Seen(seen));
            }
        }
        Err(Error::NothingSeen { scene: scene.name().to_owned() })
    }

    /// Draws `(wo, n)`.
    pub fn draw(&self, stream: &mut Stream) -> [Vec3A; 2] {
        match self {
            Self::Sphere => loop {
                let (n, wo) = (stream.direction(), stream.direction());
                let wo = if n.dot(wo) < 0.0 { -wo } else { wo };
                if n.dot(wo) >= MIN_COSINE {
                    return [wo, n];
                }
            },
            Self::Seen(list) => {
                let SeenPoint { wo, n, .. } = pick(list, stream);
                [wo, n]
            }
        }
    }

    /// Draws a point in the camera's view; `None` without a camera.
    pub fn draw_seen(&self, stream: &mut Stream) -> Option<SeenPoint> {
        match self {
            Self::Sphere => None,
            Self::Seen(list) => Some(pick(list, stream)),
        }
    }

    /// Draws a normal alone.
    pub fn draw_normal(&self, stream: &mut Stream) -> Vec3A {
        match self {
            Self::Sphere => stream.direction(),
            Self::Seen(_) => self.draw(stream)[1],
        }
    }
}

fn pick(list: &[SeenPoint], stream: &mut Stream) -> SeenPoint {
    let index = (stream.uniform() * list.len() as f32) as usize;
    list[index.min(list.len() - 1)]
}

/// Looks up textures at ray hits, with the footprints of pixels that are `spread` radians apart.
fn look_up_textures(scene: &Scene, rays: &[Ray], spread: f32, seen: &mut [SeenPoint]) {
    let (mut tile, mut hits, arena) = (Tile::default(), Vec::new(), Arena::default());
    for (rays, seen) in rays.chunks(4096).zip(seen.chunks_mut(4096)) {
        hits.clear();
        scene.intersect_batch(rays, spread, |k| k as u32, &mut tile, &mut hits);
        let mut columns = arena.columns::<OF_MATERIAL>(strips(tile.len()));
        tile.rows().textures(columns.get_mut(), &arena);
        for (place, &ray) in hits.iter().enumerate() {
            seen[ray].texture = columns.get().map(|column| column[place / LANES][place % LANES]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_viewpoint_is_above_the_surface() {
        let scene = Scene::built_in("sphere").unwrap();
        let seen = Viewpoints::of_scene(&scene, &scene.camera(), 64, 48, 0).unwrap();
        let mut stream = Stream::new(0, Purpose::Test, 0);
        for viewpoints in [Viewpoints::Sphere, seen] {
            let mut mean = Vec3A::ZERO;
            for _ in 0..2000 {
                let [wo, n] = viewpoints.draw(&mut stream);
                assert!(n.dot(wo) >= MIN_COSINE && n.is_normalized() && wo.is_normalized());
                mean += n / 2000.0;
            }
            // Normals of the whole sphere, each coordinate with standard deviation 0.013; those in a camera's
            // view face it.
            assert_eq!(mean.length() < 0.1, matches!(viewpoints, Viewpoints::Sphere), "{mean}");
        }
    }

    #[test]
    fn a_camera_that_looks_past_the_scene_is_an_error() {
        let scene = Scene::built_in("sphere").unwrap();
        let camera = Camera::new(Vec3A::new(0.0, 50.0, 0.0), Vec3A::new(0.0, 90.0, 1.0), 20.0).unwrap();
        let error = Viewpoints::of_scene(&scene, &camera, 8, 8, 0).unwrap_err().to_string();
        assert!(error.contains("sphere"), "{error}");
    }
}
