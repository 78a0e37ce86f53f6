// Losses of conditions, and their derivatives by the logarithms of densities and by the logits of mixture weights; one workgroup per condition. See
// `headtail_train::Loss`. Losses and derivatives are those of one condition: the mean over the lit ones is taken later.

struct Params {
    // Number of points of the batch, which has first the points, then densities, weights, densities of BRDF sampling and of the tail, and for each
    // condition the offset of its mixture weight's logit.
    points: u32,
    samples: u32,
    first: u32,
    // Places in the arena.
    log_elevation: u32,
    log_azimuth: u32,
    d_log: u32,
    loss: u32,
    is_lit: u32,
    has_mixture_weight: u32,
    logit: u32,
    d_logit: u32,
    form: u32,
    entropic: f32,
}

const FORWARD_KL: u32 = 0u;
const LOG_CHI_SQUARE: u32 = 1u;
const CHI_SQUARE: u32 = 2u;
const REVERSE_KL: u32 = 3u;

// Stands for the logarithm of 0.
const LOG_ZERO: f32 = -1e30;
// ln 1e-4; see the constants of `headtail_train::loss`.
const LOG_REVERSE_TARGET_FLOOR: f32 = -9.2103404;
const ENTROPIC_RANGE: f32 = 60.0;
const LARGEST_LOG_CHI_SQUARE: f32 = 60.0;
const MIXTURE_WEIGHT_FLOOR: f32 = 0.02;

@group(0) @binding(1) var<storage, read> batch: array<f32>;
@group(0) @binding(2) var<storage, read_write> arena: array<f32>;
@group(0) @binding(4) var<uniform> p: Params;

const THREADS: u32 = 256u;
var<workgroup> numbers: array<f32, THREADS>;

fn sum_of_workgroup(index: u32, own: f32) -> f32 {
    workgroupBarrier();
    numbers[index] = own;
    for (var reach = THREADS / 2u; reach > 0u; reach /= 2u) {
        workgroupBarrier();
        if (index < reach) { numbers[index] += numbers[index + reach]; }
    }
    workgroupBarrier();
    return numbers[0];
}

fn max_of_workgroup(index: u32, own: f32) -> f32 {
    workgroupBarrier();
    numbers[index] = own;
    for (var reach = THREADS / 2u; reach > 0u; reach /= 2u) {
        workgroupBarrier();
        if (index < reach) { numbers[index] = max(numbers[index], numbers[index + reach]); }
    }
    workgroupBarrier();
    return numbers[0];
}

fn log_of(x: f32) -> f32 {
    if (x > 0.0) { return log(x); }
    return LOG_ZERO;
}

// The mixture of the head with BRDF sampling: logarithms of its weights, the weight, and its derivative by the logit.
struct Mixture { is_there: bool, log_head: f32, log_brdf: f32, weight: f32, d_logit: f32 }

fn mixture_of(condition: u32) -> Mixture {
    if (p.has_mixture_weight == 0u) { return Mixture(false, 0.0, 0.0, 1.0, 0.0); }
    let logit = arena[p.logit + condition] + batch[6u * p.points + condition];
    let free = 1.0 - 2.0 * MIXTURE_WEIGHT_FLOOR;
    let share = 1.0 / (1.0 + exp(min(-logit, 88.0)));
    let weight = MIXTURE_WEIGHT_FLOOR + free * share;
    return Mixture(true, log(weight), log(1.0 - weight), weight, free * share * (1.0 - share));
}

// One point: logarithms of its weight among the points, of the target's density, of the head's, and of what is judged.
struct Point { weight: f32, log_weight: f32, log_target: f32, log_q: f32, log_judged: f32, v: f32 }

fn point_of(k: u32, condition: u32, total: f32, mixture: Mixture) -> Point {
    let at = condition * p.samples + k;
    let column = (condition - p.first) * p.samples + k;
    let g = batch[2u * p.points + at];
    let v = batch[3u * p.points + at];
    var point: Point;
    point.v = v;
    point.weight = g * v / total;
    point.log_weight = log_of(point.weight);
    point.log_target = log_of(g * f32(p.samples) / total);
    point.log_q = arena[p.log_elevation + column] + arena[p.log_azimuth + column];
    point.log_judged = point.log_q;
    if (mixture.is_there) {
        let head = mixture.log_head + point.log_q;
        let brdf = mixture.log_brdf + log_of(batch[4u * p.points + at]);
        let largest = max(head, brdf);
        point.log_judged = largest + log(exp(head - largest) + exp(brdf - largest));
    }
    return point;
}

