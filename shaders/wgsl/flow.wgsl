// The flow tail: a smooth warp of the square as a table, bilinear in each cell.

// The image p + s e + t f + s t g of a cell of Y.
struct HeadtailQuad { p: vec2<f32>, e: vec2<f32>, f: vec2<f32>, g: vec2<f32> }

fn headtail_quad(index: u32) -> HeadtailQuad {
    let a = headtail_four(HEADTAIL_TAIL_CELLS, 2u * index);
    let b = headtail_four(HEADTAIL_TAIL_CELLS, 2u * index + 1u);
    return HeadtailQuad(a.xy, a.zw, b.xy, b.zw);
}

fn headtail_cross(a: vec2<f32>, b: vec2<f32>) -> f32 {
    return a.x * b.y - a.y * b.x;
}

// |dy/dx| at a position in a cell.
fn headtail_quad_density(q: HeadtailQuad, st: vec2<f32>) -> f32 {
    let area = headtail_cross(q.e, q.f) + st.x * headtail_cross(q.e, q.g) + st.y * headtail_cross(q.g, q.f);
    return 1.0 / (area * f32(HEADTAIL_SIDE * HEADTAIL_SIDE));
}

// x of a point y of Y, and the density |dy/dx| there.
fn headtail_tail(y: vec2<f32>) -> vec3<f32> {
    let at = clamp(y, vec2<f32>(0.0), vec2<f32>(HEADTAIL_BELOW_ONE)) * f32(HEADTAIL_SIDE);
    let place = vec2<u32>(at);
    let st = at - vec2<f32>(place);
    let q = headtail_quad(place.y * HEADTAIL_SIDE + place.x);
    let x = q.p + st.x * q.e + st.y * q.f + st.x * st.y * q.g;
    let u = x.x - floor(x.x);
    return vec3<f32>(select(u, 0.0, u >= 1.0), clamp(x.y, 0.0, 1.0), headtail_quad_density(q, st));
}

// One root of the quadratic: (s, t), and how far outside the unit square that is.
fn headtail_candidate(q: HeadtailQuad, h: vec2<f32>, t: f32) -> vec3<f32> {
    let along = q.e + t * q.g;
    let squared = dot(along, along);
    // What is no number is infinitely far outside; large numbers are kept finite, as comparisons of others are not promised.
    if (!(abs(t) < 1e6) || !(squared > 0.0)) { return vec3<f32>(0.5, 0.5, 1e30); }
    let s = dot(h - t * q.f, along) / squared;
    if (!(abs(s) < 1e6)) { return vec3<f32>(0.5, 0.5, 1e30); }
    return vec3<f32>(s, t, max(max(max(-s, s - 1.0), max(-t, t - 1.0)), 0.0));
}

fn headtail_invert_quad(q: HeadtailQuad, x: vec2<f32>) -> vec3<f32> {
    // (h - t f) x (e + t g) = 0.
    let h = x - q.p;
    let a = headtail_cross(q.g, q.f);
    let b = headtail_cross(h, q.g) + headtail_cross(q.e, q.f);
    let c = headtail_cross(h, q.e);
    let root = sqrt(max(b * b - 4.0 * a * c, 0.0));
    let sum = -0.5 * (b + select(root, -root, b < 0.0));
    var first = vec3<f32>(0.5, 0.5, 1e30);
    var second = first;
    if (sum != 0.0) { first = headtail_candidate(q, h, c / sum); }
    if (a != 0.0) { second = headtail_candidate(q, h, sum / a); }
    if (first.z <= second.z) { return first; }
    return second;
}

// y of a point of X, and |dy/dx| there: down the tree of bounding boxes, to the cell that the point is least outside of.
fn headtail_pull_back(x: vec2<f32>) -> vec3<f32> {
    let root = headtail_four(HEADTAIL_TAIL_BOXES, 0u);
    var index = 0u;
    var best = vec3<f32>(0.5, 0.5, 1e30);
    // Three siblings wait at each of at most ten levels: (level, column, row).
    var waiting: array<vec3<u32>, 48>;
    for (var turn = ceil(root.x - x.x); x.x + turn <= root.z && best.z > 0.0; turn += 1.0) {
        let at = vec2<f32>(x.x + turn, x.y);
        waiting[0] = vec3<u32>(0u, 0u, 0u);
        var count = 1u;
        while (count > 0u && best.z > 0.0) {
            count -= 1u;
            let place = waiting[count];
            let side = 1u << place.x;
            // Levels before this one have (4^level - 1) / 3 boxes.
            let bounds = headtail_four(HEADTAIL_TAIL_BOXES, (side * side - 1u) / 3u + place.z * side + place.y);
            if (!(at.x >= bounds.x && at.x <= bounds.z && at.y >= bounds.y && at.y <= bounds.w)) { continue; }
            if (side == HEADTAIL_SIDE) {
                let own = place.z * side + place.y;
                let found = headtail_invert_quad(headtail_quad(own), at);
                if (found.z < best.z) {
                    best = found;
                    index = own;
                }
                continue;
            }
            for (var child = 0u; child < 4u; child++) {
                waiting[count] = vec3<u32>(place.x + 1u, 2u * place.y + (child & 1u), 2u * place.z + (child >> 1u));
                count += 1u;
            }
        }
    }
    let st = clamp(best.xy, vec2<f32>(0.0), vec2<f32>(1.0));
    let corner = vec2<f32>(f32(index % HEADTAIL_SIDE), f32(index / HEADTAIL_SIDE));
    let y = clamp((corner + st) / f32(HEADTAIL_SIDE), vec2<f32>(0.0), vec2<f32>(HEADTAIL_BELOW_ONE));
    return vec3<f32>(y, headtail_quad_density(headtail_quad(index), st));
}
