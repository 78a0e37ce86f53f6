// The points of a batch and the target there: strata of Y and BRDF samples, weighted by the balance heuristic, as in
// `headtail_train::Batch`. One thread per point. Numbers of the batch are in the order that `loss.wgsl` reads.

@group(0) @binding(2) var<storage, read_write> batch: array<f32>;
@group(0) @binding(3) var<storage, read_write> arena: array<f32>;

const MAX_BRDF_DENSITY: f32 = 1e12;

fn condition_number(row: u32, condition: u32) -> f32 {
    return arena[CONDITIONS + row * CONDITION_STRIDE + condition];
}

fn condition_vector(row: u32, condition: u32) -> vec3<f32> {
    return vec3<f32>(condition_number(row, condition), condition_number(row + 1u, condition), condition_number(row + 2u, condition));
}

@compute @workgroup_size(64)
fn place_targets(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let place = id.y * groups.x * 64u + id.x;
    if (place >= POINTS) { return; }
    let condition = place / SAMPLES;
    let index = place % SAMPLES;
    // Diffuse surfaces are told of the normal alone, others of the view direction first.
    var n = condition_vector(0u, condition);
    let wo = n;
    var alpha = 0.0;
    if (IS_GLOSSY == 1u) {
        n = condition_vector(3u, condition);
        alpha = ALPHA;
        if (HAS_ALPHA == 1u) { alpha = condition_number(10u, condition); }
        alpha = clamp(alpha, 1e-3, 1.0);
    }
    let u = uniform_point(condition, index);
    var y = (vec2<f32>(f32(index % STRATA), f32(index / STRATA)) + u) / f32(STRATA);
    var is_there = true;
    if (index >= STRATA * STRATA) {
        let turn = (f32(index - STRATA * STRATA) + u.x) / f32(BRDF_SAMPLES);
        let wi = headtail_brdf_sample(n, wo, alpha, vec2<f32>(turn, u.y));
        let back = headtail_pull_back(headtail_square(wi).xy);
        is_there = headtail_brdf_pdf(n, wo, wi, alpha) > 0.0 && back.z > 0.0;
        y = select(vec2<f32>(0.5), clamp(back.xy, vec2<f32>(0.0), vec2<f32>(HEADTAIL_BELOW_ONE)), is_there);
    }
    batch[2u * place] = y.x;
    batch[2u * place + 1u] = y.y;
    var density = 0.0;
    var weight = 0.0;
    var brdf = 0.0;
    var tail = 1.0;
    if (is_there) {
        let x = headtail_tail(y);
        let wi = headtail_direction(x.xy);
        let pdf = headtail_brdf_pdf(n, wo, wi.xyz, alpha);
        if (pdf > 0.0) { brdf = min(pdf / (wi.w * x.z), MAX_BRDF_DENSITY); }
        density = headtail_lobe(n, wo, wi.xyz, alpha);
        tail = x.z;
        weight = f32(SAMPLES) / (f32(STRATA * STRATA) + f32(BRDF_SAMPLES) * brdf);
    }
    batch[2u * POINTS + place] = density;
    batch[3u * POINTS + place] = weight;
    batch[4u * POINTS + place] = brdf;
    batch[5u * POINTS + place] = tail;
}
