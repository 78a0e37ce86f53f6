// The sampler of a head over patches of sky: it draws what they leave over.

// The mixture weight beside sampling the BSDF, the fraction of samples to draw here: the learned one is a factor of the odds of patches.
fn headtail_share(n: vec3<f32>, wo: vec3<f32>, lobes: vec4<f32>) -> f32 {
    let mixture_weight = headtail_mixture_weight_by_width(lobes);
    if (HEADTAIL_HEAD_MIXTURE_WEIGHT_LAYERS == 0u) { return mixture_weight; }
    let inside = clamp((mixture_weight - 0.02) / 0.96, 1e-3, 1.0 - 1e-3);
    return headtail_head_mixture_weight(n, wo, lobes.w, headtail_ln(inside / (1.0 - inside)));
}

// Draws a direction for a uniform point z of [0, 1)^2: (wi, solid-angle pdf); pdf 0 is no sample.
fn headtail_sample(n: vec3<f32>, wo: vec3<f32>, lobes: vec4<f32>, z: vec2<f32>) -> vec4<f32> {
    let through = headtail_head_draw(n, wo, lobes.w, z);
    let y = headtail_patches_draw(HeadtailSurface(n, wo, lobes), through.xy);
    return headtail_through_tail(y.xy, through.z * y.z);
}

// The solid-angle pdf with which `headtail_sample` draws a unit direction.
fn headtail_pdf(n: vec3<f32>, wo: vec3<f32>, lobes: vec4<f32>, wi: vec3<f32>) -> f32 {
    let x = headtail_square(wi);
    let cell = headtail_cell(x.xy);
    let found = headtail_patch_of(HeadtailSurface(n, wo, lobes), cell);
    if (!(found.density > 0.0)) { return 0.0; }
    let inside = headtail_inside(found.rectangle, headtail_inverse(cell));
    let through = min(found.sides.xz + inside * (found.sides.yw - found.sides.xz), vec2<f32>(HEADTAIL_BELOW_ONE));
    return headtail_head_density(n, wo, lobes.w, through) * found.density * headtail_density(cell) * x.z;
}
