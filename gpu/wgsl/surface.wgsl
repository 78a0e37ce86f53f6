// Surfaces: the attributes of triangles, textures, materials.
//
// A face has ten words: its material, the places of its normals, of its coordinates of base colour, of roughness, of emission and of the normal
// map, of its tangents, of its colours, of its alpha mask, and of its alphas; a place is HEADTAIL_NONE where it has none. A material has sixteen.

@group(0) @binding(3) var<storage, read> headtail_surfaces: array<u32>;

const HEADTAIL_OF_FACE: u32 = 10u;
const HEADTAIL_COPIED: u32 = 2u;
const HEADTAIL_MIN_COSINE: f32 = 1e-2;
const HEADTAIL_MIN_ALPHA: f32 = 1e-3;
const HEADTAIL_DIFFUSE: u32 = 0u;
const HEADTAIL_MIRROR: u32 = 1u;
const HEADTAIL_FITTED: u32 = 3u;

fn headtail_number(at: u32) -> f32 {
    return bitcast<f32>(headtail_surfaces[at]);
}

fn headtail_vector(at: u32) -> vec3<f32> {
    return vec3<f32>(headtail_number(at), headtail_number(at + 1u), headtail_number(at + 2u));
}

// An attribute of three numbers per corner, between the corners.
fn headtail_between(at: u32, weights: vec3<f32>) -> vec3<f32> {
    return weights.x * headtail_vector(at) + weights.y * headtail_vector(at + 3u) + weights.z * headtail_vector(at + 6u);
}

fn headtail_corner_uv(at: u32, corner: u32) -> vec2<f32> {
    return vec2<f32>(headtail_number(at + 2u * corner), headtail_number(at + 2u * corner + 1u));
}

fn headtail_uv(at: u32, weights: vec3<f32>) -> vec2<f32> {
    return weights.x * headtail_corner_uv(at, 0u) + weights.y * headtail_corner_uv(at, 1u) + weights.z * headtail_corner_uv(at, 2u);
}

// Texel `i` of an infinite row, one of `n`: repeated, mirrored or clamped.
fn headtail_wrapped(i: i32, n: i32, mode: u32) -> i32 {
    if (mode == 2u) { return clamp(i, 0, n - 1); }
    let period = select(n, 2 * n, mode == 1u);
    let rest = i % period;
    let inside = select(rest, rest + period, rest < 0);
    return select(inside, min(inside, 2 * n - 1 - inside), mode == 1u);
}

// A texture has four words (width, height, wrap modes of u and v and the filter in bits, first texel), then texels of 8 bits per channel.
fn headtail_texel_of(texture: u32, x: i32, y: i32, is_color: bool) -> vec3<f32> {
    let width = i32(headtail_surfaces[texture]);
    let height = i32(headtail_surfaces[texture + 1u]);
    let modes = headtail_surfaces[texture + 2u];
    let column = headtail_wrapped(x, width, modes & 3u);
    let row = headtail_wrapped(y, height, (modes >> 2u) & 3u);
    let codes = (vec3<u32>(headtail_surfaces[headtail_surfaces[texture + 3u] + u32(row * width + column)]) >> vec3<u32>(0u, 8u, 16u)) & vec3<u32>(255u);
    // Devices need not divide 255 by itself exactly.
    if (!is_color) { return select(vec3<f32>(codes) / 255.0, vec3<f32>(1.0), codes == vec3<u32>(255u)); }
    return vec3<f32>(headtail_number(HEADTAIL_SRGB + codes.x), headtail_number(HEADTAIL_SRGB + codes.y), headtail_number(HEADTAIL_SRGB + codes.z));
}

