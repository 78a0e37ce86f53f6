// Directions from the sampler alone.

fn headtail_begin(at: HeadtailPoint) {
    headtail_prepare_point(at);
}

fn headtail_draw_direction(at: HeadtailPoint, z: vec2<f32>) -> vec4<f32> {
    return headtail_sample_here(z);
}

fn headtail_direction_pdf(at: HeadtailPoint, wi: vec3<f32>) -> f32 {
    return headtail_pdf_here(wi);
}
