// Small networks: affine layers with leaky ReLU between them. Numbers between layers are in one list, each layer reads from one place of it and
// writes to another, in whole tiles of sixteen outputs, for which an input is read once.

var<private> headtail_units: array<f32, HEADTAIL_HEAD_UNITS>;

fn headtail_units_at(at: u32) -> vec4<f32> {
    return vec4<f32>(headtail_units[at], headtail_units[at + 1u], headtail_units[at + 2u], headtail_units[at + 3u]);
}

fn headtail_write_units(at: u32, sum: vec4<f32>, slope: f32) {
    let units = max(sum, slope * sum);
    headtail_units[at] = units.x;
    headtail_units[at + 1u] = units.y;
    headtail_units[at + 2u] = units.z;
    headtail_units[at + 3u] = units.w;
}

// Four of the sixteen numbers of a tile's row. With `|`, compilers know that the sum does not wrap, and read all four from one address.
fn headtail_weights(row: u32, k: u32) -> vec4<f32> {
    return headtail_floats[(row << 2u) | k];
}

// One layer, from the place `start` to the place `end`: the biases with the first `inputs` inputs, or, unless `prepared` is 0, the sums at that place
// with the inputs after the condition, which is in them.
fn headtail_layer(layer: u32, prepared: u32, inputs: u32, start: u32, end: u32, is_leaky: bool) {
    let at = HEADTAIL_HEAD_LAYERS + 3u * layer;
    let rows = 1u + headtail_integers[at];
    let outputs = headtail_integers[at + 1u];
    var biases = (HEADTAIL_HEAD_WEIGHTS + headtail_integers[at + 2u]) >> 4u;
    let slope = select(1.0, headtail_float(HEADTAIL_HEAD_SLOPE), is_leaky);
    let first = select(HEADTAIL_HEAD_SEEN, 0u, prepared == 0u);
    for (var output = 0u; output < outputs; output += 16u) {
        var a: vec4<f32>;
        var b: vec4<f32>;
        var c: vec4<f32>;
        var d: vec4<f32>;
        if (prepared == 0u) {
            a = headtail_weights(biases, 0u);
            b = headtail_weights(biases, 1u);
            c = headtail_weights(biases, 2u);
            d = headtail_weights(biases, 3u);
        } else {
            a = headtail_units_at(prepared + output);
            b = headtail_units_at(prepared + output + 4u);
            c = headtail_units_at(prepared + output + 8u);
            d = headtail_units_at(prepared + output + 12u);
        }
        var row = biases + 1u + first;
        for (var input = first; input < inputs; input++) {
            let unit = vec4<f32>(headtail_units[start + input]);
            a = fma(headtail_weights(row, 0u), unit, a);
            b = fma(headtail_weights(row, 1u), unit, b);
            c = fma(headtail_weights(row, 2u), unit, c);
            d = fma(headtail_weights(row, 3u), unit, d);
            row += 1u;
        }
        headtail_write_units(end + output, a, slope);
        headtail_write_units(end + output + 4u, b, slope);
        headtail_write_units(end + output + 8u, c, slope);
        headtail_write_units(end + output + 12u, d, slope);
        biases += rows;
    }
}

fn headtail_layer_inputs(layer: u32) -> u32 {
    return headtail_integers[HEADTAIL_HEAD_LAYERS + 3u * layer];
}

// Layers from what is seen to `end`, the first one as `prepared` says; the last one has no activation.
fn headtail_network(first: u32, count: u32, prepared: u32, end: u32) {
    var start = 0u;
    var sums = prepared;
    for (var k = 0u; k < count; k++) {
        let is_last = k + 1u == count;
        let next = select(HEADTAIL_HEAD_HIDDEN + (k & 1u) * HEADTAIL_HEAD_WIDEST, end, is_last);
        headtail_layer(first + k, sums, headtail_layer_inputs(first + k), start, next, !is_last);
        start = next;
        sums = 0u;
    }
}
