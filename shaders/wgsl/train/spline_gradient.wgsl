// The density direction of splines, one thread per column, and the derivatives of a loss by their logits: those of `headtail_render::spline`, from
// those by logarithms of slopes and by values. Logits are a matrix of one row per logit.

struct Params {
    // Places in the arena, and the stride from row to row.
    logits: u32,
    stride: u32,
    bins: u32,
    is_circle: u32,
    // Place in the batch of the first point's coordinate, and the number of points.
    point: u32,
    count: u32,
    log_slope: u32,
    // 0 where nothing follows from the value.
    has_value: u32,
    value: u32,
    d_log_slope: u32,
    d_value: u32,
    // 1 for one of several splines in a row: points are in the arena, and derivatives by them take the place of those by values.
    is_of_chain: u32,
}

@group(0) @binding(1) var<storage, read> batch: array<f32>;
@group(0) @binding(2) var<storage, read_write> arena: array<f32>;
@group(0) @binding(4) var<uniform> p: Params;

// The logits of the widths or of the heights: the largest, and what makes exponentials over it sizes above the floor.
struct Axis { first: u32, largest: f32, scale: f32 }

fn axis(first: u32) -> Axis {
    var largest = arena[first];
    var total = 1.0;
    for (var k = 1u; k < p.bins; k++) {
        let logit = arena[first + k * p.stride];
        let ratio = headtail_exp(-abs(logit - largest));
        total = select(total + ratio, fma(total, ratio, 1.0), logit > largest);
        largest = max(largest, logit);
    }
    return Axis(first, largest, (1.0 - f32(p.bins) * HEADTAIL_LEAST_BIN) / total);
}

fn free_size(on: Axis, k: u32) -> f32 {
    return on.scale * headtail_exp(arena[on.first + k * p.stride] - on.largest);
}

// A point's bin: its place, its sizes, the logits of the slopes at its knots, and where in it the point is.
struct Bin { index: u32, next: u32, left: f32, bottom: f32, width: f32, height: f32, logits: vec2<f32>, t: f32 }

fn bin_of(point: f32, column: u32, across: Axis, up: Axis) -> Bin {
    var x = clamp(point, 0.0, 1.0);
    if (p.is_circle == 1u) {
        let turn = arena[p.logits + 3u * p.bins * p.stride + column];
        x = headtail_wrap(headtail_wrap(point) + (turn - round(turn)));
    }
    var bin: Bin;
    var left = 0.0;
    var bottom = 0.0;
    for (var k = 0u; k < p.bins; k++) {
        if (!(x >= left) && k > 0u) { break; }
        bin.index = k;
        bin.left = left;
        bin.bottom = bottom;
        bin.width = HEADTAIL_LEAST_BIN + free_size(across, k);
        bin.height = HEADTAIL_LEAST_BIN + free_size(up, k);
        left += bin.width;
        bottom += bin.height;
    }
    bin.t = clamp((x - bin.left) / bin.width, 0.0, 1.0);
    return with_slopes(bin, column);
}

fn with_slopes(given: Bin, column: u32) -> Bin {
    var bin = given;
    let slopes = p.logits + 2u * p.bins * p.stride + column;
    bin.next = select(bin.index + 1u, 0u, p.is_circle == 1u && bin.index + 1u == p.bins);
    bin.logits = vec2<f32>(arena[slopes + bin.index * p.stride], arena[slopes + bin.next * p.stride]);
    return bin;
}

// What the forward pass found is kept for the backward pass, in eight rows after the logits.
fn kept(row: u32, column: u32) -> u32 {
    return p.logits + (3u * p.bins + 1u + row) * p.stride + column;
}

fn keep(column: u32, across: Axis, up: Axis, bin: Bin) {
    arena[kept(0u, column)] = across.largest;
    arena[kept(1u, column)] = across.scale;
    arena[kept(2u, column)] = up.largest;
    arena[kept(3u, column)] = up.scale;
    arena[kept(4u, column)] = f32(bin.index);
    arena[kept(5u, column)] = bin.left;
    arena[kept(6u, column)] = bin.bottom;
    arena[kept(7u, column)] = bin.t;
}

fn kept_bin(column: u32, across: Axis, up: Axis) -> Bin {
    var bin: Bin;
    bin.index = u32(arena[kept(4u, column)]);
    bin.left = arena[kept(5u, column)];
    bin.bottom = arena[kept(6u, column)];
    bin.t = arena[kept(7u, column)];
    bin.width = HEADTAIL_LEAST_BIN + free_size(across, bin.index);
    bin.height = HEADTAIL_LEAST_BIN + free_size(up, bin.index);
    return with_slopes(bin, column);
}

fn point_of(column: u32) -> f32 {
    if (p.is_of_chain == 1u) { return arena[p.point + column]; }
    return batch[p.point + 2u * column];
}

