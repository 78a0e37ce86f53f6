//! Where surfaces are seen from: the distribution of view direction and normal.

use glam::Vec3A;
use headtail_render::{
    random::{Purpose, Stream},
    scene::{Camera, Scene},
};

use crate::{Error, Result};

/// The least cosine between normal and view direction: that of the renderer's shading normals.
const MIN_COSINE: f32 = 1e-2;

/// Shading points that are taken from a scene.
const SEEN: usize = 1 << 15;

/// A distribution of `(wo, n)`, unit vectors in world space with `n . wo >= 0.01`.
#[derive(Clone, Debug)]
pub enum Viewpoints {
    /// Both uniform over the sphere, `wo` flipped to the side of `n` (the paper's).
    Sphere,
    /// One of a list.
    Seen(Vec<[Vec3A; 2]>),
}

impl Viewpoints {
    /// What a camera sees of a scene: shading points of rays that are uniform over its picture.
    ///
    /// # Errors
    /// [`Error::NothingSeen`] if almost no ray meets a surface.
    pub fn of_scene(scene: &Scene, camera: &Camera, width: usize, height: usize, seed: u64) -> Result<Self> {
        let mut stream = Stream::new(seed, Purpose::Batch, u64::MAX);
        let mut seen = Vec::with_capacity(SEEN);
        for _ in 0..64 * SEEN {
            let at = stream.uniform2();
            let ray = camera.ray(at.x * width as f32, at.y * height as f32, width, height);
            let point = scene.intersect(&ray).filter(|point| point.ns.dot(point.wo) >= MIN_COSINE);
            seen.extend(point.map(|point| [point.wo, point.ns]));
            if seen.len() == SEEN {
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
                let index = (stream.uniform() * list.len() as f32) as usize;
                list[index.min(list.len() - 1)]
            }
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
            // Normals of the whole sphere, each coordinate with deviation 0.013; a camera sees those that face it.
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
