// BRDF x cosine and BRDF sampling of diffuse surfaces and of Trowbridge-Reitz (GGX) microfacets with F = 1, as in `headtail_render::brdf`. Where
// alpha is 0, the surface is diffuse, and BRDF x cosine is the cosine.

// A unit tangent frame: v.x s + v.y t + v.z n (Duff et al. 2017).
struct HeadtailFrame { s: vec3<f32>, t: vec3<f32>, n: vec3<f32> }

fn headtail_frame(n: vec3<f32>) -> HeadtailFrame {
    let side = select(1.0, -1.0, (bitcast<u32>(n.z) >> 31u) == 1u);
    let a = -1.0 / (side + n.z);
    let b = n.x * n.y * a;
    return HeadtailFrame(vec3<f32>(1.0 + side * n.x * n.x * a, side * b, -side * n.x), vec3<f32>(b, side + n.y * n.y * a, -n.y), n);
}

// The unit square to the unit disk (Shirley and Chiu 1997).
fn headtail_disk(u: vec2<f32>) -> vec2<f32> {
    let p = 2.0 * u - 1.0;
    let across = abs(p.x) > abs(p.y);
    let radius = select(p.y, p.x, across);
    let other = select(p.x, p.y, across);
    let turns = 0.125 * (other / select(radius, 1.0, radius == 0.0));
    return radius * headtail_cos_sin_turns(select(0.25 - turns, turns, across));
}

fn headtail_unit(v: vec3<f32>) -> vec3<f32> {
    return v * (1.0 / sqrt(max(dot(v, v), HEADTAIL_TINY)));
}

// The density of microfacet normals in the direction of h, of any length.
fn headtail_normal_density(n: vec3<f32>, h: vec3<f32>, alpha: f32) -> f32 {
    let cosine = dot(n, h);
    let across = cross(n, h);
    let sin_squared = dot(across, across);
    let cos_squared = cosine * cosine;
    let ratio = (sin_squared + cos_squared) / max(sin_squared + alpha * alpha * cos_squared, HEADTAIL_TINY);
    return HEADTAIL_INVERSE_PI * alpha * alpha * ratio * ratio;
}

// The length of a unit vector whose tangential part is scaled by alpha.
fn headtail_scaled_length(n: vec3<f32>, w: vec3<f32>, cosine: f32, alpha: f32) -> f32 {
    let across = cross(n, w);
    return sqrt(cosine * cosine + alpha * alpha * dot(across, across));
}

// BRDF x cosine.
fn headtail_lobe(n: vec3<f32>, wo: vec3<f32>, wi: vec3<f32>, alpha: f32) -> f32 {
    let cos_i = dot(n, wi);
    if (alpha == 0.0) { return max(cos_i, 0.0); }
    let cos_o = dot(n, wo);
    if (!(cos_o > 0.0 && cos_i > 0.0)) { return 0.0; }
    let shadowing = cos_o * (headtail_scaled_length(n, wi, cos_i, alpha) / cos_i) + headtail_scaled_length(n, wo, cos_o, alpha);
    return headtail_normal_density(n, wo + wi, alpha) / (2.0 * shadowing);
}

// The solid-angle pdf of BRDF sampling.
fn headtail_brdf_pdf(n: vec3<f32>, wo: vec3<f32>, wi: vec3<f32>, alpha: f32) -> f32 {
    let cos_i = dot(n, wi);
    if (alpha == 0.0) { return HEADTAIL_INVERSE_PI * max(cos_i, 0.0); }
    let cos_o = dot(n, wo);
    if (!(cos_o > 0.0 && cos_i > 0.0)) { return 0.0; }
    return headtail_normal_density(n, wo + wi, alpha) / (2.0 * (cos_o + headtail_scaled_length(n, wo, cos_o, alpha)));
}

// A direction by BRDF sampling: visible normals by spherical caps (Dupuy and Benyoub 2023). It may be below the horizon, where the pdf is 0.
fn headtail_brdf_sample(n: vec3<f32>, wo: vec3<f32>, alpha: f32, u: vec2<f32>) -> vec3<f32> {
    let frame = headtail_frame(n);
    if (alpha == 0.0) {
        let disk = headtail_disk(u);
        let height = sqrt(max(1.0 - dot(disk, disk), 0.0));
        return disk.x * frame.s + disk.y * frame.t + height * frame.n;
    }
    let stretch = vec3<f32>(alpha, alpha, 1.0);
    let scaled = headtail_unit(vec3<f32>(dot(wo, frame.s), dot(wo, frame.t), dot(wo, frame.n)) * stretch);
    let below = u.y * (1.0 + scaled.z);
    let radius = sqrt(max(below * (2.0 - below), 0.0));
    let phi = headtail_cos_sin_turns(u.x);
    let h = vec3<f32>(radius * phi + scaled.xy, (1.0 + scaled.z) * (1.0 - u.y));
    let local = headtail_unit(h * stretch);
    let m = local.x * frame.s + local.y * frame.t + local.z * frame.n;
    return headtail_unit(2.0 * dot(wo, m) * m - wo);
}