@compute @workgroup_size(64)
fn spline_forward(@builtin(global_invocation_id) id: vec3<u32>) {
    let column = id.x;
    if (column >= p.count) { return; }
    let across = axis(p.logits + column);
    let up = axis(p.logits + p.bins * p.stride + column);
    let bin = bin_of(point_of(column), column, across, up);
    keep(column, across, up, bin);
    let slopes = vec2<f32>(headtail_slope(bin.logits.x), headtail_slope(bin.logits.y));
    let found = headtail_quadratic(bin.t, bin.height / bin.width, slopes);
    arena[p.log_slope + column] = headtail_ln(found.y);
    if (p.has_value == 1u) { arena[p.value + column] = clamp(bin.bottom + bin.height * found.x, 0.0, 1.0); }
}

// Derivatives by the slopes' logits at the knots, by the bin's sizes, and by its left knot on both axes.
struct Derivatives { slopes: vec2<f32>, width: f32, height: f32, left: f32, bottom: f32 }

fn derivatives_of(bin: Bin, d_log_slope: f32, d_of_value: f32) -> Derivatives {
    let d0 = headtail_slope(bin.logits.x);
    let d1 = headtail_slope(bin.logits.y);
    let by_logits = 1.0 / (vec2<f32>(1.0) + exp(-clamp(bin.logits + HEADTAIL_SLOPE_OFFSET, vec2<f32>(-87.0), vec2<f32>(87.0))));
    let by_width = 1.0 / bin.width;
    let t = bin.t;
    let o = 1.0 - t;
    let s = bin.height * by_width;
    let to = t * o;
    let middle = 1.0 - 2.0 * to;
    let n = d1 * t * t + 2.0 * s * to + d0 * o * o;
    let by_d = 1.0 / (s * middle + (d0 + d1) * to);
    let by_n = 1.0 / n;
    let ratio = s * by_d;
    let value = (s * t + d0 * o) * t * by_d;

    var secant = 2.0 / s + 2.0 * to * by_n - 2.0 * middle * by_d;
    var position = 2.0 * (d1 * t + s * (1.0 - 2.0 * t) - d0 * o) * by_n - 2.0 * (d0 + d1 - 2.0 * s) * (1.0 - 2.0 * t) * by_d;
    var d: Derivatives;
    d.slopes = d_log_slope * by_logits * (vec2<f32>(o * o, t * t) * by_n - 2.0 * to * by_d);
    d.width = -d_log_slope * (secant * s + position * t) * by_width;
    d.height = d_log_slope * secant * by_width;
    d.left = -d_log_slope * position * by_width;

    secant = (t * t - value * middle) * by_d;
    position = ratio * n * by_d;
    d.slopes += d_of_value * bin.height * by_logits * to * by_d * vec2<f32>(1.0 - value, -value);
    d.width -= d_of_value * s * (secant * s + position * t);
    d.height += d_of_value * (s * secant + value);
    d.left -= d_of_value * s * position;
    d.bottom = d_of_value;
    return d;
}

// Through floor and softmax; the logits are replaced. `size` and `start` are those of the point's bin, above the floor.
fn softmax_backward(on: Axis, index: u32, size: f32, start: f32, d_size: f32, d_start: f32) {
    let mean = (size * d_size + start * d_start) / (1.0 - f32(p.bins) * HEADTAIL_LEAST_BIN);
    for (var k = 0u; k < p.bins; k++) {
        var own = select(0.0, d_start, k < index);
        if (k == index) { own = d_size; }
        // The device's own exponential is precise enough here.
        let free = on.scale * exp(arena[on.first + k * p.stride] - on.largest);
        arena[on.first + k * p.stride] = free * (own - mean);
    }
}

// Derivatives take the place of the logits.
@compute @workgroup_size(64)
fn spline_backward(@builtin(global_invocation_id) id: vec3<u32>) {
    let column = id.x;
    if (column >= p.count) {
        for (var k = 0u; k <= 3u * p.bins; k++) { arena[p.logits + k * p.stride + column] = 0.0; }
        return;
    }
    let across = Axis(p.logits + column, arena[kept(0u, column)], arena[kept(1u, column)]);
    let up = Axis(p.logits + p.bins * p.stride + column, arena[kept(2u, column)], arena[kept(3u, column)]);
    let bin = kept_bin(column, across, up);
    var d_of_value = 0.0;
    if (p.has_value == 1u) { d_of_value = arena[p.d_value + column]; }
    let d = derivatives_of(bin, arena[p.d_log_slope + column], d_of_value);
    if (p.is_of_chain == 1u) { arena[p.d_value + column] = -d.left; }
    let floors = f32(bin.index) * HEADTAIL_LEAST_BIN;
    softmax_backward(across, bin.index, bin.width - HEADTAIL_LEAST_BIN, bin.left - floors, d.width, d.left);
    softmax_backward(up, bin.index, bin.height - HEADTAIL_LEAST_BIN, bin.bottom - floors, d.height, d.bottom);
    let slopes = p.logits + 2u * p.bins * p.stride + column;
    for (var k = 0u; k <= p.bins; k++) {
        var own = select(0.0, d.slopes.x, k == bin.index);
        if (k == bin.next) { own += d.slopes.y; }
        // The turn moves the point, as if the knot moved the other way.
        if (p.is_circle == 1u && k == p.bins) { own = -d.left; }
        arena[slopes + k * p.stride] = own;
    }
}
