// Directions and points of X, and functions that all samplers share.

const HEADTAIL_PI: f32 = 3.14159265358979;
const HEADTAIL_INVERSE_PI: f32 = 0.318309886183791;
const HEADTAIL_BELOW_ONE: f32 = 0.99999994;
const HEADTAIL_LEAST_SINE: f32 = 1e-7;
const HEADTAIL_TINY: f32 = 1.17549435e-38;

// The position of a number in an interval, in [0, 1): what is left of a uniform number that chose it.
fn headtail_remap(at: f32, start: f32, end: f32) -> f32 {
    if (!(end > start)) { return 0.0; }
    return clamp((at - start) / (end - start), 0.0, HEADTAIL_BELOW_ONE);
}

// Cosine and sine of whole turns, to 2e-7: devices promise less of their own. After Cephes.
fn headtail_cos_sin_turns(turns: f32) -> vec2<f32> {
    let quarter = round(4.0 * turns);
    let quadrant = u32(i32(quarter)) & 3u;
    let x = (turns - 0.25 * quarter) * (2.0 * HEADTAIL_PI);
    let s = x * x;
    let sine = ((-1.9515296e-4 * s + 8.332161e-3) * s - 1.6666655e-1) * s * x + x;
    let cosine = ((2.4433157e-5 * s - 1.3887316e-3) * s + 4.1666646e-2) * s * s - 0.5 * s + 1.0;
    let odd = (quadrant & 1u) != 0u;
    let c = select(cosine, sine, odd);
    let t = select(sine, cosine, odd);
    return vec2<f32>(select(c, -c, ((quadrant + 1u) & 2u) != 0u), select(t, -t, (quadrant & 2u) != 0u));
}

// The angle of a point in whole turns, in [-1/2, 1/2], to 3e-7. After Cephes.
fn headtail_atan2_turns(y: f32, x: f32) -> f32 {
    let steep = abs(y) > abs(x);
    let small = select(abs(y), abs(x), steep);
    let large = select(abs(x), abs(y), steep);
    let beyond = small > 0.41421357 * large;
    let above = select(small, small - large, beyond);
    let below = select(large, small + large, beyond);
    let t = above / select(below, 1.0, below == 0.0);
    let s = t * t;
    var turns = ((((8.0537445e-2 * s - 1.3877686e-1) * s + 1.997771e-1) * s - 3.333295e-1) * s * t + t) * (0.5 / HEADTAIL_PI);
    turns = select(turns, 0.125 + turns, beyond);
    turns = select(turns, 0.25 - turns, steep);
    turns = select(turns, 0.5 - turns, x < 0.0);
    return select(turns, -turns, y < 0.0);
}

// The unit direction of a point of X; the fourth number is the factor from densities over X to pdfs over solid angle.
fn headtail_direction(x: vec2<f32>) -> vec4<f32> {
    let phi = headtail_cos_sin_turns(x.x);
    let theta = headtail_cos_sin_turns(0.5 * x.y);
    let factor = 1.0 / (2.0 * HEADTAIL_PI * HEADTAIL_PI * max(theta.y, HEADTAIL_LEAST_SINE));
    return vec4<f32>(phi.y * theta.y, theta.x, -phi.x * theta.y, factor);
}

// The point of X of a unit direction, and the same factor.
fn headtail_square(w: vec3<f32>) -> vec3<f32> {
    let horizontal = sqrt(w.x * w.x + w.z * w.z);
    var u = headtail_atan2_turns(w.x, -w.z);
    u = select(u, u + 1.0, u < 0.0);
    let v = min(2.0 * headtail_atan2_turns(horizontal, w.y), 1.0);
    let sine = headtail_cos_sin_turns(0.5 * v).y;
    return vec3<f32>(select(u, 0.0, u >= 1.0), v, 1.0 / (2.0 * HEADTAIL_PI * HEADTAIL_PI * max(sine, HEADTAIL_LEAST_SINE)));
}

// The point at which the linear density from a to b has accumulated the fraction u, and the inverse.
fn headtail_sample_linear(u: f32, a: f32, b: f32) -> f32 {
    let below = a + sqrt(max(a * a + u * (b * b - a * a), 0.0));
    if (!(below > 0.0)) { return 0.0; }
    return min(u * (a + b) / below, HEADTAIL_BELOW_ONE);
}

fn headtail_invert_linear(t: f32, a: f32, b: f32) -> f32 {
    if (!(a + b > 0.0)) { return t; }
    return min(t * (a * (2.0 - t) + b * t) / (a + b), HEADTAIL_BELOW_ONE);
}

// A number of the floats, and four of a list: lists begin at multiples of sixteen.
fn headtail_float(at: u32) -> f32 {
    return headtail_floats[at >> 2u][at & 3u];
}

fn headtail_four(start: u32, k: u32) -> vec4<f32> {
    return headtail_floats[(start >> 2u) + k];
}
