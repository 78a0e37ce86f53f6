// The row-column tail: first a row by its share of the light, then a column within the row.

// The integral of the blended row from its first texel's centre to the left edge of a cell.
fn headtail_before(row: u32, t: f32, column: u32) -> f32 {
    let upper = HEADTAIL_TAIL_BEFORE + row * (HEADTAIL_WIDTH + 1u) + column;
    return (1.0 - t) * headtail_floats[upper] + t * headtail_floats[upper + HEADTAIL_WIDTH + 1u];
}

// x of a point y of Y, and the density |dy/dx| there.
fn headtail_tail(y: vec2<f32>) -> vec3<f32> {
    let u = clamp(y.x, 0.0, HEADTAIL_BELOW_ONE);
    let v = clamp(y.y, 0.0, HEADTAIL_BELOW_ONE);
    var row = 0u;
    for (var size = HEADTAIL_ROWS; size > 1u; size -= size / 2u) {
        if (headtail_floats[HEADTAIL_TAIL_ABOVE + row + size / 2u] <= v) { row += size / 2u; }
    }
    let above = headtail_remap(v, headtail_floats[HEADTAIL_TAIL_ABOVE + row], headtail_floats[HEADTAIL_TAIL_ABOVE + row + 1u]);
    let t = headtail_sample_linear(above, headtail_floats[HEADTAIL_TAIL_MARGINAL + row], headtail_floats[HEADTAIL_TAIL_MARGINAL + row + 1u]);
    let goal = u * headtail_before(row, t, HEADTAIL_WIDTH);
    var column = 0u;
    for (var size = HEADTAIL_WIDTH; size > 1u; size -= size / 2u) {
        if (headtail_before(row, t, column + size / 2u) <= goal) { column += size / 2u; }
    }
    let left = headtail_remap(goal, headtail_before(row, t, column), headtail_before(row, t, column + 1u));
    let c = headtail_corners(vec2<u32>(column, row));
    let west = (1.0 - t) * c.x + t * c.z;
    let east = (1.0 - t) * c.y + t * c.w;
    let s = headtail_sample_linear(left, west, east);
    let x = (f32(column) + s + 0.5) / f32(HEADTAIL_WIDTH);
    return vec3<f32>(
        select(x, clamp(x - 1.0, 0.0, HEADTAIL_BELOW_ONE), x >= 1.0),
        min((f32(row) + t) / f32(HEADTAIL_ROWS), 1.0),
        (1.0 - s) * west + s * east,
    );
}

// y of a point of X, and |dy/dx| there.
fn headtail_pull_back(x: vec2<f32>) -> vec3<f32> {
    let cell = headtail_cell(x);
    let column = u32(cell.x);
    let row = u32(cell.y);
    let c = headtail_corners(vec2<u32>(column, row));
    let marginal = vec2<f32>(headtail_floats[HEADTAIL_TAIL_MARGINAL + row], headtail_floats[HEADTAIL_TAIL_MARGINAL + row + 1u]);
    let above = vec2<f32>(headtail_floats[HEADTAIL_TAIL_ABOVE + row], headtail_floats[HEADTAIL_TAIL_ABOVE + row + 1u]);
    let v = above.x + headtail_invert_linear(cell.w, marginal.x, marginal.y) * (above.y - above.x);
    let across = headtail_invert_linear(cell.z, (1.0 - cell.w) * c.x + cell.w * c.z, (1.0 - cell.w) * c.y + cell.w * c.w);
    let start = headtail_before(row, cell.w, column);
    let end = headtail_before(row, cell.w, column + 1u);
    let total = headtail_before(row, cell.w, HEADTAIL_WIDTH);
    var u = cell.z;
    if (total > 0.0) { u = (start + across * (end - start)) / total; }
    return vec3<f32>(min(vec2<f32>(u, v), vec2<f32>(HEADTAIL_BELOW_ONE)), headtail_density(cell));
}
