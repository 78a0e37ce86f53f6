//! Layers of random weights for networks in tests.

use headtail_render::{head::Linear, random::Stream};

/// Returns layers from each of these sizes to the next. `reach` maps a layer's number of inputs to the
/// widths, around 0, of its weights and biases.
pub fn random_layers(sizes: &[usize], random: &mut Stream, reach: impl Fn(usize) -> [f32; 2]) -> Vec<Linear> {
    let mut layer = |inputs: usize, outputs: usize| {
        let [of_weights, of_biases] = reach(inputs);
        let mut values =
            |count: usize, reach: f32| -> Vec<f32> { (0..count).map(|_| reach * (random.uniform() - 0.5)).collect() };
        let weight = values(inputs * outputs, of_weights);
        Linear::new("random", inputs, outputs, &weight, values(outputs, of_biases)).unwrap()
    };
    sizes.windows(2).map(|pair| layer(pair[0], pair[1])).collect()
}
