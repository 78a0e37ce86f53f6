// Reflection at a shading point: a diffuse lobe, and a Trowbridge-Reitz lobe of a Fresnel reflectance. Diffuse surfaces have the first
// alone, rough mirrors the second; the metallic-roughness material of glTF has both, and its diffuse lobe reflects what the other leaves.
// Measured and neural materials reflect by networks instead.

struct HeadtailPoint {
    // Position in metres, above the surface by its rounding error.
    p: vec3<f32>,
    // Geometric and shading normal, on the side of `wo`.
    ng: vec3<f32>,
    ns: vec3<f32>,
    wo: vec3<f32>,
    diffuse: vec3<f32>,
    f0: vec3<f32>,
    alpha: f32,
    // Probability of sampling the Trowbridge-Reitz lobe: 0 or 1 where the other is missing.
    specular_weight: f32,
    // Whether the diffuse lobe is below the other one, and what that leaves at the cosine of `wo`, divided by its mean.
    is_layered: bool,
    left: f32,
    // For samplers in closed form, as `headtail_sample` takes it.
    lobes: vec4<f32>,
    // Whether networks reflect instead.
    is_fitted: bool,
}

const HEADTAIL_DIELECTRIC: f32 = 0.04;
const HEADTAIL_MARGIN: f32 = 0.006;
const HEADTAIL_ALBEDO_NODES: u32 = 64u;

fn headtail_luminance(color: vec3<f32>) -> f32 {
    return dot(color, vec3<f32>(0.2126, 0.7152, 0.0722));
}

// The node below a number of [0, 1], as bits, and the distance to it in nodes.
fn headtail_albedo_node(value: f32) -> vec2<f32> {
    let place = sqrt(clamp(value, 0.0, 1.0)) * f32(HEADTAIL_ALBEDO_NODES - 1u);
    let node = min(u32(place), HEADTAIL_ALBEDO_NODES - 2u);
    return vec2<f32>(f32(node), place - f32(node));
}

fn headtail_albedo_pair(row: u32, column: u32) -> vec2<f32> {
    let at = HEADTAIL_ALBEDO + 2u * (row * (HEADTAIL_ALBEDO_NODES + 1u) + column);
    return vec2<f32>(bitcast<f32>(headtail_surfaces[at]), bitcast<f32>(headtail_surfaces[at + 1u]));
}

// The directional albedo of a lobe of width alpha and reflectance f0.
fn headtail_albedo(alpha: f32, cosine: f32, f0: f32) -> f32 {
    let row = headtail_albedo_node(alpha);
    let column = headtail_albedo_node(cosine);
    let i = u32(row.x);
    let k = u32(column.x);
    let near = mix(headtail_albedo_pair(i, k), headtail_albedo_pair(i, k + 1u), column.y);
    let far = mix(headtail_albedo_pair(i + 1u, k), headtail_albedo_pair(i + 1u, k + 1u), column.y);
    let split = mix(near, far, row.y);
    return f0 * split.x + (1.0 - f0) * split.y;
}

// Its cosine-weighted mean.
fn headtail_mean_albedo(alpha: f32, f0: f32) -> f32 {
    let row = headtail_albedo_node(alpha);
    let i = u32(row.x);
    let split = mix(headtail_albedo_pair(i, HEADTAIL_ALBEDO_NODES), headtail_albedo_pair(i + 1u, HEADTAIL_ALBEDO_NODES), row.y);
    return f0 * split.x + (1.0 - f0) * split.y;
}

fn headtail_left(alpha: f32, cosine: f32) -> f32 {
    return max(1.0 - HEADTAIL_MARGIN - headtail_albedo(alpha, cosine, HEADTAIL_DIELECTRIC), 0.0);
}

// Completes a point of the metallic-roughness material, whose width is known.
fn headtail_layered(given: HeadtailPoint) -> HeadtailPoint {
    var at = given;
    let cosine = dot(at.ns, at.wo);
    let left = headtail_left(at.alpha, cosine);
    at.is_layered = true;
    at.left = left / (1.0 - HEADTAIL_MARGIN - headtail_mean_albedo(at.alpha, HEADTAIL_DIELECTRIC));
    let diffuse = headtail_luminance(at.diffuse) * left;
    let f0 = headtail_luminance(at.f0);
    let specular = headtail_albedo(at.alpha, cosine, f0);
    let weight = clamp(specular / max(specular + diffuse, HEADTAIL_TINY), 0.1, 0.9);
    at.specular_weight = select(weight, 1.0, all(at.diffuse == vec3<f32>(0.0)));
    at.lobes = vec4<f32>(diffuse, 1.0, f0, at.alpha);
    return at;
}

fn headtail_schlick(f0: vec3<f32>, wo: vec3<f32>, wi: vec3<f32>) -> vec3<f32> {
    let sum = wo + wi;
    let x = clamp(1.0 - 0.5 * sqrt(dot(sum, sum)), 0.0, 1.0);
    let squared = x * x;
    return f0 + (vec3<f32>(1.0) - f0) * (squared * squared * x);
}

// BRDF x cosine per channel; 0 below the geometric surface.
fn headtail_reflected(at: HeadtailPoint, wi: vec3<f32>) -> vec3<f32> {
    if (!(dot(at.ng, wi) > 0.0)) { return vec3<f32>(0.0); }
    if (HEADTAIL_HAS_FITTED && at.is_fitted) { return headtail_fitted_reflected(at.ns, at.wo, wi); }
    let cos_i = dot(at.ns, wi);
    var value = at.diffuse * (HEADTAIL_INVERSE_PI * max(cos_i, 0.0));
    if (at.is_layered) { value *= at.left * headtail_left(at.alpha, cos_i); }
    if (at.specular_weight > 0.0) {
        value += headtail_schlick(at.f0, at.wo, wi) * headtail_lobe(at.ns, at.wo, wi, at.alpha);
    }
    return value;
}

// The solid-angle pdf of BRDF sampling.
fn headtail_bsdf_pdf(at: HeadtailPoint, wi: vec3<f32>) -> f32 {
    if (HEADTAIL_HAS_FITTED && at.is_fitted) { return headtail_fitted_pdf(at.ns, at.wo, wi); }
    let diffuse = HEADTAIL_INVERSE_PI * max(dot(at.ns, wi), 0.0);
    if (!(at.specular_weight > 0.0)) { return diffuse; }
    let specular = headtail_brdf_pdf(at.ns, at.wo, wi, at.alpha);
    return select(mix(diffuse, specular, at.specular_weight), specular, at.specular_weight == 1.0);
}

// Draws a direction by BRDF sampling: (wi, pdf); pdf 0 is no sample.
fn headtail_bsdf_sample(at: HeadtailPoint, u: vec2<f32>) -> vec4<f32> {
    if (HEADTAIL_HAS_FITTED && at.is_fitted) {
        let wi = headtail_fitted_draw(at.ns, at.wo, u);
        return vec4<f32>(wi, headtail_fitted_pdf(at.ns, at.wo, wi));
    }
    let weight = at.specular_weight;
    let is_specular = u.x < weight;
    let x = min(select((u.x - weight) / (1.0 - weight), u.x / weight, is_specular), HEADTAIL_BELOW_ONE);
    let wi = headtail_brdf_sample(at.ns, at.wo, select(0.0, at.alpha, is_specular), vec2<f32>(x, u.y));
    return vec4<f32>(wi, headtail_bsdf_pdf(at, wi));
}
