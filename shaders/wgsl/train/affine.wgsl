// Matrix products over columns: a layer of a network, forward and backward. A workgroup computes 8 ROWS rows of 128 columns, a thread 8 of 8.

struct Params {
    // Places of matrices in the arena, and their strides from row to row, in fours. `factor` is packed: row k holds factors of input k.
    factor: u32,
    factor_stride: u32,
    input: u32,
    output: u32,
    stride: u32,
    outputs: u32,
    inputs: u32,
    // Place in the weights.
    bias: u32,
    form: u32,
    // Place of another matrix, like that of the output.
    other: u32,
    slope: f32,
}

// What becomes of the product: a bias is added, and leaky ReLU applied, whose argument is kept in the other matrix, or first added to what is
// there; the derivative by an activation becomes that by its argument, in its place, and the other matrix is added; it is written, or added to
// what is there.
const WITH_BIAS: u32 = 0u;
const ACTIVATED: u32 = 1u;
const KEPT: u32 = 2u;
const RESIDUAL: u32 = 3u;
const THROUGH_ACTIVATION: u32 = 4u;
const THROUGH_ACTIVATION_ADDED: u32 = 5u;
const PLAIN: u32 = 6u;
const ADDED: u32 = 7u;

@group(0) @binding(0) var<storage, read> weights: array<f32>;
@group(0) @binding(2) var<storage, read_write> arena: array<vec4<f32>>;
@group(0) @binding(4) var<uniform> p: Params;

const DEPTH: u32 = 16u;
var<workgroup> factors: array<vec4<f32>, DEPTH * 2u * ROWS>;
var<workgroup> columns: array<vec4<f32>, DEPTH * 32u>;

fn finish(row: u32, column: u32, product: vec4<f32>) {
    if (row >= p.outputs) { return; }
    let place = p.output + row * p.stride + column;
    let other = p.other + row * p.stride + column;
    var value = product;
    if (p.form <= RESIDUAL) {
        value += vec4<f32>(weights[p.bias + row]);
        if (p.form == RESIDUAL) { value += arena[other]; }
        if (p.form >= KEPT) { arena[other] = value; }
        if (p.form != WITH_BIAS) { value = max(value, p.slope * value); }
    } else if (p.form <= THROUGH_ACTIVATION_ADDED) {
        value *= select(vec4<f32>(p.slope), vec4<f32>(1.0), arena[place] > vec4<f32>(0.0));
        if (p.form == THROUGH_ACTIVATION_ADDED) { value += arena[other]; }
    } else if (p.form == ADDED) {
        value += arena[place];
    }
    arena[place] = value;
}

@compute @workgroup_size(16, ROWS)
fn affine(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
    @builtin(local_invocation_index) index: u32,
) {
    let first_column = group.x * 32u;
    let first_row = group.y * 2u * ROWS;
    var a0 = vec4<f32>(); var a1 = vec4<f32>(); var a2 = vec4<f32>(); var a3 = vec4<f32>();
    var a4 = vec4<f32>(); var a5 = vec4<f32>(); var a6 = vec4<f32>(); var a7 = vec4<f32>();
    var b0 = vec4<f32>(); var b1 = vec4<f32>(); var b2 = vec4<f32>(); var b3 = vec4<f32>();
    var b4 = vec4<f32>(); var b5 = vec4<f32>(); var b6 = vec4<f32>(); var b7 = vec4<f32>();
    for (var first = 0u; first < p.inputs; first += DEPTH) {
        for (var i = index; i < DEPTH * 32u; i += 16u * ROWS) {
            let input = first + i / 32u;
            var value = vec4<f32>();
            if (input < p.inputs) { value = arena[p.input + input * p.stride + first_column + i % 32u]; }
            columns[i] = value;
        }
        for (var i = index; i < DEPTH * 2u * ROWS; i += 16u * ROWS) {
            let input = first + i / (2u * ROWS);
            var value = vec4<f32>();
            if (input < p.inputs) { value = arena[p.factor + input * p.factor_stride + first_row + i % (2u * ROWS)]; }
            factors[i] = value;
        }
        workgroupBarrier();
        for (var k = 0u; k < DEPTH; k++) {
            let x = columns[k * 32u + local.x];
            let y = columns[k * 32u + 16u + local.x];
            let f = factors[k * 2u * ROWS + 2u * local.y];
            let g = factors[k * 2u * ROWS + 2u * local.y + 1u];
            a0 = fma(vec4<f32>(f.x), x, a0); b0 = fma(vec4<f32>(f.x), y, b0);
            a1 = fma(vec4<f32>(f.y), x, a1); b1 = fma(vec4<f32>(f.y), y, b1);
            a2 = fma(vec4<f32>(f.z), x, a2); b2 = fma(vec4<f32>(f.z), y, b2);
            a3 = fma(vec4<f32>(f.w), x, a3); b3 = fma(vec4<f32>(f.w), y, b3);
            a4 = fma(vec4<f32>(g.x), x, a4); b4 = fma(vec4<f32>(g.x), y, b4);
            a5 = fma(vec4<f32>(g.y), x, a5); b5 = fma(vec4<f32>(g.y), y, b5);
            a6 = fma(vec4<f32>(g.z), x, a6); b6 = fma(vec4<f32>(g.z), y, b6);
            a7 = fma(vec4<f32>(g.w), x, a7); b7 = fma(vec4<f32>(g.w), y, b7);
        }
        workgroupBarrier();
    }
    let row = 4u * first_row + 8u * local.y;
    var left = array<vec4<f32>, 8>(a0, a1, a2, a3, a4, a5, a6, a7);
    var right = array<vec4<f32>, 8>(b0, b1, b2, b3, b4, b5, b6, b7);
    for (var k = 0u; k < 8u; k++) {
        finish(row + k, first_column + local.x, left[k]);
        finish(row + k, first_column + local.x + 16u, right[k]);
    }
}
