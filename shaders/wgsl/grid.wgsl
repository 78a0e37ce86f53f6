// The density of the map's light over X: bilinear in the cells between texels.

// The densities at the corners of a cell: upper left, upper right, lower left, lower right.
fn headtail_corners(cell: vec2<u32>) -> vec4<f32> {
    let next = select(cell.x + 1u, 0u, cell.x + 1u == HEADTAIL_WIDTH);
    let upper = HEADTAIL_TAIL_NODES + cell.y * HEADTAIL_WIDTH;
    let lower = upper + HEADTAIL_WIDTH;
    return vec4<f32>(
        headtail_floats[upper + cell.x],
        headtail_floats[upper + next],
        headtail_floats[lower + cell.x],
        headtail_floats[lower + next],
    );
}

// The cell of a point of X (two numbers, as bits), and the position inside.
fn headtail_cell(x: vec2<f32>) -> vec4<f32> {
    let shifted = x.x * f32(HEADTAIL_WIDTH) - 0.5;
    let across = select(shifted, shifted + f32(HEADTAIL_WIDTH), shifted < 0.0);
    let down = x.y * f32(HEADTAIL_ROWS);
    let column = clamp(i32(across), 0, i32(HEADTAIL_WIDTH) - 1);
    let row = clamp(i32(down), 0, i32(HEADTAIL_ROWS) - 1);
    let place = clamp(vec2<f32>(across - f32(column), down - f32(row)), vec2<f32>(0.0), vec2<f32>(1.0));
    return vec4<f32>(f32(column), f32(row), place);
}

// |dy/dx| at a cell's position.
fn headtail_density(cell: vec4<f32>) -> f32 {
    let c = headtail_corners(vec2<u32>(cell.xy));
    let west = (1.0 - cell.w) * c.x + cell.w * c.z;
    let east = (1.0 - cell.w) * c.y + cell.w * c.w;
    return (1.0 - cell.z) * west + cell.z * east;
}
