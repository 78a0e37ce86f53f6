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
