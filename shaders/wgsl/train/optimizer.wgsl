// AdamW (Loshchilov and Hutter 2019) with clipping by the norm and a moving average of the weights, as in `headtail_train::optimizer`, over the steps
// of a run: `judge`, then `move_weights`. The program defines WEIGHTS, CONDITIONS, GRADIENT (its place in the arena, followed by each condition's
// loss and whether it is lit), MOST_STEPS, HAS_AVERAGE, BETA_1, BETA_2, EPSILON and CLIP_NORM.

@group(0) @binding(0) var<storage, read> arena: array<f32>;
// First the step at hand: how many were before it, how many of these moved the weights, number of lit conditions, and factor of the gradient, 0
// where nothing moves. Then for each step: learning rate, factor of the weights, and what is found: loss, and what became of the step. Then for
// each move: factors of the first moments and of the root of the second ones, and of the moving average.
@group(0) @binding(1) var<storage, read_write> steps: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> weights: array<f32>;
// First and second moments, then the moving average.
@group(0) @binding(3) var<storage, read_write> state: array<f32>;

const MOVED: f32 = 0.0;
const SKIPPED: f32 = 1.0;
const DARK: f32 = 2.0;

// Squares of derivatives up to 1e28 can be added up; those below 1e-10 have no part in a norm that is clipped.
const NORM_UNIT: f32 = 4294967296.0;

// Shaders may take it for granted that numbers are finite, but not that bits are.
fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

fn derivative_of(weight: u32) -> f32 {
    if (weight >= WEIGHTS) { return 0.0; }
    return arena[GRADIENT + weight] / NORM_UNIT;
}

const THREADS: u32 = 256u;
var<workgroup> sums: array<vec3<f32>, THREADS>;

@compute @workgroup_size(THREADS)
fn judge(@builtin(local_invocation_index) index: u32) {
    var own = vec3<f32>();
    for (var k = index; k < CONDITIONS; k += THREADS) {
        own.x += arena[GRADIENT + WEIGHTS + k];
        own.y += arena[GRADIENT + WEIGHTS + CONDITIONS + k];
    }
    // Four at a time: the loads are what takes time.
    for (var k = index; k < WEIGHTS; k += 4u * THREADS) {
        let four = vec4<f32>(
            derivative_of(k), derivative_of(k + THREADS), derivative_of(k + 2u * THREADS), derivative_of(k + 3u * THREADS),
        );
        own.z += dot(four, four);
    }
    sums[index] = own;
    for (var reach = THREADS / 2u; reach > 0u; reach /= 2u) {
        workgroupBarrier();
        if (index < reach) { sums[index] += sums[index + reach]; }
    }
    workgroupBarrier();
    if (index > 0u) { return; }
    let total = sums[0];
    let at = 1u + u32(steps[0].x);
    let loss = total.x / max(total.y, 1.0);
    let norm = NORM_UNIT * sqrt(total.z) / max(total.y, 1.0);
    var outcome = MOVED;
    if (!(is_finite(loss) && is_finite(total.z))) { outcome = SKIPPED; }
    if (total.y == 0.0) { outcome = DARK; }
    let clip = select(0.0, select(1.0, CLIP_NORM / norm, norm > CLIP_NORM), outcome == MOVED);
    steps[at].z = loss;
    steps[at].w = outcome;
    steps[0] = vec4<f32>(steps[0].x + 1.0, steps[0].y + select(0.0, 1.0, outcome == MOVED), total.y, clip);
}

@compute @workgroup_size(64)
fn move_weights(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let number = id.y * groups.x * 64u + id.x;
    let now = steps[0];
    if (number >= WEIGHTS || now.w == 0.0) { return; }
    let step = steps[u32(now.x)];
    let factors = steps[MOST_STEPS + u32(now.y)];
    let gradient = arena[GRADIENT + number] / now.z * now.w;
    let first = BETA_1 * state[number] + (1.0 - BETA_1) * gradient;
    let second = BETA_2 * state[WEIGHTS + number] + (1.0 - BETA_2) * gradient * gradient;
    let weight = step.y * weights[number] - step.x * factors.x * first / (sqrt(second) * factors.y + EPSILON);
    state[number] = first;
    state[WEIGHTS + number] = second;
    weights[number] = weight;
    if (HAS_AVERAGE == 1u) {
        let average = 2u * WEIGHTS + number;
        state[average] = factors.z * state[average] + (1.0 - factors.z) * weight;
    }
}
