// The gradient of a layer's weights, G x^T, and of its biases, summed over a slice of the columns: slices are added up later, in order, so that
// the sum is the same in every run. A workgroup computes 8 ROWS rows of 64 inputs, a thread 8 of 8.

struct Params {
    // Places of matrices in the arena, and their stride from row to row, in fours.
    derivative: u32,
    input: u32,
    stride: u32,
    outputs: u32,
    inputs: u32,
    // Columns and those of a slice, in fours.
    columns: u32,
    slice: u32,
    // Places of the layer in a slice's gradient: of the weight, from row to row, and of the bias.
    weight: u32,
    row: u32,
    bias: u32,
    length: u32,
    // 1 where the gradient is added to that of earlier columns.
    is_added: u32,
}

@group(0) @binding(2) var<storage, read_write> arena: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> partials: array<f32>;
@group(0) @binding(4) var<uniform> p: Params;

// A row more than is needed, so that threads write to different banks.
const WIDE: u32 = 2u * ROWS + 1u;
var<workgroup> derivatives: array<vec4<f32>, 16u * WIDE>;
var<workgroup> inputs: array<vec4<f32>, 16u * 17u>;

// Four columns of a row, or zeros beyond the last row.
fn four(start: u32, row: u32, rows: u32, column: u32) -> vec4<f32> {
    if (row >= rows) { return vec4<f32>(); }
    return arena[start + row * p.stride + column];
}

fn store(place: u32, value: f32) {
    if (p.is_added == 1u) { partials[place] += value; } else { partials[place] = value; }
}

fn store_row(slice: u32, output: u32, input: u32, left: vec4<f32>, right: vec4<f32>) {
    if (output >= p.outputs) { return; }
    let start = slice + p.weight + output * p.row;
    for (var k = 0u; k < 4u; k++) {
        if (input + k < p.inputs) { store(start + input + k, left[k]); }
        if (input + 32u + k < p.inputs) { store(start + input + 32u + k, right[k]); }
    }
}

fn add_step(tile: ptr<function, Tile>, k: u32, local: vec3<u32>) {
    let row = k * WIDE + 2u * local.y;
    add_products(tile, derivatives[row], derivatives[row + 1u], inputs[k * 17u + local.x], inputs[k * 17u + 8u + local.x]);
}

@compute @workgroup_size(8, ROWS)
fn weight_gradient(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
    @builtin(local_invocation_index) index: u32,
) {
    let first_input = group.x * 64u;
    let first_output = group.y * 8u * ROWS;
    var tile = Tile();
    // Of the output with the number that the thread has along inputs.
    var bias = 0.0;
    let end = min((group.z + 1u) * p.slice, p.columns);
    for (var column = group.z * p.slice; column < end; column += 4u) {
        // Blocks of four rows and four columns are transposed, of the derivatives one per thread.
        {
            let row = first_output + 4u * (index / 4u);
            let at = column + index % 4u;
            let r0 = four(p.derivative, row, p.outputs, at);
            let r1 = four(p.derivative, row + 1u, p.outputs, at);
            let r2 = four(p.derivative, row + 2u, p.outputs, at);
            let r3 = four(p.derivative, row + 3u, p.outputs, at);
            let place = 4u * (index % 4u) * WIDE + index / 4u;
            derivatives[place] = vec4<f32>(r0.x, r1.x, r2.x, r3.x);
            derivatives[place + WIDE] = vec4<f32>(r0.y, r1.y, r2.y, r3.y);
            derivatives[place + 2u * WIDE] = vec4<f32>(r0.z, r1.z, r2.z, r3.z);
            derivatives[place + 3u * WIDE] = vec4<f32>(r0.w, r1.w, r2.w, r3.w);
        }
        for (var i = index; i < 64u; i += 8u * ROWS) {
            let row = first_input + 4u * (i / 4u);
            let at = column + i % 4u;
            let r0 = four(p.input, row, p.inputs, at);
            let r1 = four(p.input, row + 1u, p.inputs, at);
            let r2 = four(p.input, row + 2u, p.inputs, at);
            let r3 = four(p.input, row + 3u, p.inputs, at);
            let place = 68u * (i % 4u) + i / 4u;
            inputs[place] = vec4<f32>(r0.x, r1.x, r2.x, r3.x);
            inputs[place + 17u] = vec4<f32>(r0.y, r1.y, r2.y, r3.y);
            inputs[place + 34u] = vec4<f32>(r0.z, r1.z, r2.z, r3.z);
            inputs[place + 51u] = vec4<f32>(r0.w, r1.w, r2.w, r3.w);
        }
        workgroupBarrier();
        add_sixteen_steps(&tile, local);
        if (first_input == 0u) {
            for (var k = 0u; k < 16u; k++) { bias += derivatives[k * WIDE + 2u * local.y + local.x / 4u][local.x % 4u]; }
        }
        workgroupBarrier();
    }
    let slice = group.z * p.length;
    let output = first_output + 8u * local.y;
    let input = first_input + 4u * local.x;
    // A copy: an array with places that are not constants is in memory.
    var sums = tile;
    for (var k = 0u; k < 8u; k++) { store_row(slice, output + k, input, sums[k], sums[8u + k]); }
    if (first_input == 0u && output + local.x < p.outputs) { store(slice + p.bias + output + local.x, bias); }
}
