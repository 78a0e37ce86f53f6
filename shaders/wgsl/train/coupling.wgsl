// What the coupling layers of a flow need beside networks and splines, one thread per column: coordinates and their features, as in
// `headtail_model::Flow`, and the likelihood.

struct Params {
    // From row to row of all matrices.
    stride: u32,
    // Number of the first point in the batch, and the number of points.
    first: u32,
    count: u32,
    // Places in the arena: both coordinates, derivatives by them, derivatives by log-slopes, and log-slopes of all layers.
    points: u32,
    d_points: u32,
    d_log: u32,
    log_slopes: u32,
    couplings: u32,
    // Place of the loss, followed by whether there is any.
    loss: u32,
    // Of a layer: the coordinate that it does not transform, its features, and derivatives by both.
    other: u32,
    features: u32,
    d_features: u32,
    d_other: u32,
    sees_other: u32,
    // Whether the other coordinate is the azimuth.
    is_circle: u32,
    octaves: u32,
    // One over the number of points of the batch.
    share: f32,
}

@group(0) @binding(1) var<storage, read> batch: array<f32>;
@group(0) @binding(2) var<storage, read_write> arena: array<f32>;
@group(0) @binding(4) var<uniform> p: Params;

const TURN: f32 = 6.2831855;

@compute @workgroup_size(64)
fn place_points(@builtin(global_invocation_id) id: vec3<u32>) {
    let is_there = id.x < p.count;
    var point = vec2<f32>(0.5);
    if (is_there) { point = vec2<f32>(batch[2u * (p.first + id.x)], batch[2u * (p.first + id.x) + 1u]); }
    arena[p.points + id.x] = point.x;
    arena[p.points + p.stride + id.x] = point.y;
    arena[p.d_points + id.x] = 0.0;
    arena[p.d_points + p.stride + id.x] = 0.0;
    arena[p.d_log + id.x] = select(0.0, -p.share, is_there);
}

// An octave's angle between -pi and pi, where sines and cosines are accurate on all devices, and the angle per unit of the coordinate.
fn angle_of(x: f32, octave: u32) -> vec2<f32> {
    let turns = select(0.5, 1.0, p.is_circle == 1u) * f32(1u << octave);
    return TURN * vec2<f32>(turns * x - round(turns * x), turns);
}

// Cosines and sines of the azimuth; of the elevation, the coordinate itself and cosines.
@compute @workgroup_size(64)
fn place_features(@builtin(global_invocation_id) id: vec3<u32>) {
    let x = select(0.0, arena[p.other + id.x], p.sees_other == 1u);
    for (var k = 0u; k < p.octaves; k++) {
        let place = p.features + k * p.stride + id.x;
        let angle = angle_of(x, k).x;
        if (p.is_circle == 1u) {
            arena[place] = cos(angle);
            arena[place + p.octaves * p.stride] = sin(angle);
        } else {
            arena[place] = select(cos(angle), 2.0 * x - 1.0, k == 0u);
        }
    }
}

@compute @workgroup_size(64)
fn features_backward(@builtin(global_invocation_id) id: vec3<u32>) {
    var sum = arena[p.d_other + id.x];
    for (var k = 0u; k < p.octaves; k++) {
        let row = k * p.stride + id.x;
        let d = arena[p.d_features + row];
        let angle = angle_of(arena[p.other + id.x], k);
        if (p.is_circle == 1u) {
            let d_sine = arena[p.d_features + p.octaves * p.stride + row];
            sum += angle.y * (d_sine * arena[p.features + row] - d * arena[p.features + p.octaves * p.stride + row]);
        } else {
            sum += d * select(-angle.y * sin(angle.x), 2.0, k == 0u);
        }
    }
    arena[p.d_other + id.x] = sum;
}

const THREADS: u32 = 256u;
var<workgroup> sums: array<f32, THREADS>;

// The mean of the negative log-density, added up over pieces of the batch. One workgroup.
@compute @workgroup_size(THREADS)
fn likelihood(@builtin(local_invocation_index) index: u32) {
    var own = 0.0;
    for (var row = 0u; row < p.couplings; row++) {
        for (var k = index; k < p.count; k += THREADS) { own -= arena[p.log_slopes + row * p.stride + k]; }
    }
    sums[index] = own;
    for (var reach = THREADS / 2u; reach > 0u; reach /= 2u) {
        workgroupBarrier();
        if (index < reach) { sums[index] += sums[index + reach]; }
    }
    if (index == 0u) {
        arena[p.loss] = select(arena[p.loss], 0.0, p.first == 0u) + p.share * sums[0];
        arena[p.loss + 1u] = 1.0;
    }
}
