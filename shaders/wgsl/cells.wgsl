// The cells between the texels of a map.

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

// The point of X at a position in a cell.
fn headtail_point(cell: vec2<u32>, inside: vec2<f32>) -> vec2<f32> {
    let x = (f32(cell.x) + inside.x + 0.5) / f32(HEADTAIL_WIDTH);
    return vec2<f32>(select(x, clamp(x - 1.0, 0.0, HEADTAIL_BELOW_ONE), x >= 1.0), min((f32(cell.y) + inside.y) / f32(HEADTAIL_ROWS), 1.0));
}
