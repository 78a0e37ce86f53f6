// Textures of the features of neural materials, which a network shifts by what it sees.

const HEADTAIL_TEXEL_WIDTH: f32 = 0.4;
const HEADTAIL_FARTHEST_SHIFT: f32 = 0.25;
const HEADTAIL_LEAST_SHIFT_COSINE: f32 = 0.15;

// Adds the features of a level of `side` texels from `first` on, with a weight.
fn headtail_add_features(first: u32, side: u32, uv: vec2<f32>, weight: f32) {
    let place = (uv - floor(uv)) * f32(side) - 0.5;
    let corner = floor(place);
    let inside = place - corner;
    for (var k = 0u; k < 4u; k++) {
        let step = vec2<u32>(k & 1u, k >> 1u);
        // From -1 to `side`, a power of two.
        let texel = bitcast<vec2<u32>>(vec2<i32>(corner) + vec2<i32>(step)) & vec2<u32>(side - 1u);
        let fractions = select(1.0 - inside, inside, step == vec2<u32>(1u));
        let own = weight * fractions.x * fractions.y;
        let at = first + 8u * (texel.y * side + texel.x);
        headtail_features[0] += own * headtail_four_numbers(at);
        headtail_features[1] += own * headtail_four_numbers(at + 4u);
    }
}

// Looks the features up at a position in tiles and a level.
fn headtail_find_features(given: vec2<f32>, level: f32) {
    let uv = select(vec2<f32>(0.0), given, abs(given) < vec2<f32>(HEADTAIL_FAR));
    let finest = u32(headtail_number(headtail_fitted));
    let coarsest = firstLeadingBit(finest);
    let bounded = clamp(level, 0.0, f32(coarsest));
    let below = min(u32(bounded), coarsest);
    let between = bounded - f32(below);
    var first = headtail_fitted + u32(headtail_number(headtail_fitted + 3u));
    for (var finer = 0u; finer < below; finer++) { first += 8u * (finest >> finer) * (finest >> finer); }
    headtail_features = array<vec4<f32>, 2>();
    let side = finest >> below;
    headtail_add_features(first, side, uv, 1.0 - between);
    if (between > 0.0) { headtail_add_features(first + 8u * side * side, side >> 1u, uv, between); }
}

// Finds features and tangents of a point; `tile` has its position and footprint in tiles.
fn headtail_see_texture(at: HeadtailPoint, tile: vec3<f32>, axes: HeadtailUvAxes) {
    let s = headtail_unit_or(axes.u - dot(axes.u, at.ns) * at.ns, headtail_frame(at.ns).s);
    headtail_look_at_texture(at.ns, s, select(1.0, -1.0, dot(cross(at.ns, s), axes.v) < 0.0), at.wo);
    let level = log2(max(tile.z * headtail_number(headtail_fitted) / HEADTAIL_TEXEL_WIDTH, 1.0));
    headtail_find_features(tile.xy, level);
    headtail_see_features();
    let raw = headtail_fitted_units[headtail_fitted_network(headtail_fitted + 4u)];
    let shift = HEADTAIL_FARTHEST_SHIFT * (2.0 * headtail_sigmoid(raw) - 1.0) / max(headtail_local_wo.z, HEADTAIL_LEAST_SHIFT_COSINE);
    headtail_find_features(tile.xy + shift * headtail_local_wo.xy, level);
}
