// The sampler of a head over patches of sky: it draws what they leave over.

fn headtail_prepare(at: HeadtailSurface) {
    headtail_prepare_patches(at);
    headtail_see(at.n, at.wo, at.lobes.w);
}

// The learned mixture weight is a factor of the odds of patches.
fn headtail_share_here() -> f32 {
    let mixture_weight = headtail_mixture_weight_by_width(headtail_at.lobes);
    if (HEADTAIL_HEAD_MIXTURE_WEIGHT_LAYERS == 0u) { return mixture_weight; }
    let inside = clamp((mixture_weight - 0.02) / 0.96, 1e-3, 1.0 - 1e-3);
    return headtail_head_mixture_weight(headtail_ln(inside / (1.0 - inside)));
}

fn headtail_sample_here(z: vec2<f32>) -> vec4<f32> {
    let through = headtail_head_draw(z);
    let y = headtail_patches_draw(through.xy);
    return headtail_through_tail(y.xy, through.z * y.z);
}

fn headtail_pdf_here(wi: vec3<f32>) -> f32 {
    let x = headtail_square(wi);
    let cell = headtail_cell(x.xy);
    let back = headtail_patches_back(cell, headtail_inverse(cell));
    if (!(back.z > 0.0)) { return 0.0; }
    return headtail_head_density(back.xy) * back.z * headtail_density(cell) * x.z;
}
