// The quad-tree tail: points of Y to points of X, and cells of X; and functions that all samplers share.

const HEADTAIL_PI: f32 = 3.14159265358979;
const HEADTAIL_BELOW_ONE: f32 = 0.99999994;
const HEADTAIL_LEAST_SINE: f32 = 1e-7;
const HEADTAIL_TINY: f32 = 1.17549435e-38;

// The position of a number in an interval, in [0, 1): what is left of a uniform number that chose it.
fn headtail_remap(at: f32, start: f32, end: f32) -> f32 {
    if (!(end > start)) { return 0.0; }
    return clamp((at - start) / (end - start), 0.0, HEADTAIL_BELOW_ONE);
}

// Cosine and sine of whole turns, to 2e-7: devices promise less of their own. After Cephes.
fn headtail_cos_sin_turns(turns: f32) -> vec2<f32> {
    let quarter = round(4.0 * turns);
    let quadrant = u32(i32(quarter)) & 3u;
    let x = (turns - 0.25 * quarter) * (2.0 * HEADTAIL_PI);
    let s = x * x;
    let sine = ((-1.9515296e-4 * s + 8.332161e-3) * s - 1.6666655e-1) * s * x + x;
    let cosine = ((2.4433157e-5 * s - 1.3887316e-3) * s + 4.1666646e-2) * s * s - 0.5 * s + 1.0;
    let odd = (quadrant & 1u) != 0u;
    let c = select(cosine, sine, odd);
    let t = select(sine, cosine, odd);
    return vec2<f32>(select(c, -c, ((quadrant + 1u) & 2u) != 0u), select(t, -t, (quadrant & 2u) != 0u));
}

// The angle of a point in whole turns, in [-1/2, 1/2], to 3e-7. After Cephes.
fn headtail_atan2_turns(y: f32, x: f32) -> f32 {
    let steep = abs(y) > abs(x);
    let small = select(abs(y), abs(x), steep);
    let large = select(abs(x), abs(y), steep);
    let beyond = small > 0.41421357 * large;
    let above = select(small, small - large, beyond);
    let below = select(large, small + large, beyond);
    let t = above / select(below, 1.0, below == 0.0);
    let s = t * t;
    var turns = ((((8.0537445e-2 * s - 1.3877686e-1) * s + 1.997771e-1) * s - 3.333295e-1) * s * t + t) * (0.5 / HEADTAIL_PI);
    turns = select(turns, 0.125 + turns, beyond);
    turns = select(turns, 0.25 - turns, steep);
    turns = select(turns, 0.5 - turns, x < 0.0);
    return select(turns, -turns, y < 0.0);
}

// The unit direction of a point of X; the fourth number is the factor from densities over X to pdfs over solid angle.
fn headtail_direction(x: vec2<f32>) -> vec4<f32> {
    let phi = headtail_cos_sin_turns(x.x);
    let theta = headtail_cos_sin_turns(0.5 * x.y);
    let factor = 1.0 / (2.0 * HEADTAIL_PI * HEADTAIL_PI * max(theta.y, HEADTAIL_LEAST_SINE));
    return vec4<f32>(phi.y * theta.y, theta.x, -phi.x * theta.y, factor);
}

// The point of X of a unit direction, and the same factor.
fn headtail_square(w: vec3<f32>) -> vec3<f32> {
    let horizontal = sqrt(w.x * w.x + w.z * w.z);
    var u = headtail_atan2_turns(w.x, -w.z);
    u = select(u, u + 1.0, u < 0.0);
    let v = min(2.0 * headtail_atan2_turns(horizontal, w.y), 1.0);
    let sine = headtail_cos_sin_turns(0.5 * v).y;
    return vec3<f32>(select(u, 0.0, u >= 1.0), v, 1.0 / (2.0 * HEADTAIL_PI * HEADTAIL_PI * max(sine, HEADTAIL_LEAST_SINE)));
}

// The point at which the linear density from a to b has accumulated the share u, and the inverse.
fn headtail_sample_linear(u: f32, a: f32, b: f32) -> f32 {
    let below = a + sqrt(max(a * a + u * (b * b - a * a), 0.0));
    if (!(below > 0.0)) { return 0.0; }
    return min(u * (a + b) / below, HEADTAIL_BELOW_ONE);
}

fn headtail_invert_linear(t: f32, a: f32, b: f32) -> f32 {
    if (!(a + b > 0.0)) { return t; }
    return min(t * (a * (2.0 - t) + b * t) / (a + b), HEADTAIL_BELOW_ONE);
}