// The term of a point in a sum of exponentials: of weights over densities, or of the head's mass.
fn term_of(point: Point) -> f32 {
    if (p.form == REVERSE_KL) { return select(LOG_ZERO, log_of(point.v) + point.log_judged, point.v > 0.0); }
    return select(LOG_ZERO, point.log_weight + point.log_target - point.log_judged, point.weight > 0.0);
}

// ln(u / w) of the reverse divergence.
fn excess_of(point: Point, log_u: f32) -> f32 {
    return log_u - (max(point.log_target, LOG_REVERSE_TARGET_FLOOR) + log_of(point.v) - log(f32(p.samples)));
}

@compute @workgroup_size(THREADS)
fn loss(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) index: u32) {
    let condition = p.first + group.x;
    let column = group.x * p.samples;
    let mixture = mixture_of(condition);
    var own = 0.0;
    for (var k = index; k < p.samples; k += THREADS) {
        let at = condition * p.samples + k;
        own += batch[2u * p.points + at] * batch[3u * p.points + at];
    }
    let total = sum_of_workgroup(index, own);
    let is_lit = total > 0.0;
    let divisor = select(1.0, total, is_lit);

    // The sum of exponentials, over the largest.
    var largest = LOG_ZERO;
    for (var k = index; k < p.samples; k += THREADS) { largest = max(largest, term_of(point_of(k, condition, divisor, mixture))); }
    largest = max_of_workgroup(index, largest);
    var sum = 0.0;
    for (var k = index; k < p.samples; k += THREADS) { sum += exp(term_of(point_of(k, condition, divisor, mixture)) - largest); }
    sum = sum_of_workgroup(index, sum);
    let log_sum = largest + log(sum);

    // The loss; the entropic term is added below.
    own = 0.0;
    for (var k = index; k < p.samples; k += THREADS) {
        let point = point_of(k, condition, divisor, mixture);
        if (p.form == FORWARD_KL && point.weight > 0.0) { own += point.weight * (point.log_target - point.log_judged); }
        if (p.form == REVERSE_KL && point.v > 0.0) {
            let log_u = term_of(point) - log_sum;
            own += exp(log_u) * excess_of(point, log_u);
        }
    }
    var found = sum_of_workgroup(index, own);
    var factor = 1.0;
    if (p.form == LOG_CHI_SQUARE) { found = log_sum; }
    if (p.form == CHI_SQUARE) {
        factor = exp(min(log_sum, LARGEST_LOG_CHI_SQUARE));
        found = factor - 1.0;
    }

    var entropic = 0.0;
    var d_weight = 0.0;
    for (var k = index; k < p.samples; k += THREADS) {
        let point = point_of(k, condition, divisor, mixture);
        var d = 0.0;
        if (p.form == FORWARD_KL) {
            d = -point.weight;
        } else if (p.form == REVERSE_KL) {
            let log_u = term_of(point) - log_sum;
            if (point.v > 0.0) { d = exp(log_u) * (excess_of(point, log_u) - found); }
        } else {
            d = -factor * exp(term_of(point) - largest) / sum;
        }
        if (p.entropic > 0.0 && point.weight > 0.0) {
            let log_x = point.log_judged + log_of(batch[5u * p.points + condition * p.samples + k]);
            let held = clamp(log_x, -ENTROPIC_RANGE, ENTROPIC_RANGE);
            entropic += point.weight * exp(held) * held;
            if (held == log_x) { d += p.entropic * point.weight * exp(held) * (held + 1.0); }
        }
        if (mixture.is_there) {
            let head = min(exp(mixture.log_head + point.log_q - point.log_judged), 1.0);
            d_weight += d * (head / mixture.weight - (1.0 - head) / (1.0 - mixture.weight));
            d *= head;
        }
        arena[p.d_log + column + k] = select(0.0, d, is_lit);
    }
    entropic = sum_of_workgroup(index, entropic);
    d_weight = sum_of_workgroup(index, d_weight);
    if (index == 0u) {
        arena[p.loss + condition] = select(0.0, found + p.entropic * entropic, is_lit);
        arena[p.is_lit + condition] = select(0.0, 1.0, is_lit);
        if (p.has_mixture_weight == 1u) { arena[p.d_logit + condition] = select(0.0, d_weight * mixture.d_logit, is_lit); }
    }
}
