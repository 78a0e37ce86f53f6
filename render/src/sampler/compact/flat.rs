//! Compact emitters as flat lists, for implementations on other devices.

use glam::{Vec2, Vec3};

use super::{COARSE, CompactEmitters, POINTS, radical_inverse};
use crate::{
    brdf::{Kernel, Lambert},
    flat::FlatArray,
    tail::Tail,
};

impl CompactEmitters {
    /// All that a draw and a pdf read, for diffuse surfaces. The share of samples of each emitter is 0.01, that of the rest 0.05, and what is left over
    /// is shared in proportion to the light that the surface reflects of each: of an emitter its power times the mean over `compact.towards` of the
    /// clamped cosine over pi, of the rest the mean of `compact.coarse` in the directions `compact.cosines`.
    ///
    /// - `compact.shape` `[2]`: columns of texels of the map, rows of cells.
    /// - `compact.windows` `[emitters, 8]`, `compact.numbers`: a row-column tail of each emitter, as `tail.windows` of that tail.
    /// - `compact.powers` `[emitters]`, `compact.towards` `[emitters, 8, 3]`.
    /// - `compact.cosines` `[8, 3]`: unit directions in the frame of a normal (Duff et al. 2017), which is their third axis.
    /// - `compact.coarse` `[32, 64]`: mean luminance of the rest in cells of the map.
    pub fn flat(&self) -> Vec<FlatArray> {
        let (mut windows, mut numbers, mut shape) = (Vec::new(), Vec::new(), Vec::new());
        for emitter in &self.emitters {
            let Tail::RowColumn(tail) = &**emitter.light.tail() else { unreachable!("emitters have row-column tails") };
            windows.extend(tail.window(&mut numbers));
            shape = vec![tail.grid().columns() as u32, tail.grid().rows() as u32];
        }
        let count = self.emitters.len();
        let towards = self.emitters.iter().flat_map(|emitter| emitter.towards).flat_map(|wi| wi.to_array()).collect();
        let lambert = Lambert { albedo: Vec3::ONE };
        let cosines = (0..POINTS).flat_map(|k| {
            let u = Vec2::new((k as f32 + 0.5) / POINTS as f32, radical_inverse(k));
            lambert.sample(Vec3::Z, Vec3::Z, u).0.to_array()
        });
        vec![
            FlatArray::integers("compact.shape", vec![2], shape),
            FlatArray::integers("compact.windows", vec![count, 8], windows),
            FlatArray::floats("compact.numbers", vec![numbers.len()], numbers),
            FlatArray::floats(
                "compact.powers",
                vec![count],
                self.emitters.iter().map(|emitter| emitter.power).collect(),
            ),
            FlatArray::floats("compact.towards", vec![count, POINTS, 3], towards),
            FlatArray::floats("compact.cosines", vec![POINTS, 3], cosines.collect()),
            FlatArray::floats("compact.coarse", vec![COARSE.1, COARSE.0], self.coarse.clone()),
        ]
    }
}
