// Points of the square of a head over a tail that does not match the light exactly.

fn prepare_square(at: Surface) {
}

// The density of the light over X.
fn light_density(x: vec2<f32>) -> f32 {
    let cell = headtail_cell(x);
    let row = HEADTAIL_LIGHT_NODES + u32(cell.y) * HEADTAIL_WIDTH;
    let columns = vec2<u32>(u32(cell.x), (u32(cell.x) + 1u) % HEADTAIL_WIDTH);
    let upper = mix(headtail_floats[row + columns.x], headtail_floats[row + columns.y], cell.z);
    let lower = mix(headtail_floats[row + HEADTAIL_WIDTH + columns.x], headtail_floats[row + HEADTAIL_WIDTH + columns.y], cell.z);
    return mix(upper, lower, cell.w);
}

// The point of X that the tail carries y to, the density |dy/dx| there, and that over the light's, which multiplies what is reflected.
fn image_of(y: vec2<f32>) -> vec4<f32> {
    let image = headtail_tail(y);
    return vec4<f32>(image, image.z / max(light_density(image.xy), 1e-30));
}

// The point of the square that is carried to a point of X, and a positive number if there is one.
fn back_to_square(x: vec2<f32>) -> vec3<f32> {
    return headtail_pull_back(x);
}
