// Neural materials (after Kuznetsov et al. 2021) at a point with its features: a network of BRDF x cosine, and a mixture of a cosine lobe and a
// shifted Trowbridge-Reitz lobe.

const HEADTAIL_LARGEST_LOG: f32 = 6.0;
const HEADTAIL_COSINE_FLOOR: f32 = 0.05;
const HEADTAIL_LOBE_FLOOR: f32 = 0.02;
const HEADTAIL_LEAST_WIDTH: f32 = 0.04;
const HEADTAIL_RANGE_OF_WIDTHS: f32 = 1.2;

// The features, the tangents, and the direction to the viewer in their frame.
var<private> headtail_features: array<vec4<f32>, 2>;
var<private> headtail_frame_of_texture: HeadtailFrame;
var<private> headtail_local_wo: vec3<f32>;
// The probability, the widths and the shift of the second lobe.
var<private> headtail_lobe_weight: f32;
var<private> headtail_lobe_widths: vec2<f32>;
var<private> headtail_lobe_shift: vec2<f32>;

fn headtail_sigmoid(x: f32) -> f32 {
    return 1.0 / (1.0 + exp(-x));
}

fn headtail_width(raw: f32) -> f32 {
    return HEADTAIL_LEAST_WIDTH + HEADTAIL_RANGE_OF_WIDTHS * headtail_sigmoid(raw);
}

fn headtail_weight_of_lobe(raw: f32) -> f32 {
    return HEADTAIL_LOBE_FLOOR + (1.0 - HEADTAIL_LOBE_FLOOR - HEADTAIL_COSINE_FLOOR) * headtail_sigmoid(raw);
}

// Sets the tangents; the other one is `hand` times `n` x `s`.
fn headtail_look_at_texture(n: vec3<f32>, s: vec3<f32>, hand: f32, wo: vec3<f32>) {
    headtail_frame_of_texture = HeadtailFrame(s, hand * cross(n, s), n);
    headtail_local_wo = headtail_to_texture(wo);
}

fn headtail_to_texture(w: vec3<f32>) -> vec3<f32> {
    let frame = headtail_frame_of_texture;
    return vec3<f32>(dot(frame.s, w), dot(frame.t, w), dot(frame.n, w));
}

// Makes the features and the direction to the viewer the inputs of a network.
fn headtail_see_features() {
    for (var k = 0u; k < 8u; k++) { headtail_fitted_units[k] = headtail_features[k / 4u][k & 3u]; }
    headtail_fitted_units[8] = headtail_local_wo.x;
    headtail_fitted_units[9] = headtail_local_wo.y;
}

// Finds the lobes at a point whose features and tangents are known; returns the closest approximation by two lobes, as `headtail_sample` takes it.
fn headtail_neural_lobes() -> vec4<f32> {
    headtail_see_features();
    let out = headtail_fitted_network(headtail_fitted + u32(headtail_number(headtail_fitted + 1u)));
    headtail_lobe_weight = headtail_weight_of_lobe(headtail_fitted_units[out]);
    headtail_lobe_widths = vec2<f32>(headtail_width(headtail_fitted_units[out + 1u]), headtail_width(headtail_fitted_units[out + 2u]));
    let shifts = vec2<f32>(headtail_sigmoid(headtail_fitted_units[out + 3u]), headtail_sigmoid(headtail_fitted_units[out + 4u]));
    headtail_lobe_shift = 2.0 * shifts - 1.0;
    let weight = headtail_weight_of_lobe(headtail_fitted_units[out + 5u]);
    return vec4<f32>(1.0 - weight, weight, 1.0, headtail_width(headtail_fitted_units[out + 6u]));
}

fn headtail_neural_reflected(wi: vec3<f32>) -> vec3<f32> {
    let local = headtail_to_texture(wi);
    headtail_see_features();
    headtail_fitted_units[10] = local.x;
    headtail_fitted_units[11] = local.y;
    let network = headtail_fitted + u32(headtail_number(headtail_fitted + 2u));
    let logs = headtail_three_units(headtail_fitted_network(network));
    return local.z * exp(min(logs, vec3<f32>(HEADTAIL_LARGEST_LOG)));
}

fn headtail_neural_pdf(wi: vec3<f32>) -> f32 {
    let local = headtail_to_texture(wi);
    // Not normalised.
    let h = headtail_local_wo + local;
    let q = (-h.xy / h.z - headtail_lobe_shift) / headtail_lobe_widths;
    let across = 1.0 + dot(q, q);
    let slopes = HEADTAIL_INVERSE_PI / (headtail_lobe_widths.x * headtail_lobe_widths.y * across * across);
    let mirrored = slopes * dot(h, h) / (2.0 * h.z * h.z * h.z);
    return headtail_lobe_weight * mirrored + (1.0 - headtail_lobe_weight) * HEADTAIL_INVERSE_PI * local.z;
}

// Draws a direction, below the horizon where there is no sample.
fn headtail_neural_draw(u: vec2<f32>) -> vec3<f32> {
    let weight = headtail_lobe_weight;
    var local: vec3<f32>;
    if (u.x < weight) {
        let x = headtail_remap(u.x, 0.0, weight);
        let slope = headtail_lobe_shift + headtail_lobe_widths * sqrt(x / (1.0 - x)) * headtail_cos_sin_turns(u.y);
        let h = normalize(vec3<f32>(-slope, 1.0));
        let cosine = dot(headtail_local_wo, h);
        local = normalize(2.0 * cosine * h - headtail_local_wo);
        if (!(cosine > 0.0)) { local.z = -abs(local.z); }
    } else {
        let disk = headtail_disk(vec2<f32>(headtail_remap(u.x, weight, 1.0), u.y));
        local = vec3<f32>(disk, sqrt(max(1.0 - dot(disk, disk), 0.0)));
    }
    let frame = headtail_frame_of_texture;
    return local.x * frame.s + local.y * frame.t + local.z * frame.n;
}
