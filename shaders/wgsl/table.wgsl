// A table over normals, interpolated between them: for diffuse surfaces. `wo` and `lobes` are not looked at.

struct HeadtailBlend { nodes: vec4<u32>, weights: vec4<f32> }

// The polynomial that the tables are interpolated by (Abramowitz and Stegun 1964, 4.4.49).
fn headtail_fast_atan2(y: f32, x: f32) -> f32 {
    let a = min(abs(y), abs(x)) / max(max(abs(y), abs(x)), HEADTAIL_TINY);
    let s = a * a;
    var angle = a * (0.999866 + s * (-0.3302995 + s * (0.180141 + s * (-0.085133 + s * 0.0208351))));
    angle = select(angle, 0.5 * HEADTAIL_PI - angle, abs(y) > abs(x));
    angle = select(angle, HEADTAIL_PI - angle, x < 0.0);
    return select(angle, -angle, y < 0.0);
}

// The nodes around the normal that was prepared.
var<private> headtail_nodes: HeadtailBlend;

// The four nodes around a normal, and their weights.
fn headtail_around(n: vec3<f32>) -> HeadtailBlend {
    let azimuths = f32(HEADTAIL_AZIMUTH);
    var a = headtail_fast_atan2(n.x, -n.z) * (azimuths / (2.0 * HEADTAIL_PI));
    a = select(a, a + azimuths, a < 0.0);
    let p = max(headtail_fast_atan2(sqrt(n.x * n.x + n.z * n.z), n.y), 0.0) * (f32(HEADTAIL_POLAR - 1u) / HEADTAIL_PI);
    let column = u32(clamp(i32(a), 0, i32(HEADTAIL_AZIMUTH) - 1));
    let row = u32(clamp(i32(p), 0, i32(HEADTAIL_POLAR) - 2));
    let s = clamp(a - f32(column), 0.0, 1.0);
    let t = clamp(p - f32(row), 0.0, 1.0);
    let corner = row * HEADTAIL_AZIMUTH + column;
    let next = select(corner + 1u, row * HEADTAIL_AZIMUTH, column + 1u == HEADTAIL_AZIMUTH);
    return HeadtailBlend(
        vec4<u32>(corner, next, corner + HEADTAIL_AZIMUTH, next + HEADTAIL_AZIMUTH),
        vec4<f32>((1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t),
    );
}

// Numbers of four nodes, times their weights.
fn headtail_blend(b: HeadtailBlend, start: u32, stride: u32, k: u32) -> f32 {
    let at = vec4<u32>(start + k) + stride * b.nodes;
    return dot(b.weights, vec4<f32>(headtail_float(at.x), headtail_float(at.y), headtail_float(at.z), headtail_float(at.w)));
}

fn headtail_down(b: HeadtailBlend, row: u32) -> f32 {
    return headtail_blend(b, HEADTAIL_TABLE_DOWN, HEADTAIL_TABLE_ROWS, row);
}

fn headtail_along(b: HeadtailBlend, row: u32, column: u32) -> f32 {
    return headtail_blend(b, HEADTAIL_TABLE_ALONG, HEADTAIL_TABLE_ROWS * HEADTAIL_TABLE_COLUMNS, row * HEADTAIL_TABLE_COLUMNS + column);
}

fn headtail_mass(b: HeadtailBlend, row: u32, column: u32) -> f32 {
    return headtail_blend(b, HEADTAIL_TABLE_MASSES, HEADTAIL_TABLE_ROWS * HEADTAIL_TABLE_COLUMNS, row * HEADTAIL_TABLE_COLUMNS + column);
}

fn headtail_of_mass(mass: f32, total: f32) -> f32 {
    return mass * f32(HEADTAIL_TABLE_ROWS * HEADTAIL_TABLE_COLUMNS) / total;
}

fn headtail_prepare(at: HeadtailSurface) {
    headtail_at = at;
    headtail_nodes = headtail_around(at.n);
}

// All samples are drawn here: the table is for diffuse surfaces.
fn headtail_share_here() -> f32 {
    return 1.0;
}

fn headtail_sample_here(z: vec2<f32>) -> vec4<f32> {
    let b = headtail_nodes;
    let total = headtail_down(b, HEADTAIL_TABLE_ROWS - 1u);
    var row = 0u;
    var before = 0.0;
    for (var size = HEADTAIL_TABLE_ROWS; size > 1u; size -= size / 2u) {
        let value = headtail_down(b, row + size / 2u - 1u);
        if (value <= z.y * total) { row += size / 2u; before = value; }
    }
    let below = headtail_remap(z.y * total, before, headtail_down(b, row));
    let goal = z.x * headtail_along(b, row, HEADTAIL_TABLE_COLUMNS - 1u);
    var column = 0u;
    var low = 0.0;
    for (var size = HEADTAIL_TABLE_COLUMNS; size > 1u; size -= size / 2u) {
        let value = headtail_along(b, row, column + size / 2u - 1u);
        if (value <= goal) { column += size / 2u; low = value; }
    }
    let high = headtail_along(b, row, column);
    let u = min(f32(column) + headtail_remap(goal, low, high), f32(column + 1u) * HEADTAIL_BELOW_ONE) / f32(HEADTAIL_TABLE_COLUMNS);
    let v = min(f32(row) + below, f32(row + 1u) * HEADTAIL_BELOW_ONE) / f32(HEADTAIL_TABLE_ROWS);
    return headtail_through_tail(vec2<f32>(u, v), headtail_of_mass(headtail_mass(b, row, column), total));
}

fn headtail_pdf_here(wi: vec3<f32>) -> f32 {
    let b = headtail_nodes;
    let x = headtail_square(wi);
    let y = headtail_pull_back(x.xy);
    let row = min(u32(y.y * f32(HEADTAIL_TABLE_ROWS)), HEADTAIL_TABLE_ROWS - 1u);
    let column = min(u32(y.x * f32(HEADTAIL_TABLE_COLUMNS)), HEADTAIL_TABLE_COLUMNS - 1u);
    return headtail_of_mass(headtail_mass(b, row, column), headtail_down(b, HEADTAIL_TABLE_ROWS - 1u)) * y.z * x.z;
}
