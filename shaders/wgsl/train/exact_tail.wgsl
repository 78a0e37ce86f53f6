// A tail that matches the light.

// The density of the tail over that of the light, at an image of it.
fn tail_over_light(image: vec3<f32>) -> f32 {
    return 1.0;
}
