// The target at points, and its place in the batch. Numbers of the batch are in the order that `loss.wgsl`
// reads.

@group(0) @binding(2) var<storage, read_write> batch: array<f32>;
@group(0) @binding(3) var<storage, read_write> arena: array<f32>;

const MAX_BRDF_DENSITY: f32 = 1e12;

fn condition_number(row: u32, condition: u32) -> f32 {
    return arena[CONDITIONS + row * CONDITION_STRIDE + condition];
}

fn condition_vector(row: u32, condition: u32) -> vec3<f32> {
    return vec3<f32>(condition_number(row, condition), condition_number(row + 1u, condition), condition_number(row + 2u, condition));
}

// What is known at a point of the square of a head: the point of X that it is carried to, the density over X there, the target, and the density of
// BRDF sampling over the square.
struct Values { x: vec2<f32>, tail: f32, density: f32, brdf: f32 }

fn values_at(at: Surface, y: vec2<f32>) -> Values {
    let image = image_of(y);
    // Patches have no density here, because nothing is reflected from here.
    if (!(image.w > 0.0)) { return Values(image.xy, 1.0, 0.0, 0.0); }
    let wi = headtail_direction(image.xy);
    let pdf = surface_pdf(at, wi.xyz);
    var brdf = 0.0;
    if (pdf > 0.0) { brdf = min(pdf / (wi.w * image.z), MAX_BRDF_DENSITY); }
    return Values(image.xy, image.z, surface_reflected(at, wi.xyz) / image.w, brdf);
}

// Writes a point with a weight, one over the density of points: of the square, or of X.
fn store_point(place: u32, y: vec2<f32>, at: Values, weight: f32) {
    let there = select(y, at.x, IS_IN_X == 1u);
    let scale = select(1.0, at.tail, IS_IN_X == 1u);
    batch[2u * place] = there.x;
    batch[2u * place + 1u] = there.y;
    batch[2u * POINTS + place] = at.density * scale;
    batch[3u * POINTS + place] = weight / scale;
    batch[4u * POINTS + place] = at.brdf * scale;
    batch[5u * POINTS + place] = select(at.tail, 1.0, IS_IN_X == 1u);
}