fn headtail_textured(texture: u32, uv: vec2<f32>, is_color: bool) -> vec3<f32> {
    let size = vec2<f32>(f32(headtail_surfaces[texture]), f32(headtail_surfaces[texture + 1u]));
    // Beyond 2^30 texels, numbers have no fractions of texels anyway.
    let place = clamp(uv * size, vec2<f32>(-1073741824.0), vec2<f32>(1073741824.0));
    if ((headtail_surfaces[texture + 2u] & 16u) != 0u) {
        return headtail_texel_of(texture, i32(floor(place.x)), i32(floor(place.y)), is_color);
    }
    let corner = floor(place - 0.5);
    let inside = place - 0.5 - corner;
    let x = i32(corner.x);
    let y = i32(corner.y);
    let upper = headtail_lerp(headtail_texel_of(texture, x, y, is_color), headtail_texel_of(texture, x + 1, y, is_color), inside.x);
    let lower = headtail_lerp(headtail_texel_of(texture, x, y + 1, is_color), headtail_texel_of(texture, x + 1, y + 1, is_color), inside.x);
    return headtail_lerp(upper, lower, inside.y);
}

// Exact between equal values, so that an alpha of 1 passes a cutoff of 1.
fn headtail_lerp(a: vec3<f32>, b: vec3<f32>, t: f32) -> vec3<f32> {
    return a + t * (b - a);
}

// Whether a point of a face passes the test of its mask: cutoff, factor and texture.
fn headtail_is_opaque(number: u32, weights: vec3<f32>) -> bool {
    let face = HEADTAIL_FACES + HEADTAIL_OF_FACE * number;
    let mask = headtail_surfaces[face + 8u];
    let uv = headtail_surfaces[face + 2u];
    var alpha = headtail_number(mask + 1u);
    if (headtail_surfaces[mask + 2u] != HEADTAIL_NONE && uv != HEADTAIL_NONE) {
        alpha *= headtail_textured(headtail_surfaces[mask + 2u], headtail_uv(uv, weights), false).x;
    }
    let alphas = headtail_surfaces[face + 9u];
    if (alphas != HEADTAIL_NONE) {
        let corners = headtail_vector(alphas);
        alpha *= corners.x + weights.y * (corners.y - corners.x) + weights.z * (corners.z - corners.x);
    }
    return min(alpha, 1.0) >= headtail_number(mask);
}

// A unit vector, or the other one where the first has hardly any length.
fn headtail_unit_or(v: vec3<f32>, other: vec3<f32>) -> vec3<f32> {
    let squared = dot(v, v);
    return select(other, v * inverseSqrt(max(squared, HEADTAIL_TINY)), squared > HEADTAIL_TINY);
}

// The interpolated normal on the viewer's side, bent towards the viewer where it faces away.
fn headtail_shading_normal(interpolated: vec3<f32>, ng: vec3<f32>, wo: vec3<f32>) -> vec3<f32> {
    var ns = headtail_unit_or(interpolated, ng);
    if (dot(ns, ng) < 0.0) { ns = -ns; }
    let cosine = dot(ns, wo);
    if (cosine >= HEADTAIL_MIN_COSINE) { return ns; }
    let bent = headtail_unit_or(ns + (HEADTAIL_MIN_COSINE - cosine) * wo, ng);
    return select(ng, bent, dot(bent, wo) > 0.0 && dot(bent, ng) > 0.0);
}

// The directions in a triangle in which texture coordinates grow, of any length, and twice its area in these.
struct HeadtailUvAxes { u: vec3<f32>, v: vec3<f32>, area: f32 }

fn headtail_uv_axes(corners: array<vec3<f32>, 3>, at: u32) -> HeadtailUvAxes {
    let a = corners[1] - corners[0];
    let b = corners[2] - corners[0];
    let s = headtail_corner_uv(at, 1u) - headtail_corner_uv(at, 0u);
    let t = headtail_corner_uv(at, 2u) - headtail_corner_uv(at, 0u);
    let area = s.x * t.y - s.y * t.x;
    let side = select(1.0, -1.0, area < 0.0);
    return HeadtailUvAxes(side * (a * t.y - b * s.y), side * (b * s.x - a * t.x), abs(area));
}

// The tangent of a triangle: where u grows, and the handedness of the bitangent.
fn headtail_tangent_of(corners: array<vec3<f32>, 3>, at: u32, normal: vec3<f32>) -> vec4<f32> {
    let axes = headtail_uv_axes(corners, at);
    let handedness = -dot(cross(normal, axes.u), axes.v);
    return vec4<f32>(headtail_unit_or(axes.u, vec3<f32>(0.0)), select(1.0, -1.0, handedness < 0.0));
}

