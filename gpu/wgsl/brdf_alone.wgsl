// Directions by BRDF sampling.

fn headtail_begin(at: HeadtailPoint) {}

fn headtail_draw_direction(at: HeadtailPoint, z: vec2<f32>) -> vec4<f32> {
    return headtail_bsdf_sample(at, z);
}

fn headtail_direction_pdf(at: HeadtailPoint, wi: vec3<f32>) -> f32 {
    return headtail_bsdf_pdf(at, wi);
}
