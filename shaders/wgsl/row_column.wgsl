// The row-column tail.

// x of a point y of Y, and the density |dy/dx| there.
fn headtail_tail(y: vec2<f32>) -> vec3<f32> {
    return headtail_window_forward(headtail_window(HEADTAIL_TAIL_WINDOWS, 0u, HEADTAIL_TAIL_NUMBERS), y);
}

// y of a point of X, and |dy/dx| there.
fn headtail_pull_back(x: vec2<f32>) -> vec3<f32> {
    return headtail_window_back(headtail_window(HEADTAIL_TAIL_WINDOWS, 0u, HEADTAIL_TAIL_NUMBERS), x);
}