// The normal of a normal map: `texture` and `scale` of the material; `normal` is the unit normal of the outside.
fn headtail_bent(normal: vec3<f32>, tangent: vec4<f32>, texture: u32, scale: f32, uv: vec2<f32>) -> vec3<f32> {
    let along = headtail_unit_or(tangent.xyz - dot(tangent.xyz, normal) * normal, vec3<f32>(0.0));
    if (all(along == vec3<f32>(0.0))) { return normal; }
    let across = cross(normal, along) * select(1.0, -1.0, tangent.w < 0.0);
    let texel = 2.0 * headtail_textured(texture, uv, false) - 1.0;
    return headtail_unit_or(scale * (texel.x * along + texel.y * across) + max(texel.z, 0.0) * normal, normal);
}

// The shading point of a hit; rays of neighbouring pixels are `spread` radians apart.
fn headtail_surface(ray: HeadtailRay, hit: HeadtailHit, spread: f32) -> HeadtailPoint {
    var at: HeadtailPoint;
    let first = headtail_geometry[hit.triangle];
    let second = headtail_geometry[hit.triangle + 1u];
    let third = headtail_geometry[hit.triangle + 2u];
    let corners = array<vec3<f32>, 3>(first.xyz, second.xyz, third.xyz);
    let weights = vec3<f32>(1.0 - hit.u - hit.v, hit.u, hit.v);
    let face = HEADTAIL_FACES + HEADTAIL_OF_FACE * bitcast<u32>(first.w);
    let material = HEADTAIL_MATERIALS + 16u * headtail_surfaces[face];
    at.wo = -ray.direction;
    let wound = normalize(cross(corners[1] - corners[0], corners[2] - corners[0]));
    at.ng = select(wound, -wound, dot(wound, at.wo) < 0.0);
    let reaches = max(max(abs(first.xyz), abs(second.xyz)), abs(third.xyz));
    let reach = max(max(reaches.x, reaches.y), reaches.z);
    let offset = select(HEADTAIL_OFFSET, 2.0 * HEADTAIL_OFFSET, (bitcast<u32>(second.w) & HEADTAIL_COPIED) != 0u);
    at.p = weights.x * corners[0] + weights.y * corners[1] + weights.z * corners[2] + (offset * reach) * at.ng;

    let normals = headtail_surfaces[face + 1u];
    var outside = wound;
    if (normals != HEADTAIL_NONE) { outside = headtail_between(normals, weights); }
    let smooth_normal = select(outside, at.ng, normals == HEADTAIL_NONE);
    var bent = smooth_normal;
    let map_uv = headtail_surfaces[face + 5u];
    let map = headtail_surfaces[material + 12u];
    if (map != HEADTAIL_NONE && map_uv != HEADTAIL_NONE && dot(outside, outside) > HEADTAIL_TINY) {
        outside = normalize(outside);
        let tangents = headtail_surfaces[face + 6u];
        var tangent = vec4<f32>(0.0);
        if (tangents == HEADTAIL_NONE) {
            tangent = headtail_tangent_of(corners, map_uv, outside);
        } else {
            for (var k = 0u; k < 3u; k++) {
                tangent += weights[k] * vec4<f32>(headtail_vector(tangents + 4u * k), headtail_number(tangents + 4u * k + 3u));
            }
        }
        let of_map = headtail_bent(outside, tangent, map, headtail_number(material + 13u), headtail_uv(map_uv, weights));
        let toward = select(of_map, -of_map, dot(outside, at.ng) < 0.0);
        bent = select(smooth_normal, toward, dot(toward, at.ng) > 0.0);
    }
    at.ns = headtail_shading_normal(bent, at.ng, at.wo);
    if (HEADTAIL_HAS_FITTED && headtail_surfaces[material] >= HEADTAIL_FITTED) {
        let uv = headtail_surfaces[face + 2u];
        // Measured materials need no coordinates.
        if (uv == HEADTAIL_NONE) { return headtail_fitted_point(at, material, vec3<f32>(0.0), HeadtailUvAxes()); }
        let axes = headtail_uv_axes(corners, uv);
        let size = cross(corners[1] - corners[0], corners[2] - corners[0]);
        let width = spread * hit.t * sqrt(axes.area / length(size)) / sqrt(12.0 * max(dot(at.ns, at.wo), 1e-2));
        let tile = vec3<f32>(headtail_uv(uv, weights), select(0.0, width, width < HEADTAIL_FAR));
        return headtail_fitted_point(at, material, tile, axes);
    }
    return headtail_material(at, material, face, weights);
}

