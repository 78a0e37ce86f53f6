// A tail that does not match the light exactly.

// The density of the light over X.
fn light_density(x: vec2<f32>) -> f32 {
    let cell = headtail_cell(x);
    let row = HEADTAIL_LIGHT_NODES + u32(cell.y) * HEADTAIL_WIDTH;
    let columns = vec2<u32>(u32(cell.x), (u32(cell.x) + 1u) % HEADTAIL_WIDTH);
    let upper = mix(headtail_float(row + columns.x), headtail_float(row + columns.y), cell.z);
    let lower = mix(headtail_float(row + HEADTAIL_WIDTH + columns.x), headtail_float(row + HEADTAIL_WIDTH + columns.y), cell.z);
    return mix(upper, lower, cell.w);
}

// The density of the tail over that of the light, at an image of it.
fn tail_over_light(image: vec3<f32>) -> f32 {
    return image.z / max(light_density(image.xy), 1e-30);
}
