//! Auxiliary features of a picture: albedo, normals and depth, for denoisers and compositing.

use glam::{Vec2, Vec3A};
use rayon::prelude::*;

use super::view::{Part, View};
use crate::{image::Image, one_point::OnePoint};

/// Camera rays per pixel along each side.
const RAYS: usize = 2;
/// BRDF samples along each side of the grid that estimates an albedo; diffuse surfaces need one.
const SAMPLES: usize = 4;
/// Depth where there is no surface, in metres, as Blender writes it.
const FAR: f32 = 1e10;

/// Means over the camera rays of each pixel; where no ray hits a surface, black and [far away](Self::depth).
#[derive(Clone, Debug)]
pub struct Features {
    /// Fraction of uniform illumination that is reflected to the camera, per channel.
    pub albedo: Image,
    /// Shading normals in world space, facing the camera; shorter than 1 where they vary within a pixel.
    pub normal: Image,
    /// `[height * width]` distance from the camera in metres, over the rays that hit a surface; 1e10 if none
    /// does.
    pub depth: Vec<f32>,
}

/// Computes the features of each pixel of a part of a view from evenly spaced rays.
pub fn features(view: View<'_>, part: Part) -> Features {
    view.scene.prepare_materials();
    let Part { left, top, width, height } = part;
    let pixels: Vec<[[f32; 3]; 3]> =
        (0..width * height).into_par_iter().map(|k| of_pixel(&view, left + k % width, top + k / width)).collect();
    let image = |of: usize| Image { width, height, pixels: pixels.iter().map(|pixel| pixel[of]).collect() };
    Features { albedo: image(0), normal: image(1), depth: pixels.iter().map(|pixel| pixel[2][0]).collect() }
}

/// Returns albedo, normal and depth of a pixel.
fn of_pixel(view: &View<'_>, x: usize, y: usize) -> [[f32; 3]; 3] {
    let inside = |k: usize| (k as f32 + 0.5) / RAYS as f32;
    let (mut albedo, mut normal, mut depth, mut hits) = (Vec3A::ZERO, Vec3A::ZERO, 0.0, 0);
    for k in 0..RAYS * RAYS {
        let (across, down) = (x as f32 + inside(k % RAYS), y as f32 + inside(k / RAYS));
        let ray = view.camera.ray(across, down, view.width, view.height);
        let Some(at) = view.scene.intersect(&ray) else { continue };
        let point = OnePoint::new(&at, SAMPLES * SAMPLES);
        let centre = |k: usize| Vec2::new((k % SAMPLES) as f32 + 0.5, (k / SAMPLES) as f32 + 0.5) / SAMPLES as f32;
        let u: Vec<Vec2> = (0..SAMPLES * SAMPLES).map(centre).collect();
        let drawn: Vec<(Vec3A, f32)> = point.sample_brdf(&u).into_iter().flatten().collect();
        let directions: Vec<Vec3A> = drawn.iter().map(|&(wi, _)| wi).collect();
        let reflected = point.brdf_cosines(&directions).into_iter().zip(&drawn).map(|(f, (_, pdf))| f / *pdf);
        albedo += reflected.sum::<Vec3A>() / u.len() as f32;
        normal += at.ns;
        depth += at.p.distance(view.camera.look_from());
        hits += 1;
    }
    let rays = (RAYS * RAYS) as f32;
    let depth = if hits > 0 { depth / hits as f32 } else { FAR };
    [(albedo / rays).to_array(), (normal / rays).to_array(), [depth; 3]]
}