// Completes a point by its material.
fn headtail_material(given: HeadtailPoint, material: u32, face: u32, weights: vec3<f32>) -> HeadtailPoint {
    var at = given;
    let kind = headtail_surfaces[material];
    var color = headtail_vector(material + 1u);
    at.is_layered = false;
    at.left = 1.0;
    at.diffuse = vec3<f32>(0.0);
    at.f0 = vec3<f32>(0.0);
    at.alpha = 1.0;
    if (kind == HEADTAIL_DIFFUSE) {
        at.diffuse = color;
        at.specular_weight = 0.0;
        at.lobes = vec4<f32>(1.0, 0.0, 1.0, 1.0);
        return at;
    }
    if (kind == HEADTAIL_MIRROR) {
        // Waves over the scene, in turns: see `AlphaField`.
        let q = (at.p - headtail_vector(material + 4u)) * headtail_number(material + 7u);
        let waves = headtail_cos_sin_turns(dot(q, vec3<f32>(3.0, 1.0, 2.0))).y + headtail_cos_sin_turns(dot(q, vec3<f32>(-1.0, 2.0, 3.0))).y;
        let range = vec2<f32>(headtail_number(material + 8u), headtail_number(material + 9u));
        at.alpha = clamp(range.x + (range.y - range.x) * clamp(0.5 + 0.25 * waves, 0.0, 1.0), HEADTAIL_MIN_ALPHA, 1.0);
        at.f0 = color;
        at.specular_weight = 1.0;
        at.lobes = vec4<f32>(0.0, 1.0, headtail_luminance(color), at.alpha);
        return at;
    }
    let color_uv = headtail_surfaces[face + 2u];
    let color_map = headtail_surfaces[material + 10u];
    if (color_map != HEADTAIL_NONE && color_uv != HEADTAIL_NONE) { color *= headtail_textured(color_map, headtail_uv(color_uv, weights), true); }
    let colors = headtail_surfaces[face + 7u];
    if (colors != HEADTAIL_NONE) { color *= headtail_between(colors, weights); }
    color = clamp(color, vec3<f32>(0.0), vec3<f32>(1.0));
    var factors = vec2<f32>(headtail_number(material + 4u), headtail_number(material + 5u));
    let factor_uv = headtail_surfaces[face + 3u];
    let factor_map = headtail_surfaces[material + 11u];
    if (factor_map != HEADTAIL_NONE && factor_uv != HEADTAIL_NONE) { factors *= headtail_textured(factor_map, headtail_uv(factor_uv, weights), false).zy; }
    factors = clamp(factors, vec2<f32>(0.0), vec2<f32>(1.0));
    at.diffuse = color * (1.0 - factors.x);
    at.f0 = vec3<f32>(HEADTAIL_DIELECTRIC * (1.0 - factors.x)) + color * factors.x;
    at.alpha = max(factors.y * factors.y, HEADTAIL_MIN_ALPHA);
    return headtail_layered(at);
}

// The radiance that a surface emits.
fn headtail_emitted(hit: HeadtailHit) -> vec3<f32> {
    let face = HEADTAIL_FACES + HEADTAIL_OF_FACE * bitcast<u32>(headtail_geometry[hit.triangle].w);
    let material = HEADTAIL_MATERIALS + 16u * headtail_surfaces[face];
    let emission = headtail_surfaces[material + 14u];
    if (emission == HEADTAIL_NONE) { return vec3<f32>(0.0); }
    var light = headtail_vector(emission);
    let texture = headtail_surfaces[emission + 3u];
    let uv = headtail_surfaces[face + 4u];
    if (texture != HEADTAIL_NONE && uv != HEADTAIL_NONE) {
        light *= headtail_textured(texture, headtail_uv(uv, vec3<f32>(1.0 - hit.u - hit.v, hit.u, hit.v)), true);
    }
    return light;
}
