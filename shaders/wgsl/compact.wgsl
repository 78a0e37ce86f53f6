// Compact emitters in a mixture with a sampler of the rest of the light. Shares are those of a diffuse surface, whatever the surface is.

const HEADTAIL_LEAST_SHARE: f32 = 0.01;
const HEADTAIL_LEAST_REST: f32 = 0.05;

var<private> headtail_shares: array<f32, HEADTAIL_EMITTERS_AND_REST>;

fn headtail_vector(start: u32, k: u32) -> vec3<f32> {
    let at = start + 3u * k;
    return vec3<f32>(headtail_floats[at], headtail_floats[at + 1u], headtail_floats[at + 2u]);
}

// What a diffuse surface reflects of the rest, bilinear between the middles of 32 x 16 cells.
fn headtail_seen(n: vec3<f32>) -> f32 {
    let x = headtail_square(n);
    let place = vec2<f32>(32.0 * x.x + 31.5, clamp(16.0 * x.y - 0.5, 0.0, 15.0));
    let left = u32(place.x);
    let top = min(u32(place.y), 14u);
    let part = place - vec2<f32>(f32(left), f32(top));
    let row = HEADTAIL_COMPACT_SEEN + 32u * top;
    let columns = vec2<u32>(left % 32u, (left + 1u) % 32u);
    let above = mix(headtail_floats[row + columns.x], headtail_floats[row + columns.y], part.x);
    let below = mix(headtail_floats[row + 32u + columns.x], headtail_floats[row + 32u + columns.y], part.x);
    return mix(above, below, part.y);
}

// Shares of samples, in proportion to the light that a surface reflects of each emitter and of the rest, as far as four points of an emitter show it.
fn headtail_share_light(n: vec3<f32>) {
    var total = 0.0;
    for (var k = 0u; k < HEADTAIL_EMITTERS; k++) {
        var light = 0.0;
        for (var j = 0u; j < 4u; j++) {
            let cosine = dot(n, headtail_vector(HEADTAIL_COMPACT_TOWARDS, 4u * k + j));
            light += max(cosine, 0.0) / (4.0 * HEADTAIL_PI) * headtail_floats[HEADTAIL_COMPACT_POWERS + k];
        }
        headtail_shares[k] = light;
        total += light;
    }
    let rest = headtail_seen(n);
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
