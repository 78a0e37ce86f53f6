// Points of the square of a head over a tail.

fn prepare_square(at: Surface) {
}

// The point of X that the tail carries y to, the density |dy/dx| there, and that over the light's, by which what is reflected is divided.
fn image_of(y: vec2<f32>) -> vec4<f32> {
    let image = headtail_tail(y);
    return vec4<f32>(image, tail_over_light(image));
}

// The point of the square that is carried to a point of X, and a positive number if there is one.
fn back_to_square(x: vec2<f32>) -> vec3<f32> {
    return headtail_pull_back(x);
}
