// The sampler of a head over a tail.

// The mixture weight beside sampling the BSDF, the fraction of samples to draw here: the learned one, or 1/2.
fn headtail_share(n: vec3<f32>, wo: vec3<f32>, lobes: vec4<f32>) -> f32 {
    if (HEADTAIL_HEAD_MIXTURE_WEIGHT_LAYERS == 0u) { return 0.5; }
    return headtail_head_mixture_weight(n, wo, lobes.w, 0.0);
}

// Draws a direction for a uniform point z of [0, 1)^2: (wi, solid-angle pdf); pdf 0 is no sample.
fn headtail_sample(n: vec3<f32>, wo: vec3<f32>, lobes: vec4<f32>, z: vec2<f32>) -> vec4<f32> {
    let y = headtail_head_draw(n, wo, lobes.w, z);
    return headtail_through_tail(y.xy, y.z);
}

// The solid-angle pdf with which `headtail_sample` draws a unit direction.
fn headtail_pdf(n: vec3<f32>, wo: vec3<f32>, lobes: vec4<f32>, wi: vec3<f32>) -> f32 {
    let x = headtail_square(wi);
    let y = headtail_pull_back(x.xy);
    return headtail_head_density(n, wo, lobes.w, y.xy) * y.z * x.z;
}