// Four numbers of a list, from the place 4 k after its start.
fn headtail_four(start: u32, k: u32) -> vec4<f32> {
    let at = start + 4u * k;
    return vec4<f32>(headtail_floats[at], headtail_floats[at + 1u], headtail_floats[at + 2u], headtail_floats[at + 3u]);
}

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

// x of a point y of Y, and the density |dy/dx| there.
fn headtail_tail(y: vec2<f32>) -> vec3<f32> {
    let u = clamp(y.x, 0.0, HEADTAIL_BELOW_ONE);
    let v = clamp(y.y, 0.0, HEADTAIL_BELOW_ONE);
    var index = 0u;
    var cell = vec2<u32>(0u, 0u);
    // Left, right, top, bottom.
    var sides = vec4<f32>(0.0, 1.0, 0.0, 1.0);
    for (var level = 0u; level < HEADTAIL_LEVELS; level++) {
        let bits = vec2<u32>(headtail_integers[HEADTAIL_TAIL_LEVELS + 3u * level], headtail_integers[HEADTAIL_TAIL_LEVELS + 3u * level + 1u]);
        let cuts = headtail_four(HEADTAIL_TAIL_CUTS, headtail_integers[HEADTAIL_TAIL_LEVELS + 3u * level + 2u] + index);
        let lower = bits.y == 1u && v >= cuts.x;
        if (bits.y == 1u) {
            sides = select(vec4<f32>(sides.xyz, cuts.x), vec4<f32>(sides.xy, cuts.x, sides.w), lower);
        }
        let vertical = select(cuts.y, cuts.z, lower);
        let east = bits.x == 1u && u >= vertical;
        if (bits.x == 1u) {
            sides = select(vec4<f32>(sides.x, vertical, sides.zw), vec4<f32>(vertical, sides.yzw), east);
        }
        let half = vec2<u32>(select(0u, 1u, east), select(0u, 1u, lower));
        index = (index << (bits.x + bits.y)) + (half.y << bits.x) + half.x;
        cell = (cell << bits) + half;
    }
    let c = headtail_corners(cell);
    let down = headtail_sample_linear(headtail_remap(v, sides.z, sides.w), c.x + c.y, c.z + c.w);
    let west = (1.0 - down) * c.x + down * c.z;
    let east = (1.0 - down) * c.y + down * c.w;
    let across = headtail_sample_linear(headtail_remap(u, sides.x, sides.y), west, east);
    let x = (f32(cell.x) + across + 0.5) / f32(HEADTAIL_WIDTH);
    return vec3<f32>(
        select(x, clamp(x - 1.0, 0.0, HEADTAIL_BELOW_ONE), x >= 1.0),
        min((f32(cell.y) + down) / f32(HEADTAIL_ROWS), 1.0),
        (1.0 - across) * west + across * east,
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

// y of a cell's position: down the tree to the cell's rectangle.
fn headtail_inverse(cell: vec4<f32>) -> vec2<f32> {
    let place = vec2<u32>(cell.xy);
    var index = 0u;
    var sides = vec4<f32>(0.0, 1.0, 0.0, 1.0);
    for (var level = 0u; level < HEADTAIL_LEVELS; level++) {
        let bits = vec2<u32>(headtail_integers[HEADTAIL_TAIL_LEVELS + 3u * level], headtail_integers[HEADTAIL_TAIL_LEVELS + 3u * level + 1u]);
        let cuts = headtail_four(HEADTAIL_TAIL_CUTS, headtail_integers[HEADTAIL_TAIL_LEVELS + 3u * level + 2u] + index);
        let half = ((place >> vec2<u32>(HEADTAIL_LEVELS - 1u - level)) & vec2<u32>(1u)) * bits;
        if (bits.y == 1u) {
            sides = select(vec4<f32>(sides.xyz, cuts.x), vec4<f32>(sides.xy, cuts.x, sides.w), half.y == 1u);
        }
        let vertical = select(cuts.y, cuts.z, half.y == 1u);
        if (bits.x == 1u) {
            sides = select(vec4<f32>(sides.x, vertical, sides.zw), vec4<f32>(vertical, sides.yzw), half.x == 1u);
        }
        index = (index << (bits.x + bits.y)) + (half.y << bits.x) + half.x;
    }
    let c = headtail_corners(place);
    let west = (1.0 - cell.w) * c.x + cell.w * c.z;
    let east = (1.0 - cell.w) * c.y + cell.w * c.w;
    let inside = vec2<f32>(headtail_invert_linear(cell.z, west, east), headtail_invert_linear(cell.w, c.x + c.y, c.z + c.w));
    return min(sides.xz + inside * (sides.yw - sides.xz), vec2<f32>(HEADTAIL_BELOW_ONE));
}
