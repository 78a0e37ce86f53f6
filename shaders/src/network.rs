//! The weights of a head's layers in the order in which shaders read them.

use headtail_sampling::{Result, flat::FlatArray};

use crate::{floats_of, integers_of, missing};

/// Outputs that are computed together: an input is read once for them.
pub(crate) const TILE: usize = 16;

/// Returns the arrays of `network.wgsl`, which take the place of those of [`headtail_sampling::head::Head::flat`] with the same
/// names; none for samplers without a head.
///
/// - `head.layers` `[layers, 3]`: inputs, outputs, and the start in `head.weights`.
/// - `head.weights` `[numbers]`: for each layer `[tiles, 1 + inputs, TILE]`, first the biases. Outputs that are not there have
///   weights of 0.
pub(crate) fn tiled(arrays: &[FlatArray]) -> Result<Vec<FlatArray>> {
    let Ok(layers) = integers_of(arrays, "head.layers") else { return Ok(Vec::new()) };
    let given = floats_of(arrays, "head.weights")?;
    let (mut rows, mut weights) = (Vec::new(), Vec::new());
    for layer in layers.chunks_exact(4) {
        let [inputs, outputs, start, biases] = [0, 1, 2, 3].map(|field| layer[field] as usize);
        let tiles = outputs.div_ceil(TILE);
        rows.extend([inputs, TILE * tiles, weights.len()].map(|number| number as u32));
        for first in (0..tiles).map(|tile| TILE * tile) {
            // Given are blocks of four outputs.
            let of_inputs = (0..inputs).map(|input| (start + 4 * input, 4 * inputs));
            for (start, stride) in [(biases, 4)].into_iter().chain(of_inputs) {
                for output in (first..first + TILE).step_by(4) {
                    let at = start + output / 4 * stride;
                    let block = if output < outputs {
                        given.get(at..at + 4).ok_or_else(|| missing("head.weights"))?
                    } else {
                        &[0.0; 4]
                    };
                    weights.extend_from_slice(block);
                }
            }
        }
    }
    let rows = FlatArray::integers("head.layers", vec![rows.len() / 3, 3], rows);
    Ok(vec![rows, FlatArray::floats("head.weights", vec![weights.len()], weights)])
}
