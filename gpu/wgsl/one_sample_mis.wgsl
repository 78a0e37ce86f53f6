// Directions from the sampler with its mixture weight, else by BRDF sampling: one-sample MIS with the balance heuristic.

fn headtail_draw_direction(at: HeadtailPoint, z: vec2<f32>) -> vec4<f32> {
    let weight = headtail_weight;
    if (z.x < weight) {
        let drawn = headtail_sample_here(vec2<f32>(headtail_remap(z.x, 0.0, weight), z.y));
        if (weight == 1.0) { return drawn; }
        let pdf = weight * drawn.w + (1.0 - weight) * headtail_bsdf_pdf(at, drawn.xyz);
        return vec4<f32>(drawn.xyz, select(0.0, pdf, drawn.w > 0.0));
    }
    let drawn = headtail_bsdf_sample(at, vec2<f32>(headtail_remap(z.x, weight, 1.0), z.y));
    if (!(drawn.w > 0.0)) { return vec4<f32>(drawn.xyz, 0.0); }
    return vec4<f32>(drawn.xyz, weight * headtail_pdf_here(drawn.xyz) + (1.0 - weight) * drawn.w);
}

fn headtail_direction_pdf(at: HeadtailPoint, wi: vec3<f32>) -> f32 {
    return headtail_weight * headtail_pdf_here(wi) + (1.0 - headtail_weight) * headtail_bsdf_pdf(at, wi);
}
