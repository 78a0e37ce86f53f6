//! The view and the numbers of samples as `points.wgsl` reads them.

use headtail_render::{
    integrator::{Part, View},
    points::{CommonNumbers, Dimension, Points},
};

/// The content of `headtail_view`: what a dispatch renders.
#[derive(Clone, Debug)]
pub struct ViewWords(Vec<u32>);

/// Words before the numbers.
const HEADER: usize = 28;
/// Place of the first row and of the number of samples.
const WORK: usize = 24;

impl ViewWords {
    /// Least number of words: the size of the shader's structure, whose list has an element at least.
    pub const LEAST: usize = 32;

    /// Returns the words of samples `samples.0..samples.1` of a part of a view, whose light estimates take `groups`.
    pub fn new(view: &View<'_>, part: Part, points: Points, samples: (u32, u32), groups: &[Dimension]) -> Self {
        let camera = view.camera;
        let (to_world, principal) = (camera.to_world(), camera.principal_point());
        let axes = to_world.matrix3;
        let row = |v: glam::Vec3A, w: f32| [v.x, v.y, v.z, w].map(f32::to_bits);
        let parallel = if camera.is_orthographic() { 1.0 } else { 0.0 };
        let depth = view.depth.max(1);
        let [left, top, width, height] = [part.left, part.top, part.width, part.height].map(|length| length as u32);
        let mut words = Vec::with_capacity(HEADER);
        words.extend(row(camera.look_from(), camera.half_height()));
        words.extend(row(axes.x_axis, principal.x));
        words.extend(row(axes.y_axis, principal.y));
        words.extend(row(-axes.z_axis, parallel));
        words.extend([view.width as u32, view.height as u32, depth, u32::from(view.unshadowed)]);
        words.extend([left, top, width, height]);
        words.extend([0, samples.1 - samples.0, points.seed() as u32, (points.seed() >> 32) as u32]);
        for sample in samples.0..samples.1 {
            let points = points.at_sample(sample);
            let mut add = |points: Points, dimension: Dimension| {
                let CommonNumbers { numbers, counter, first_word, are_scrambled } = points.common(dimension);
                words.extend(numbers[..3].iter().chain(&counter));
                words.push(first_word as u32 | u32::from(are_scrambled));
            };
            add(points, Dimension::Camera);
            for bounce in 0..depth {
                let points = points.at_bounce(bounce);
                groups.iter().for_each(|&group| add(points, group));
                add(points, Dimension::Path);
            }
        }
        words.resize(words.len().max(Self::LEAST), 0);
        Self(words)
    }

    /// Sets the first row of the part that a dispatch renders.
    pub fn set_first_row(&mut self, row: u32) {
        self.0[WORK] = row;
    }

    /// Returns the words of the samples' numbers alone.
    pub fn numbers(&self) -> &[u32] {
        &self.0[HEADER..]
    }

    /// Returns the words.
    pub fn words(&self) -> &[u32] {
        &self.0
    }
}
