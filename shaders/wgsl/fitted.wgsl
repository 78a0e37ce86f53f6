// Measured and neural materials: networks of BRDF x cosine, and lobes for sampling. Their numbers are those of
// `headtail_sampling::brdf::FlatBrdf`, which `headtail_number` reads. What all directions at a point share is in private variables, of the point that
// was made last.

const HEADTAIL_WIDEST: u32 = 32u;

// The place of the material's first number, and whether it is neural.
var<private> headtail_fitted: u32;
var<private> headtail_is_neural: bool;
// Inputs and outputs of layers, by turns.
var<private> headtail_fitted_units: array<f32, 64>;

fn headtail_four_numbers(at: u32) -> vec4<f32> {
    return vec4<f32>(headtail_number(at), headtail_number(at + 1u), headtail_number(at + 2u), headtail_number(at + 3u));
}

// Evaluates a network of the inputs at the beginning of the list; returns the place of its outputs there.
fn headtail_fitted_network(network: u32) -> u32 {
    let layers = u32(headtail_number(network));
    let slope = headtail_number(network + 1u);
    var at = network + 2u;
    var start = 0u;
    for (var layer = 0u; layer < layers; layer++) {
        let inputs = u32(headtail_number(at));
        let blocks = (u32(headtail_number(at + 1u)) + 3u) / 4u;
        let biases = at + 2u + 4u * inputs * blocks;
        let end = HEADTAIL_WIDEST - start;
        at += 2u;
        for (var block = 0u; block < blocks; block++) {
            var sum = headtail_four_numbers(biases + 4u * block);
            for (var input = 0u; input < inputs; input++) {
                sum = fma(headtail_four_numbers(at), vec4<f32>(headtail_fitted_units[start + input]), sum);
                at += 4u;
            }
            if (layer + 1u < layers) { sum = max(sum, slope * sum); }
            for (var k = 0u; k < 4u; k++) { headtail_fitted_units[end + 4u * block + k] = sum[k]; }
        }
        at += 4u * blocks;
        start = end;
    }
    return start;
}

// Three outputs of a network.
fn headtail_three_units(at: u32) -> vec3<f32> {
    return vec3<f32>(headtail_fitted_units[at], headtail_fitted_units[at + 1u], headtail_fitted_units[at + 2u]);
}

// BRDF x cosine per channel.
fn headtail_fitted_reflected(n: vec3<f32>, wo: vec3<f32>, wi: vec3<f32>) -> vec3<f32> {
    if (!(dot(n, wo) > 0.0 && dot(n, wi) > 0.0)) { return vec3<f32>(0.0); }
    if (headtail_is_neural) { return headtail_neural_reflected(wi); }
    return headtail_measured_reflected(n, wo, wi);
}

// The solid-angle pdf of BRDF sampling.
fn headtail_fitted_pdf(n: vec3<f32>, wo: vec3<f32>, wi: vec3<f32>) -> f32 {
    if (!(dot(n, wo) > 0.0 && dot(n, wi) > 0.0)) { return 0.0; }
    if (headtail_is_neural) { return headtail_neural_pdf(wi); }
    return headtail_measured_pdf(n, wo, wi);
}

// A direction by BRDF sampling, below the horizon where there is none.
fn headtail_fitted_draw(n: vec3<f32>, wo: vec3<f32>, u: vec2<f32>) -> vec3<f32> {
    if (headtail_is_neural) { return headtail_neural_draw(u); }
    return headtail_measured_draw(n, wo, u);
}
