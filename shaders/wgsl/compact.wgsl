// Compact emitters in a mixture with a sampler of the rest of the light. Shares are those of a diffuse surface, whatever the surface is.

const HEADTAIL_LEAST_SHARE: f32 = 0.01;
const HEADTAIL_LEAST_REST: f32 = 0.05;

var<private> headtail_shares: array<f32, HEADTAIL_EMITTERS_AND_REST>;

fn headtail_vector(start: u32, k: u32) -> vec3<f32> {
    let at = start + 3u * k;
    return vec3<f32>(headtail_floats[at], headtail_floats[at + 1u], headtail_floats[at + 2u]);
}

// Shares of samples, in proportion to the light that a surface reflects of each emitter and of the rest, as far as eight points of each show it.
fn headtail_share_light(n: vec3<f32>) {
    var total = 0.0;
    for (var k = 0u; k < HEADTAIL_EMITTERS; k++) {
        var light = 0.0;
        for (var j = 0u; j < 8u; j++) {
            let cosine = dot(n, headtail_vector(HEADTAIL_COMPACT_TOWARDS, 8u * k + j));
            light += max(cosine, 0.0) / (8.0 * HEADTAIL_PI) * headtail_floats[HEADTAIL_COMPACT_POWERS + k];
        }
        headtail_shares[k] = light;
        total += light;
    }
    let turn = select(1.0, -1.0, (bitcast<u32>(n.z) >> 31u) == 1u);
    let a = -1.0 / (turn + n.z);
    let b = n.x * n.y * a;
    let across = vec3<f32>(1.0 + turn * n.x * n.x * a, turn * b, -turn * n.x);
    let along = vec3<f32>(b, turn + n.y * n.y * a, -n.y);
    var rest = 0.0;
    for (var j = 0u; j < 8u; j++) {
        let local = headtail_vector(HEADTAIL_COMPACT_COSINES, j);
        let x = headtail_square(local.x * across + local.y * along + local.z * n);
        let cell = min(vec2<u32>(vec2<f32>(64.0, 32.0) * x.xy), vec2<u32>(63u, 31u));
        rest += headtail_floats[HEADTAIL_COMPACT_COARSE + 64u * cell.y + cell.x] / 8.0;
    }
    headtail_shares[HEADTAIL_EMITTERS] = rest;
    total += rest;
    let free = 1.0 - HEADTAIL_LEAST_REST - HEADTAIL_LEAST_SHARE * f32(HEADTAIL_EMITTERS);
    for (var k = 0u; k <= HEADTAIL_EMITTERS; k++) {
        let share = select(1.0 / f32(HEADTAIL_EMITTERS_AND_REST), headtail_shares[k] / max(total, HEADTAIL_TINY), total > 0.0);
        headtail_shares[k] = select(HEADTAIL_LEAST_SHARE, HEADTAIL_LEAST_REST, k == HEADTAIL_EMITTERS) + free * share;
    }
}

// The mixture's pdf of a direction, for that of the rest.
fn headtail_mixed(wi: vec3<f32>, rest: f32) -> f32 {
    let x = headtail_square(wi);
    var pdf = headtail_shares[HEADTAIL_EMITTERS] * rest;
    for (var k = 0u; k < HEADTAIL_EMITTERS; k++) {
        let window = headtail_window(HEADTAIL_COMPACT_WINDOWS, k, HEADTAIL_COMPACT_NUMBERS);
        pdf += headtail_shares[k] * headtail_window_back(window, x.xy).z * x.z;
    }
    return pdf;
}

// The share of samples to draw here, beside sampling the BSDF.
fn headtail_share(n: vec3<f32>, wo: vec3<f32>, lobes: vec4<f32>) -> f32 {
    return headtail_rest_share(n, wo, lobes);
}

// Draws a direction for a uniform point z of [0, 1)^2: (wi, solid-angle pdf); pdf 0 is no sample.
fn headtail_sample(n: vec3<f32>, wo: vec3<f32>, lobes: vec4<f32>, z: vec2<f32>) -> vec4<f32> {
    headtail_share_light(n);
    var before = 0.0;
    var part = 0u;
    while (part < HEADTAIL_EMITTERS && z.x >= before + headtail_shares[part]) {
        before += headtail_shares[part];
        part += 1u;
    }
    if (part == HEADTAIL_EMITTERS) {
        let drawn = headtail_rest_sample(n, wo, lobes, vec2<f32>(headtail_remap(z.x, before, 1.0), z.y));
        if (!(drawn.w > 0.0)) { return vec4<f32>(0.0); }
        return vec4<f32>(drawn.xyz, headtail_mixed(drawn.xyz, drawn.w));
    }
    let left = headtail_remap(z.x, before, before + headtail_shares[part]);
    let window = headtail_window(HEADTAIL_COMPACT_WINDOWS, part, HEADTAIL_COMPACT_NUMBERS);
    let x = headtail_window_forward(window, vec2<f32>(left, z.y));
    if (!(x.z > 0.0)) { return vec4<f32>(0.0); }
    let w = headtail_direction(x.xy).xyz;
    return vec4<f32>(w, headtail_mixed(w, headtail_rest_pdf(n, wo, lobes, w)));
}

// The solid-angle pdf with which `headtail_sample` draws a unit direction.
fn headtail_pdf(n: vec3<f32>, wo: vec3<f32>, lobes: vec4<f32>, wi: vec3<f32>) -> f32 {
    headtail_share_light(n);
    return headtail_mixed(wi, headtail_rest_pdf(n, wo, lobes, wi));
}
