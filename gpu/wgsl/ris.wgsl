// Resampled importance sampling (Talbot et al. 2005): candidates that alternate between the sampler and BRDF sampling, with the balance
// heuristic between them, of which one survives in proportion to luminance of light x BRDF x cosine.

fn headtail_estimate(at: HeadtailPoint, throughput: vec3<f32>, first_group: u32, key: u32) -> HeadtailLight {
    headtail_begin(at);
    let of_second = HEADTAIL_DIRECTIONS / 2u;
    let counts = vec2<f32>(f32(HEADTAIL_DIRECTIONS - of_second), f32(of_second));
    var total = 0.0;
    var kept = vec4<f32>(0.0);
    // One number, independent of all candidates, draws the survivor.
    var random = headtail_numbers(first_group, key).z;
    for (var index = 0u; index < HEADTAIL_DIRECTIONS; index++) {
        let z = headtail_numbers(first_group + index, key).xy;
        var drawn: vec4<f32>;
        var density: f32;
        if ((index & 1u) == 0u) {
            drawn = headtail_draw_direction(at, z);
            density = counts.x * drawn.w + counts.y * headtail_bsdf_pdf(at, drawn.xyz);
        } else {
            drawn = headtail_bsdf_sample(at, z);
            density = counts.y * drawn.w + counts.x * headtail_direction_pdf(at, drawn.xyz);
        }
        if (!(drawn.w > 0.0)) { continue; }
        let goal = headtail_luminance(headtail_radiance(drawn.xyz) * headtail_reflected(at, drawn.xyz));
        let weight = goal / density;
        if (!(goal > 0.0 && weight > 0.0)) { continue; }
        total += weight;
        if (random * total < weight) {
            random = headtail_remap(random * total, 0.0, weight);
            kept = vec4<f32>(drawn.xyz, goal);
        } else {
            random = headtail_remap(random * total, weight, total);
        }
    }
    var sum = HeadtailLight(vec3<f32>(0.0), 0.0, 0.0);
    if (kept.w > 0.0) { sum = headtail_add(sum, at, kept.xyz, (total / kept.w) * throughput); }
    return sum;
}
