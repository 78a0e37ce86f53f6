// Camera rays, and the nearest or any triangle along a ray, through a binary hierarchy.
//
// A node has four vectors: the box of its first child (least corner and the child's word, greatest corner), then that of its second. A child's word
// is its node, or with bit 31 a leaf: its number of triangles in bits 24 to 30, its first triangle below. A triangle has three vectors, its corners,
// with its face and its flags beside the first two.

@group(0) @binding(2) var<storage, read> headtail_geometry: array<vec4<f32>>;

const HEADTAIL_NONE: u32 = 0xffffffffu;
const HEADTAIL_FAR: f32 = 3e38;
const HEADTAIL_OFFSET: f32 = 1e-6;
const HEADTAIL_SINGLE_SIDED: u32 = 1u;
const HEADTAIL_MASKED: u32 = 4u;

struct HeadtailRay { origin: vec3<f32>, direction: vec3<f32> }

// The barycentric coordinates are those of the second and the third corner; `triangle` is the place of its corners.
struct HeadtailHit { t: f32, u: f32, v: f32, triangle: u32 }

// What a ray is traced for.
struct HeadtailQuestion { is_camera: bool, is_any: bool }

fn headtail_camera_ray(at: vec2<f32>) -> HeadtailRay {
    let size = vec2<f32>(headtail_view.size.xy);
    let half_height = headtail_view.look_from.w;
    let pixel = 2.0 * half_height / size.y;
    let right = (at.x - 0.5 * size.x) * pixel - half_height * headtail_view.right.w;
    let up = (0.5 * size.y - at.y) * pixel - half_height * headtail_view.up.w;
    let aside = right * headtail_view.right.xyz + up * headtail_view.up.xyz;
    if (headtail_view.forward.w == 1.0) { return HeadtailRay(headtail_view.look_from.xyz + aside, headtail_view.forward.xyz); }
    return HeadtailRay(headtail_view.look_from.xyz, normalize(headtail_view.forward.xyz + aside));
}

// The angle between neighbouring pixels in the middle of the image; 0 for parallel rays.
fn headtail_pixel_spread() -> f32 {
    return select(2.0 * headtail_view.look_from.w / f32(headtail_view.size.y), 0.0, headtail_view.forward.w == 1.0);
}

// The ray that leaves a surface at p.
fn headtail_leaving(p: vec3<f32>, ng: vec3<f32>, wi: vec3<f32>) -> HeadtailRay {
    let reach = max(max(abs(p.x), abs(p.y)), abs(p.z));
    return HeadtailRay(p + (HEADTAIL_OFFSET * reach) * ng, wi);
}

// Distance to a box; far away if the ray misses it before `end`.
fn headtail_box(least: vec3<f32>, greatest: vec3<f32>, origin: vec3<f32>, inverse: vec3<f32>, end: f32) -> f32 {
    let a = (least - origin) * inverse;
    let b = (greatest - origin) * inverse;
    let low = min(a, b);
    let high = max(a, b);
    let near = max(max(low.x, low.y), max(low.z, 0.0));
    // Rounding moves each end by a few units in the last place: devices divide less exactly than CPUs.
    let far = min(min(high.x, high.y), min(high.z, end)) * 1.000001;
    return select(HEADTAIL_FAR, near, near <= far);
}

// The hit of a triangle if it is nearer than `hit`, by the operations of `meet` in headtail-render's `probe.rs`. It is no nearer than the box that the
// triangle is in; of triangles at the same distance, coincident ones, the first in the scene is hit.
fn headtail_triangle(at: u32, enters: f32, ray: HeadtailRay, question: HeadtailQuestion, hit: HeadtailHit) -> HeadtailHit {
    let first = headtail_geometry[at];
    let second = headtail_geometry[at + 1u];
    let edge_1 = first.xyz - second.xyz;
    let edge_2 = headtail_geometry[at + 2u].xyz - first.xyz;
    let normal = cross(edge_1, edge_2);
    let c = first.xyz - ray.origin;
    let r = cross(ray.direction, c);
    let inverse = 1.0 / dot(normal, ray.direction);
    let u = dot(edge_2, r) * inverse;
    let v = dot(edge_1, r) * inverse;
    let exact = dot(normal, c) * inverse;
    let t = max(exact, enters);
    if (!(u >= 0.0 && v >= 0.0 && 1.0 - u - v >= 0.0 && exact >= 0.0 && t <= hit.t)) { return hit; }
    if (t == hit.t && bitcast<u32>(headtail_geometry[hit.triangle].w) <= bitcast<u32>(first.w)) { return hit; }
    if (question.is_camera && inverse < 0.0 && (bitcast<u32>(second.w) & HEADTAIL_SINGLE_SIDED) != 0u) { return hit; }
    let is_masked = (bitcast<u32>(second.w) & HEADTAIL_MASKED) != 0u;
    if (is_masked && !headtail_is_opaque(bitcast<u32>(first.w), vec3<f32>(1.0 - u - v, u, v))) { return hit; }
    return HeadtailHit(t, u, v, at);
}

fn headtail_trace(ray: HeadtailRay, question: HeadtailQuestion) -> HeadtailHit {
    var hit = HeadtailHit(HEADTAIL_FAR, 0.0, 0.0, HEADTAIL_NONE);
    if (HEADTAIL_ROOT == HEADTAIL_NONE) { return hit; }
    // Without infinities, whose products devices may round to anything.
    let steep = abs(ray.direction) < vec3<f32>(1e-20);
    let inverse = 1.0 / select(ray.direction, vec3<f32>(1e-20), steep);
    // Nodes that wait, and where the ray enters their boxes.
    var stack: array<vec2<u32>, HEADTAIL_STACK>;
    var height = 0u;
    var current = HEADTAIL_ROOT;
    var enters = 0.0;
    loop {
        var next = HEADTAIL_NONE;
        if ((current & 0x80000000u) != 0u) {
            let count = (current >> 24u) & 0x7fu;
            let first = current & 0xffffffu;
            for (var k = 0u; k < count; k++) {
                hit = headtail_triangle(HEADTAIL_TRIANGLES + 3u * (first + k), enters, ray, question, hit);
            }
            if (question.is_any && hit.triangle != HEADTAIL_NONE) { return hit; }
        } else {
            let a = headtail_geometry[4u * current];
            let b = headtail_geometry[4u * current + 1u];
            let c = headtail_geometry[4u * current + 2u];
            let d = headtail_geometry[4u * current + 3u];
            let first = headtail_box(a.xyz, b.xyz, ray.origin, inverse, hit.t);
            let second = headtail_box(c.xyz, d.xyz, ray.origin, inverse, hit.t);
            let is_second_nearer = second < first;
            let nearer = select(bitcast<u32>(a.w), bitcast<u32>(c.w), is_second_nearer);
            let farther = select(bitcast<u32>(c.w), bitcast<u32>(a.w), is_second_nearer);
            enters = min(first, second);
            if (enters < HEADTAIL_FAR) {
                next = nearer;
                if (max(first, second) < HEADTAIL_FAR) {
                    stack[height] = vec2<u32>(farther, bitcast<u32>(max(first, second)));
                    height += 1u;
                }
            }
        }
        while (next == HEADTAIL_NONE && height > 0u) {
            height -= 1u;
            let last = stack[height];
            enters = bitcast<f32>(last.y);
            if (enters <= hit.t) { next = last.x; }
        }
        if (next == HEADTAIL_NONE) { break; }
        current = next;
    }
    return hit;
}
