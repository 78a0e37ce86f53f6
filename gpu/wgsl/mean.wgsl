// The mean of several directions.

fn headtail_estimate(at: HeadtailPoint, throughput: vec3<f32>, first_group: u32, key: u32) -> HeadtailLight {
    headtail_begin(at);
    var sum = HeadtailLight(vec3<f32>(0.0), 0.0, 0.0);
    for (var index = 0u; index < HEADTAIL_DIRECTIONS; index++) {
        let drawn = headtail_draw_direction(at, headtail_numbers(first_group + index, key).xy);
        if (drawn.w > 0.0) {
            let weight = 1.0 / (f32(HEADTAIL_DIRECTIONS) * drawn.w);
            sum = headtail_add(sum, at, drawn.xyz, weight * throughput);
        }
    }
    return sum;
}
