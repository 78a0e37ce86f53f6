// Measured and neural materials: networks of BRDF x cosine, and lobes for sampling. Their numbers are those of `flat` in
// `headtail_render::brdf`. What all directions at a point share is in private variables, of the point that was made last.

const HEADTAIL_HAS_FITTED: bool = true;
const HEADTAIL_NEURAL: u32 = 4u;
const HEADTAIL_WIDEST: u32 = 32u;

// A surface's first word in `headtail_surfaces`, and whether its material is neural.
var<private> headtail_fitted: u32;
var<private> headtail_is_neural: bool;
// Inputs and outputs of layers, by turns.
var<private> headtail_fitted_units: array<f32, 64>;

fn headtail_four_numbers(at: u32) -> vec4<f32> {
    return vec4<f32>(headtail_vector(at), headtail_number(at + 3u));
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

// Completes a point: `tile` has its texture coordinates and, in these, the standard deviation of the pixel's footprint.
fn headtail_fitted_point(given: HeadtailPoint, material: u32, tile: vec3<f32>, axes: HeadtailUvAxes) -> HeadtailPoint {
    headtail_fitted = headtail_surfaces[material + 1u];
    headtail_is_neural = headtail_surfaces[material] == HEADTAIL_NEURAL;
    var at = given;
    at.is_fitted = true;
    if (headtail_is_neural) {
        at.lobes = headtail_neural_lobes(at, headtail_number(material + 2u) * tile, axes);
    } else {
        at.lobes = headtail_measured_lobes(at);
    }
    return at;
}

fn headtail_fitted_reflected(at: HeadtailPoint, wi: vec3<f32>) -> vec3<f32> {
    if (!(dot(at.ns, at.wo) > 0.0 && dot(at.ns, wi) > 0.0)) { return vec3<f32>(0.0); }
    if (headtail_is_neural) { return headtail_neural_reflected(wi); }
    return headtail_measured_reflected(at, wi);
}

fn headtail_fitted_pdf(at: HeadtailPoint, wi: vec3<f32>) -> f32 {
    if (!(dot(at.ns, at.wo) > 0.0 && dot(at.ns, wi) > 0.0)) { return 0.0; }
    if (headtail_is_neural) { return headtail_neural_pdf(wi); }
    return headtail_measured_pdf(at, wi);
}

fn headtail_fitted_sample(at: HeadtailPoint, u: vec2<f32>) -> vec4<f32> {
    var wi: vec3<f32>;
    if (headtail_is_neural) { wi = headtail_neural_draw(u); } else { wi = headtail_measured_draw(at, u); }
    return vec4<f32>(wi, headtail_fitted_pdf(at, wi));
}
