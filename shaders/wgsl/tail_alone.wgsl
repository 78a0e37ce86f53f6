// Emitter sampling: the tail alone.

fn headtail_prepare(at: HeadtailSurface) {
    headtail_at = at;
}

fn headtail_share_here() -> f32 {
    return 0.5;
}

fn headtail_sample_here(z: vec2<f32>) -> vec4<f32> {
    return headtail_through_tail(z, 1.0);
}

fn headtail_pdf_here(wi: vec3<f32>) -> f32 {
    let x = headtail_square(wi);
    return headtail_pull_back(x.xy).z * x.z;
}
