// Directions by BRDF sampling.

fn headtail_draw_direction(at: HeadtailPoint, z: vec2<f32>) -> vec4<f32> {
    return headtail_bsdf_sample(at, z);
}

fn headtail_begin(at: HeadtailPoint) {}
