// The splines whose logits a network left in the list of numbers. The logits are overwritten.

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
