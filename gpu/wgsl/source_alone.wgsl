// Directions from the sampler alone.

fn headtail_begin(at: HeadtailPoint) {
    headtail_find_cell(at.p, at.ns);
    headtail_position = at.p;
    headtail_prepare(HeadtailSurface(at.ns, at.wo, at.lobes));
}

fn headtail_draw_direction(at: HeadtailPoint, z: vec2<f32>) -> vec4<f32> {
    return headtail_sample_here(z);
}

fn headtail_direction_pdf(at: HeadtailPoint, wi: vec3<f32>) -> f32 {
    return headtail_pdf_here(wi);
}
