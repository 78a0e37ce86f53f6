// A head warp: two splines over the square whose logits are given by networks of the condition, once it was seen.

// What a head for measured or neural materials is told of one, to be set before the calls: the six latents of a measured one; features, first
// tangent and handedness of a neural one. Other heads do not look at it.
var<private> headtail_latents: array<f32, 12>;

const HEADTAIL_ELEVATION: u32 = HEADTAIL_HEAD_ENCODER_LAYERS;
const HEADTAIL_AZIMUTH: u32 = HEADTAIL_ELEVATION + HEADTAIL_HEAD_ELEVATION_LAYERS;
const HEADTAIL_MIXTURE_WEIGHT: u32 = HEADTAIL_AZIMUTH + HEADTAIL_HEAD_AZIMUTH_LAYERS;

fn headtail_three(place: u32, v: vec3<f32>) {
    headtail_units[place] = v.x;
    headtail_units[place + 1u] = v.y;
    headtail_units[place + 2u] = v.z;
}

// The condition, and what the encoder makes of it, at the beginning of the list: what all networks see; and all that depends on it alone, the sums of
// their first layers or the logits of an elevation that does not see the azimuth.
fn headtail_see(n: vec3<f32>, wo: vec3<f32>, alpha: f32) {
    if (HEADTAIL_HEAD_CONDITION == 3u) {
        headtail_three(0u, n);
    } else {
        let cosine = dot(n, wo);
        headtail_three(0u, wo);
        headtail_three(3u, n);
        headtail_three(6u, 2.0 * cosine * n - wo);
        headtail_units[9] = cosine;
        if (HEADTAIL_HEAD_CONDITION == 12u) {
            headtail_units[10] = alpha;
            headtail_units[11] = headtail_ln(alpha);
        }
        if (HEADTAIL_HEAD_CONDITION > 12u) {
            for (var k = 10u; k < HEADTAIL_HEAD_CONDITION; k++) { headtail_units[k] = headtail_latents[k - 10u]; }
        }
    }
    var start = 0u;
    for (var k = 0u; k < HEADTAIL_HEAD_ENCODER_LAYERS; k++) {
        let is_last = k + 1u == HEADTAIL_HEAD_ENCODER_LAYERS;
        let end = select(HEADTAIL_HEAD_HIDDEN + (k & 1u) * HEADTAIL_HEAD_WIDEST, HEADTAIL_HEAD_CONDITION, is_last);
        headtail_layer(k, headtail_layer_inputs(k), start, end, true);
        start = end;
    }
    headtail_layer(HEADTAIL_AZIMUTH, HEADTAIL_HEAD_SEEN, 0u, HEADTAIL_HEAD_PREPARED_AZIMUTH, false);
    if (HEADTAIL_HEAD_COUPLED == 1u) {
        headtail_layer(HEADTAIL_ELEVATION, HEADTAIL_HEAD_SEEN, 0u, HEADTAIL_HEAD_PREPARED_ELEVATION, false);
    } else {
        headtail_layers(HEADTAIL_ELEVATION, HEADTAIL_HEAD_ELEVATION_LAYERS, 0u, HEADTAIL_HEAD_PREPARED_ELEVATION);
    }
}

// The logits of the azimuth's spline, which sees the elevation, or of the elevation's; coupled ones see where on the circle the azimuth is.
fn headtail_logits(of_azimuth: bool, seen: f32) {
    if (of_azimuth) {
        headtail_units[HEADTAIL_HEAD_SEEN] = seen;
    } else if (HEADTAIL_HEAD_COUPLED == 1u) {
        let place = headtail_cos_sin_turns(seen);
        headtail_units[HEADTAIL_HEAD_SEEN] = place.x;
        headtail_units[HEADTAIL_HEAD_SEEN + 1u] = place.y;
    } else {
        // Splines overwrite their logits.
        for (var k = 0u; k <= 3u * HEADTAIL_HEAD_ELEVATION_BINS; k++) {
            headtail_units[HEADTAIL_HEAD_LOGITS + k] = headtail_units[HEADTAIL_HEAD_PREPARED_ELEVATION + k];
        }
        return;
    }
    let first = select(HEADTAIL_ELEVATION, HEADTAIL_AZIMUTH, of_azimuth);
    let count = select(HEADTAIL_HEAD_ELEVATION_LAYERS, HEADTAIL_HEAD_AZIMUTH_LAYERS, of_azimuth);
    headtail_network(first, count, select(HEADTAIL_HEAD_PREPARED_ELEVATION, HEADTAIL_HEAD_PREPARED_AZIMUTH, of_azimuth));
}

fn headtail_bins(of_azimuth: bool) -> u32 {
    return select(HEADTAIL_HEAD_ELEVATION_BINS, HEADTAIL_HEAD_AZIMUTH_BINS, of_azimuth);
}

// The learned mixture weight of the head beside sampling the BSDF; `prior` is added to its logit.
fn headtail_head_mixture_weight(prior: f32) -> f32 {
    headtail_layers(HEADTAIL_MIXTURE_WEIGHT, HEADTAIL_HEAD_MIXTURE_WEIGHT_LAYERS, 0u, HEADTAIL_HEAD_LOGITS);
    return 0.02 + 0.96 / (1.0 + headtail_exp(min(-headtail_units[HEADTAIL_HEAD_LOGITS] - prior, 88.0)));
}

// The point that a uniform point z is carried to, and the density there. One loop for both splines, since functions are written out wherever they
// are called.
fn headtail_head_draw(z: vec2<f32>) -> vec3<f32> {
    var at = z;
    var density = 1.0;
    for (var k = 0u; k < 2u; k++) {
        let of_azimuth = (k == 0u) == (HEADTAIL_HEAD_COUPLED == 1u);
        headtail_logits(of_azimuth, select(at.x, at.y, of_azimuth));
        let drawn = headtail_spline_forward(select(at.y, at.x, of_azimuth), headtail_bins(of_azimuth), of_azimuth);
        at = select(vec2<f32>(at.x, drawn.x), vec2<f32>(drawn.x, at.y), of_azimuth);
        density *= drawn.y;
    }
    return vec3<f32>(at, density);
}

// The density at a point.
fn headtail_head_density(point: vec2<f32>) -> f32 {
    var seen = point.x;
    var density = 1.0;
    for (var k = 0u; k < 2u; k++) {
        let of_azimuth = k == 1u;
        headtail_logits(of_azimuth, seen);
        let back = headtail_spline_inverse(select(point.y, point.x, of_azimuth), headtail_bins(of_azimuth), of_azimuth);
        seen = select(point.y, back.x, HEADTAIL_HEAD_COUPLED == 1u);
        density *= back.y;
    }
    return density;
}
