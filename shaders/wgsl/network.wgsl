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

// One layer with its first `inputs` inputs, from the place `start` to the place `end`.
fn headtail_layer(layer: u32, inputs: u32, start: u32, end: u32, is_leaky: bool) {
    let at = HEADTAIL_HEAD_LAYERS + 3u * layer;
    let rows = 1u + headtail_integers[at];
    let outputs = headtail_integers[at + 1u];
    var biases = (HEADTAIL_HEAD_WEIGHTS + headtail_integers[at + 2u]) >> 4u;
    let slope = select(1.0, headtail_float(HEADTAIL_HEAD_SLOPE), is_leaky);
    for (var output = 0u; output < outputs; output += 16u) {
        var a = headtail_weights(biases, 0u);
        var b = headtail_weights(biases, 1u);
        var c = headtail_weights(biases, 2u);
        var d = headtail_weights(biases, 3u);
        for (var input = 0u; input < inputs; input++) {
            let row = biases + 1u + input;
            let unit = vec4<f32>(headtail_units[start + input]);
            a = fma(headtail_weights(row, 0u), unit, a);
            b = fma(headtail_weights(row, 1u), unit, b);
            c = fma(headtail_weights(row, 2u), unit, c);
            d = fma(headtail_weights(row, 3u), unit, d);
        }
        headtail_write_units(end + output, a, slope);
        headtail_write_units(end + output + 4u, b, slope);
        headtail_write_units(end + output + 8u, c, slope);
        headtail_write_units(end + output + 12u, d, slope);
        biases += rows;
    }
}

// A layer whose sums of biases and of what is seen are at the place `prepared`, with the features after these.
fn headtail_layer_of_features(layer: u32, prepared: u32, end: u32, is_leaky: bool) {
    let at = HEADTAIL_HEAD_LAYERS + 3u * layer;
    let inputs = headtail_integers[at];
    let outputs = headtail_integers[at + 1u];
    let weights = ((HEADTAIL_HEAD_WEIGHTS + headtail_integers[at + 2u]) >> 4u) + 1u;
    let slope = select(1.0, headtail_float(HEADTAIL_HEAD_SLOPE), is_leaky);
    for (var output = 0u; output < outputs; output += 4u) {
        let row = weights + (output >> 4u) * (1u + inputs);
        var sum = headtail_units_at(prepared + output);
        for (var input = HEADTAIL_HEAD_SEEN; input < inputs; input++) {
            sum = fma(headtail_weights(row + input, (output >> 2u) & 3u), vec4<f32>(headtail_units[input]), sum);
        }
        headtail_write_units(end + output, sum, slope);
    }
}

fn headtail_layer_inputs(layer: u32) -> u32 {
    return headtail_integers[HEADTAIL_HEAD_LAYERS + 3u * layer];
}

// Layers from the place `start` to `end`; the last one has no activation.
fn headtail_layers(first: u32, count: u32, input: u32, end: u32) {
    var start = input;
    for (var k = 0u; k < count; k++) {
        let is_last = k + 1u == count;
        let next = select(HEADTAIL_HEAD_HIDDEN + (k & 1u) * HEADTAIL_HEAD_WIDEST, end, is_last);
        headtail_layer(first + k, headtail_layer_inputs(first + k), start, next, !is_last);
        start = next;
    }
}

// Layers from prepared sums to the logits.
fn headtail_network(first: u32, count: u32, prepared: u32) {
    let hidden = HEADTAIL_HEAD_HIDDEN + HEADTAIL_HEAD_WIDEST;
    headtail_layer_of_features(first, prepared, select(hidden, HEADTAIL_HEAD_LOGITS, count == 1u), count > 1u);
    headtail_layers(first + 1u, count - 1u, hidden, HEADTAIL_HEAD_LOGITS);
}
