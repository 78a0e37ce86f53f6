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
    // Place of another matrix, like that of the output.
    other: u32,
    slope: f32,
}

// What becomes of the product, FORM: a bias is added, and leaky ReLU applied, whose argument is kept in the other matrix, or first added to what is
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

fn finished(row: u32, column: u32, product: vec4<f32>, bias: f32) -> vec4<f32> {
    let place = p.output + row * p.stride + column;
    let other = p.other + row * p.stride + column;
    var value = product;
    if (FORM <= RESIDUAL) {
        value += vec4<f32>(bias);
        if (FORM == RESIDUAL) { value += arena[other]; }
        if (FORM >= KEPT) { arena[other] = value; }
        if (FORM != WITH_BIAS) { value = max(value, p.slope * value); }
    } else if (FORM <= THROUGH_ACTIVATION_ADDED) {
        value *= select(vec4<f32>(p.slope), vec4<f32>(1.0), arena[place] > vec4<f32>(0.0));
        if (FORM == THROUGH_ACTIVATION_ADDED) { value += arena[other]; }
    } else if (FORM == ADDED) {
        value += arena[place];
    }
    return value;
}

fn finish(row: u32, column: u32, left: vec4<f32>, right: vec4<f32>) {
    if (row >= p.outputs) { return; }
    var bias = 0.0;
    if (FORM <= RESIDUAL) { bias = weights[p.bias + row]; }
    let place = p.output + row * p.stride + column;
    arena[place] = finished(row, column, left, bias);
    arena[place + 16u] = finished(row, column + 16u, right, bias);
}

fn add_step(tile: ptr<function, Tile>, k: u32, local: vec3<u32>) {
    let row = k * 2u * ROWS + 2u * local.y;
    add_products(tile, factors[row], factors[row + 1u], columns[k * 32u + local.x], columns[k * 32u + 16u + local.x]);
}

@compute @workgroup_size(16, ROWS)
fn affine(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
    @builtin(local_invocation_index) index: u32,
) {
    let first_column = group.x * 32u;
    let first_row = group.y * 2u * ROWS;
    var tile = Tile();
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
        add_sixteen_steps(&tile, local);
        workgroupBarrier();
    }
    let row = 4u * first_row + 8u * local.y;
    let column = first_column + local.x;
    // A copy: an array with places that are not constants is in memory.
    var sums = tile;
    for (var k = 0u; k < 8u; k++) { finish(row + k, column, sums[k], sums[8u + k]); }
}
