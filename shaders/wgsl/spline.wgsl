// Monotone rational-quadratic splines on [0, 1] and on the circle (Durkan et al. 2019; Rezende et al. 2020), of the logits that a network left.

const HEADTAIL_LEAST_BIN: f32 = 1e-4;
const HEADTAIL_LEAST_SLOPE: f32 = 1e-4;
const HEADTAIL_SLOPE_OFFSET: f32 = 0.54116665;

// e^x for x <= 88, and ln x for normal positive x, to 2e-7: devices promise less of their own. After Cephes.
fn headtail_exp(given: f32) -> f32 {
    let x = max(given, -87.0);
    let n = round(x * 1.442695);
    let r = x - n * 0.6933594 - n * -2.1219444e-4;
    let p = ((((1.9875691e-4 * r + 1.3981999e-3) * r + 8.333452e-3) * r + 4.1665796e-2) * r + 1.6666665e-1) * r + 0.5;
    return (p * r * r + r + 1.0) * bitcast<f32>(u32(i32(n) + 127) << 23u);
}

fn headtail_ln(x: f32) -> f32 {
    let bits = bitcast<u32>(x);
    let exponent = i32(bits - 0x3f3504f3u) >> 23u;
    let m = bitcast<f32>(bits - (u32(exponent) << 23u)) - 1.0;
    let e = f32(exponent);
    let upper = (((7.0376836e-2 * m - 1.151461e-1) * m + 1.1676999e-1) * m - 1.2420141e-1) * m + 1.4249323e-1;
    let p = (((upper * m - 1.6668058e-1) * m + 2.0000715e-1) * m - 2.4999994e-1) * m + 3.333333e-1;
    return m + (m * m * m * p + e * -2.1219444e-4 - 0.5 * m * m) + e * 0.6933594;
}

fn headtail_softplus(x: f32) -> f32 {
    return max(x, 0.0) + headtail_ln(1.0 + headtail_exp(-abs(x)));
}

// Onto [0, 1): x - floor(x) rounds to 1 for a tiny negative x.
fn headtail_wrap(x: f32) -> f32 {
    let fraction = x - floor(x);
    return select(fraction, 0.0, fraction >= 1.0);
}

// The logits of widths or heights become exponentials over the largest one's; gives what makes them sizes above the floor.
fn headtail_softmax(start: u32, bins: u32) -> f32 {
    var largest = headtail_units[start];
    for (var k = 1u; k < bins; k++) { largest = max(largest, headtail_units[start + k]); }
    var total = 0.0;
    for (var k = 0u; k < bins; k++) {
        let e = headtail_exp(headtail_units[start + k] - largest);
        headtail_units[start + k] = e;
        total += e;
    }
    return (1.0 - f32(bins) * HEADTAIL_LEAST_BIN) / total;
}

struct HeadtailBin { left: f32, bottom: f32, width: f32, height: f32, slopes: vec2<f32> }

// The last bin whose start along the first axis a point has reached. Axes are (place of the exponentials, scale).
fn headtail_bin(at: f32, bins: u32, starts: vec2<u32>, scales: vec2<f32>, is_circle: bool) -> HeadtailBin {
    var bin: HeadtailBin;
    var left = 0.0;
    var bottom = 0.0;
    var found = 0u;
    for (var k = 0u; k < bins; k++) {
        if (!(at >= left)) { break; }
        bin.left = left;
        bin.bottom = bottom;
        bin.width = HEADTAIL_LEAST_BIN + headtail_units[starts.x + k] * scales.x;
        bin.height = HEADTAIL_LEAST_BIN + headtail_units[starts.y + k] * scales.y;
        left += bin.width;
        bottom += bin.height;
        found = k;
    }
    let slopes = HEADTAIL_HEAD_LOGITS + 2u * bins;
    let next = select(found + 1u, 0u, is_circle && found + 1u == bins);
    bin.slopes = vec2<f32>(headtail_slope(headtail_units[slopes + found]), headtail_slope(headtail_units[slopes + next]));
    return bin;
}

fn headtail_slope(logit: f32) -> f32 {
    return HEADTAIL_LEAST_SLOPE + headtail_softplus(logit + HEADTAIL_SLOPE_OFFSET);
}

// The value in a bin at t, both in [0, 1], and the slope there (Durkan et al. 2019, eq. 4 and 5); s is the secant.
fn headtail_quadratic(t: f32, s: f32, d: vec2<f32>) -> vec2<f32> {
    let o = 1.0 - t;
    let n = d.y * t * t + 2.0 * s * t * o + d.x * o * o;
    let by_d = 1.0 / (s * (1.0 - 2.0 * t * o) + (d.x + d.y) * t * o);
    let ratio = s * by_d;
    return vec2<f32>((s * t + d.x * o) * t * by_d, ratio * ratio * n);
}

// The position at which a bin has a value: the root in the form in which nothing cancels.
fn headtail_root(value: f32, s: f32, d: vec2<f32>) -> f32 {
    let o = 1.0 - value;
    let b = d.x - (d.x + d.y - 2.0 * s) * value;
    let ends = d.x * o - d.y * value;
    let root = sqrt(ends * ends + 4.0 * s * s * value * o);
    let over = select(root - b, 2.0 * s * value, b >= 0.0);
    let under = select(2.0 * (s - b), b + root, b >= 0.0);
    return clamp(over / under, 0.0, 1.0);
}

// By how much the circle is turned, in turns.
fn headtail_turn(bins: u32) -> f32 {
    let logit = headtail_units[HEADTAIL_HEAD_LOGITS + 3u * bins];
    return logit - round(logit);
}

// The density direction, y to (z, dz/dy). The logits are overwritten.
fn headtail_spline_inverse(y: f32, bins: u32, is_circle: bool) -> vec2<f32> {
    var x = clamp(y, 0.0, 1.0);
    if (is_circle) { x = headtail_wrap(headtail_wrap(y) + headtail_turn(bins)); }
    let starts = vec2<u32>(HEADTAIL_HEAD_LOGITS, HEADTAIL_HEAD_LOGITS + bins);
    let bin = headtail_bin(x, bins, starts, vec2<f32>(headtail_softmax(starts.x, bins), headtail_softmax(starts.y, bins)), is_circle);
    let t = clamp((x - bin.left) / bin.width, 0.0, 1.0);
    let value = headtail_quadratic(t, bin.height / bin.width, bin.slopes);
    return vec2<f32>(clamp(bin.bottom + bin.height * value.x, 0.0, 1.0), value.y);
}

// The sampling direction, z to (y, dz/dy). The logits are overwritten.
fn headtail_spline_forward(given: f32, bins: u32, is_circle: bool) -> vec2<f32> {
    let z = clamp(given, 0.0, 1.0);
    let starts = vec2<u32>(HEADTAIL_HEAD_LOGITS, HEADTAIL_HEAD_LOGITS + bins);
    let scales = vec2<f32>(headtail_softmax(starts.x, bins), headtail_softmax(starts.y, bins));
    // With the axes exchanged: the bin's left end is its bottom.
    let bin = headtail_bin(z, bins, starts.yx, scales.yx, is_circle);
    let s = bin.width / bin.height;
    let t = headtail_root(clamp((z - bin.left) / bin.width, 0.0, 1.0), s, bin.slopes);
    let x = bin.bottom + bin.height * t;
    let slope = headtail_quadratic(t, s, bin.slopes).y;
    if (is_circle) { return vec2<f32>(headtail_wrap(min(x, 1.0) - headtail_turn(bins)), slope); }
    return vec2<f32>(min(x, HEADTAIL_BELOW_ONE), slope);
}
