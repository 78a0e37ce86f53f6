// What a head for measured or neural materials is told of the point's.

fn headtail_tell_material(at: HeadtailPoint) {
    let is_told = at.is_fitted && headtail_is_neural == (HEADTAIL_HEAD_CONDITION == 22u);
    for (var k = 0u; k < HEADTAIL_HEAD_CONDITION - 10u; k++) {
        var number = 0.0;
        if (is_told) { number = headtail_told(k); }
        headtail_latents[k] = number;
    }
}

fn headtail_told(k: u32) -> f32 {
    if (!headtail_is_neural) { return headtail_number(headtail_fitted + HEADTAIL_MEASURED_LATENTS + k); }
    if (k < 8u) { return headtail_features[k / 4u][k & 3u]; }
    let frame = headtail_frame_of_texture;
    return vec4<f32>(frame.s, select(1.0, -1.0, dot(cross(frame.n, frame.s), frame.t) < 0.0))[k - 8u];
}
