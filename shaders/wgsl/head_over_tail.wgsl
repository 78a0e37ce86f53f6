// The sampler of a head over a tail.

fn headtail_prepare(at: HeadtailSurface) {
    headtail_at = at;
    headtail_see(at.n, at.wo, at.lobes.w);
}

// The learned mixture weight, or 1/2.
fn headtail_share_here() -> f32 {
    if (HEADTAIL_HEAD_MIXTURE_WEIGHT_LAYERS == 0u) { return 0.5; }
    return headtail_head_mixture_weight(0.0);
}

fn headtail_sample_here(z: vec2<f32>) -> vec4<f32> {
    let y = headtail_head_draw(z);
    return headtail_through_tail(y.xy, y.z);
}

fn headtail_pdf_here(wi: vec3<f32>) -> f32 {
    let x = headtail_square(wi);
    let y = headtail_pull_back(x.xy);
    return headtail_head_density(y.xy) * y.z * x.z;
}
