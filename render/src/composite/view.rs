//! Rectified views: pinhole-camera images of a map.

use glam::Vec3A;
use rayon::prelude::*;

use crate::{environment::Environment, image::Image, scene::Camera};

/// Rays per pixel along each side.
const RAYS: usize = 4;

/// Renders a map as seen by a camera, with the mean of 4 x 4 rays per pixel. The camera's position has no
/// effect: a map is at infinity.
pub fn rectified_view(environment: &Environment, camera: &Camera, width: usize, height: usize) -> Image {
    let pixel = |index: usize| {
        let (x, y) = ((index % width) as f32, (index / width) as f32);
        let mut sum = Vec3A::ZERO;
        for k in 0..RAYS * RAYS {
            let inside = |k: usize| (k as f32 + 0.5) / RAYS as f32;
            let ray = camera.ray(x + inside(k % RAYS), y + inside(k / RAYS), width, height);
            sum += environment.radiance(ray.direction);
        }
        (sum / (RAYS * RAYS) as f32).to_array()
    };
    Image { width, height, pixels: (0..width * height).into_par_iter().map(pixel).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::built_in;

    #[test]
    fn pixels_show_the_map_along_their_rays() {
        let map = built_in("overcast").unwrap();
        let camera = Camera::new(Vec3A::new(1.0, 1.6, 3.0), Vec3A::new(0.0, 1.0, 0.0), 50.0).unwrap();
        let view = rectified_view(&map, &camera, 60, 40);
        for (x, y) in [(0, 0), (30, 20), (59, 39)] {
            let direction = camera.ray(x as f32 + 0.5, y as f32 + 0.5, 60, 40).direction;
            let (seen, expected) = (view.get(x, y), map.radiance(direction));
            // The sky is smooth: it varies by less than 10 % within a pixel of 0.02 rad.
            assert!(((seen - expected) / expected).abs().max_element() < 0.1, "{seen} {expected}");
        }
    }
}
