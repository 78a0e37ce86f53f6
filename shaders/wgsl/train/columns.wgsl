// Small steps between layers, one thread per number or per column.

struct Params {
    // Places of matrices in the arena, and their strides from row to row.
    source: u32,
    source_stride: u32,
    features: u32,
    factors: u32,
    factor_stride: u32,
    output: u32,
    stride: u32,
    rows: u32,
    feature_count: u32,
    // Columns of one condition, the first condition, and the number of conditions or columns.
    samples: u32,
    first: u32,
    count: u32,
    // Place of the first point in the batch.
    point: u32,
    slope: f32,
}

@group(0) @binding(0) var<storage, read> weights: array<f32>;
@group(0) @binding(1) var<storage, read> batch: array<f32>;
@group(0) @binding(2) var<storage, read_write> arena: array<f32>;
@group(0) @binding(3) var<storage, read_write> partials: array<f32>;
@group(0) @binding(4) var<uniform> p: Params;

const TURN: f32 = 6.2831855;

// The number of a thread of workgroups in rows: there are more than one row may have.
fn number_of(id: vec3<u32>, groups: vec3<u32>) -> u32 {
    return id.y * groups.x * 64u + id.x;
}

// Packs a layer's weights, [rows, feature_count] from the place `source` on: by input for the forward pass, by output for the backward pass.
@compute @workgroup_size(64)
fn pack(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let number = number_of(id, groups);
    if (number >= p.rows * p.feature_count) { return; }
    let row = number / p.feature_count;
    let column = number % p.feature_count;
    let weight = weights[p.source + number];
    arena[p.output + column * p.stride + row] = weight;
    arena[p.factors + row * p.factor_stride + column] = weight;
}

// The other coordinate's features: where on the circle u is, or v itself.
@compute @workgroup_size(64)
fn place(@builtin(global_invocation_id) id: vec3<u32>) {
    var point = vec2<f32>(0.5);
    if (id.x < p.count) { point = vec2<f32>(batch[p.point + 2u * id.x], batch[p.point + 2u * id.x + 1u]); }
    if (p.feature_count == 2u) {
        arena[p.output + id.x] = cos(TURN * point.x);
        arena[p.output + p.stride + id.x] = sin(TURN * point.x);
    } else {
        arena[p.output + id.x] = point.y;
    }
}

// A first layer: what it makes of a condition, for each of the condition's columns, and of the features; eight rows.
@compute @workgroup_size(64)
fn first_layer(@builtin(global_invocation_id) id: vec3<u32>) {
    let condition = min(p.first + id.x / p.samples, p.count - 1u);
    var features = vec2<f32>();
    if (p.feature_count > 0u) { features.x = arena[p.features + id.x]; }
    if (p.feature_count > 1u) { features.y = arena[p.features + p.stride + id.x]; }
    for (var row = 8u * id.y; row < min(8u * id.y + 8u, p.rows); row++) {
        var sum = arena[p.source + row * p.source_stride + condition];
        if (p.feature_count > 0u) { sum = fma(arena[p.factors + row], features.x, sum); }
        if (p.feature_count > 1u) { sum = fma(arena[p.factors + p.factor_stride + row], features.y, sum); }
        arena[p.output + row * p.stride + id.x] = max(sum, p.slope * sum);
    }
}

// The derivative by a feature.
@compute @workgroup_size(64)
fn feature_derivative(@builtin(global_invocation_id) id: vec3<u32>) {
    var sum = 0.0;
    for (var k = 0u; k < p.rows; k++) {
        sum = fma(arena[p.factors + k], arena[p.source + k * p.source_stride + id.x], sum);
    }
    arena[p.output + id.x] = sum;
}

// The derivative by an activation becomes that by its argument.
@compute @workgroup_size(64)
fn through_activation(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let number = number_of(id, groups);
    if (number >= p.count) { return; }
    arena[p.output + number] = arena[p.output + number] * select(p.slope, 1.0, arena[p.source + number] > 0.0);
}

// Adds up the slices of the gradient.
@compute @workgroup_size(64)
fn add_slices(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let number = number_of(id, groups);
    if (number >= p.rows) { return; }
    var sum = 0.0;
    for (var slice = 0u; slice < p.count; slice++) { sum += partials[slice * p.rows + number]; }
    arena[p.output + number] = sum;
}

var<workgroup> sums: array<vec4<f32>, 64>;

fn sum_of_workgroup(index: u32, own: vec4<f32>) -> vec4<f32> {
    sums[index] = own;
    for (var reach = 32u; reach > 0u; reach /= 2u) {
        workgroupBarrier();
        if (index < reach) { sums[index] += sums[index + reach]; }
    }
    workgroupBarrier();
    return sums[0];
}

// For one row and one condition: the sum of derivatives over its columns, and of their products with the features. The sums of a kind are
// matrices of `rows` rows one after another.
@compute @workgroup_size(64)
fn condition_sums(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) index: u32) {
    var own = vec4<f32>();
    let first = group.x * p.samples;
    for (var k = index; k < p.samples; k += 64u) {
        let derivative = arena[p.source + group.y * p.source_stride + first + k];
        own.x += derivative;
        if (p.feature_count > 0u) { own.y = fma(derivative, arena[p.features + first + k], own.y); }
        if (p.feature_count > 1u) { own.z = fma(derivative, arena[p.features + p.source_stride + first + k], own.z); }
    }
    let total = sum_of_workgroup(index, own);
    if (index <= p.feature_count) {
        arena[p.output + (index * p.rows + group.y) * p.stride + p.first + group.x] = total[index];
    }
}

// The gradient of a feature's weight: the sum over the conditions of what `condition_sums` found.
@compute @workgroup_size(64)
fn feature_gradient(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) index: u32) {
    var own = 0.0;
    let row = p.source + ((group.y + 1u) * p.rows + group.x) * p.source_stride;
    for (var k = index; k < p.count; k += 64u) { own += arena[row + k]; }
    let total = sum_of_workgroup(index, vec4<f32>(own));
    if (index == 0u) { partials[p.output + group.x * p.stride + group.y] = total.x; }
}
