// The mean of several pairs of directions, one from the sampler and one by BRDF sampling: two-sample MIS with the power heuristic.

// p^2 / (p^2 + q^2) / p, written so that a large p does not overflow.
fn headtail_power(own: f32, other: f32) -> f32 {
    let ratio = other / own;
    return 1.0 / (f32(HEADTAIL_DIRECTIONS) * own * (1.0 + ratio * ratio));
}

fn headtail_estimate(at: HeadtailPoint, throughput: vec3<f32>, first_group: u32, key: u32) -> HeadtailLight {
    headtail_begin(at);
    var sum = HeadtailLight(vec3<f32>(0.0), 0.0, 0.0);
    for (var index = 0u; index < HEADTAIL_DIRECTIONS; index++) {
        let first = headtail_draw_direction(at, headtail_numbers(first_group + 2u * index, key).xy);
        if (first.w > 0.0) {
            sum = headtail_add(sum, at, first.xyz, headtail_power(first.w, headtail_bsdf_pdf(at, first.xyz)) * throughput);
        }
        let second = headtail_bsdf_sample(at, headtail_numbers(first_group + 2u * index + 1u, key).xy);
        if (second.w > 0.0) {
            sum = headtail_add(sum, at, second.xyz, headtail_power(second.w, headtail_direction_pdf(at, second.xyz)) * throughput);
        }
    }
    return sum;
}
