// The row-column tail: first a row by its fraction of the light, then a column within the row. Outside of the window there is no light.

// The first row of cells and how many, the first column and how many, and where its lists begin.
struct HeadtailWindow {
    row: u32, rows: u32, column: u32, columns: u32,
    nodes: u32, marginal: u32, above: u32, before: u32,
}

fn headtail_window() -> HeadtailWindow {
    let at = HEADTAIL_TAIL_WINDOWS;
    let numbers = HEADTAIL_TAIL_NUMBERS;
    return HeadtailWindow(
        headtail_integers[at], headtail_integers[at + 1u], headtail_integers[at + 2u], headtail_integers[at + 3u],
        numbers + headtail_integers[at + 4u], numbers + headtail_integers[at + 5u],
        numbers + headtail_integers[at + 6u], numbers + headtail_integers[at + 7u],
    );
}

// The integral of the blended row from the left edge of the window to that of a cell.
fn headtail_before(w: HeadtailWindow, row: u32, t: f32, column: u32) -> f32 {
    let upper = w.before + row * (w.columns + 1u) + column;
    return (1.0 - t) * headtail_float(upper) + t * headtail_float(upper + w.columns + 1u);
}

// The densities at the left and the right edge of a cell of the window, at a height in it.
fn headtail_edges(w: HeadtailWindow, column: u32, row: u32, t: f32) -> vec2<f32> {
    let upper = w.nodes + row * (w.columns + 1u) + column;
    let lower = upper + w.columns + 1u;
    return vec2<f32>(
        (1.0 - t) * headtail_float(upper) + t * headtail_float(lower),
        (1.0 - t) * headtail_float(upper + 1u) + t * headtail_float(lower + 1u),
    );
}

// x of a point y of Y, and the density |dy/dx| there.
fn headtail_tail(y: vec2<f32>) -> vec3<f32> {
    let w = headtail_window();
    let u = clamp(y.x, 0.0, HEADTAIL_BELOW_ONE);
    let v = clamp(y.y, 0.0, HEADTAIL_BELOW_ONE);
    var row = 0u;
    for (var size = w.rows; size > 1u; size -= size / 2u) {
        if (headtail_float(w.above + row + size / 2u) <= v) { row += size / 2u; }
    }
    let above = headtail_remap(v, headtail_float(w.above + row), headtail_float(w.above + row + 1u));
    let t = headtail_sample_linear(above, headtail_float(w.marginal + row), headtail_float(w.marginal + row + 1u));
    let goal = u * headtail_before(w, row, t, w.columns);
    var column = 0u;
    for (var size = w.columns; size > 1u; size -= size / 2u) {
        if (headtail_before(w, row, t, column + size / 2u) <= goal) { column += size / 2u; }
    }
    let left = headtail_remap(goal, headtail_before(w, row, t, column), headtail_before(w, row, t, column + 1u));
    let edges = headtail_edges(w, column, row, t);
    let s = headtail_sample_linear(left, edges.x, edges.y);
    let x = headtail_point(vec2<u32>(w.column + column, w.row + row), vec2<f32>(s, t));
    return vec3<f32>(x, (1.0 - s) * edges.x + s * edges.y);
}

// y of a point of X, and |dy/dx| there, which is 0 outside of the window.
fn headtail_pull_back(x: vec2<f32>) -> vec3<f32> {
    let w = headtail_window();
    let cell = headtail_cell(x);
    let column = u32(cell.x) - w.column;
    let row = u32(cell.y) - w.row;
    // What is before the window is a large number.
    if (column >= w.columns || row >= w.rows) { return vec3<f32>(0.5, 0.5, 0.0); }
    let marginal = vec2<f32>(headtail_float(w.marginal + row), headtail_float(w.marginal + row + 1u));
    let above = vec2<f32>(headtail_float(w.above + row), headtail_float(w.above + row + 1u));
    let v = above.x + headtail_invert_linear(cell.w, marginal.x, marginal.y) * (above.y - above.x);
    let edges = headtail_edges(w, column, row, cell.w);
    let across = headtail_invert_linear(cell.z, edges.x, edges.y);
    let start = headtail_before(w, row, cell.w, column);
    let total = headtail_before(w, row, cell.w, w.columns);
    var u = cell.z;
    if (total > 0.0) { u = (start + across * (headtail_before(w, row, cell.w, column + 1u) - start)) / total; }
    return vec3<f32>(min(vec2<f32>(u, v), vec2<f32>(HEADTAIL_BELOW_ONE)), (1.0 - cell.z) * edges.x + cell.z * edges.y);
}
