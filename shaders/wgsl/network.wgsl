// Small networks: affine layers with leaky ReLU between them. Numbers between layers are in one list, each layer reads from one place of it and
// writes to another, in whole blocks of four.

var<private> headtail_units: array<f32, HEADTAIL_HEAD_UNITS>;

// One layer, from the place `start` to the place `end`.
fn headtail_layer(layer: u32, start: u32, end: u32, is_leaky: bool) {
    let row = HEADTAIL_HEAD_LAYERS + 4u * layer;
    let inputs = headtail_integers[row];
    let blocks = (headtail_integers[row + 1u] + 3u) / 4u;
    let weights = HEADTAIL_HEAD_WEIGHTS + headtail_integers[row + 2u];
    let biases = HEADTAIL_HEAD_WEIGHTS + headtail_integers[row + 3u];
    let slope = headtail_floats[HEADTAIL_HEAD_SLOPE];
    for (var block = 0u; block < blocks; block++) {
        var sum = headtail_four(biases, block);
        for (var input = 0u; input < inputs; input++) {
            sum = fma(headtail_four(weights, block * inputs + input), vec4<f32>(headtail_units[start + input]), sum);
        }
        if (is_leaky) { sum = max(sum, slope * sum); }
        let out = end + 4u * block;
        headtail_units[out] = sum.x;
        headtail_units[out + 1u] = sum.y;
        headtail_units[out + 2u] = sum.z;
        headtail_units[out + 3u] = sum.w;
    }
}

// Layers from what is seen to `end`; the last one has no activation.
fn headtail_network(first: u32, count: u32, end: u32) {
    var start = 0u;
    for (var k = 0u; k + 1u < count; k++) {
        let next = HEADTAIL_HEAD_HIDDEN + (k & 1u) * HEADTAIL_HEAD_WIDEST;
        headtail_layer(first + k, start, next, true);
        start = next;
    }
    headtail_layer(first + count - 1u, start, end, false);
}
