// Points of a batch: strata of the square and BRDF samples, weighted by the balance heuristic, as in `headtail_train::Batch`. One thread per point.

@compute @workgroup_size(64)
fn place_strata(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let place = id.y * groups.x * 64u + id.x;
    if (place >= POINTS) { return; }
    let condition = place / SAMPLES;
    let index = place % SAMPLES;
    let at = surface_of(condition);
    prepare_square(at);
    let u = uniform_point(condition, index);
    var y = (vec2<f32>(f32(index % STRATA), f32(index / STRATA)) + u) / f32(STRATA);
    var is_there = true;
    if (index >= STRATA * STRATA) {
        let turn = (f32(index - STRATA * STRATA) + u.x) / f32(BRDF_SAMPLES);
        let wi = surface_draw(at, vec2<f32>(turn, u.y));
        let back = back_to_square(headtail_square(wi).xy);
        is_there = surface_pdf(at, wi) > 0.0 && back.z > 0.0;
        y = select(vec2<f32>(0.5), clamp(back.xy, vec2<f32>(0.0), vec2<f32>(HEADTAIL_BELOW_ONE)), is_there);
    }
    let values = values_at(at, y);
    if (is_there) {
        store_point(place, y, values, f32(SAMPLES) / (f32(STRATA * STRATA) + f32(BRDF_SAMPLES) * values.brdf));
    } else {
        store_point(place, y, Values(values.x, 1.0, 0.0, 0.0), 0.0);
    }
}
