//! Compact emitters as flat lists, for implementations on other devices.

use super::{CompactEmitters, POINTS, Prefiltered, REST_SPREAD};
use crate::{flat::FlatArray, tail::Tail};

impl CompactEmitters {
    /// All that a draw and a pdf read, for diffuse surfaces. The share of samples of each emitter is 0.01, that of the rest 0.05, and what is left over
    /// is shared in proportion to the light that the surface reflects of each: of an emitter its power times the mean over `compact.towards` of the
    /// clamped cosine over pi, of the rest `compact.seen` about the normal, bilinear between the middles of cells.
    ///
    /// - `compact.shape` `[2]`: columns of texels of the map, rows of cells.
    /// - `compact.windows` `[emitters, 8]`, `compact.numbers`: a row-column tail of each emitter, as `tail.windows` of that tail.
    /// - `compact.powers` `[emitters]`, `compact.towards` `[emitters, 4, 3]`.
    /// - `compact.seen` `[16, 32]`: 1.6 times the means of the luminance of the rest under a cosine lobe about the directions of cells of the map.
    pub fn flat(&self) -> Vec<FlatArray> {
        let (mut windows, mut numbers, mut shape) = (Vec::new(), Vec::new(), Vec::new());
        for emitter in &self.emitters {
            let Tail::RowColumn(tail) = &**emitter.light.tail() else { unreachable!("emitters have row-column tails") };
            windows.extend(tail.window(&mut numbers));
            shape = vec![tail.grid().columns() as u32, tail.grid().rows() as u32];
        }
        let count = self.emitters.len();
        let towards = self.emitters.iter().flat_map(|emitter| emitter.towards).flat_map(|wi| wi.to_array()).collect();
        let seen = self.rest.under_cosine().iter().map(|mean| REST_SPREAD * mean);
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
            FlatArray::floats("compact.seen", vec![Prefiltered::SEEN.1, Prefiltered::SEEN.0], seen.collect()),
        ]
    }
}
