// The surfaces of a batch's conditions: measured or neural materials. The list of these begins with their number and the place of each in the list.

// Conditions without a material are those of diffuse surfaces beside a neural one.
struct Surface { n: vec3<f32>, wo: vec3<f32>, lobes: vec4<f32>, is_diffuse: bool }

fn headtail_number(at: u32) -> f32 {
    return headtail_float(HEADTAIL_MATERIAL_NUMBERS + at);
}

// Whether the condition names this one of several measured materials, by its latents.
fn is_material_of(condition: u32, place: u32) -> bool {
    for (var k = 0u; k < 6u; k++) {
        if (condition_number(10u + k, condition) != headtail_number(place + HEADTAIL_MEASURED_LATENTS + k)) { return false; }
    }
    return true;
}

fn surface_of(condition: u32) -> Surface {
    let wo = condition_vector(0u, condition);
    let n = condition_vector(3u, condition);
    headtail_is_neural = IS_NEURAL == 1u;
    headtail_fitted = u32(headtail_number(1u));
    if (!headtail_is_neural) {
        let count = u32(headtail_number(0u));
        for (var k = 2u; k <= count; k++) {
            let place = u32(headtail_number(k));
            if (is_material_of(condition, place)) {
                headtail_fitted = place;
                break;
            }
        }
        return Surface(n, wo, headtail_measured_lobes(n, wo), false);
    }
    let hand = condition_number(21u, condition);
    if (hand == 0.0) { return Surface(n, wo, vec4<f32>(1.0, 0.0, 1.0, 1.0), true); }
    for (var k = 0u; k < 8u; k++) { headtail_features[k / 4u][k & 3u] = condition_number(10u + k, condition); }
    headtail_look_at_texture(n, condition_vector(18u, condition), hand, wo);
    return Surface(n, wo, headtail_neural_lobes(), false);
}

fn surface_lobes(at: Surface) -> vec4<f32> {
    return at.lobes;
}

// The luminance of BRDF x cosine.
fn surface_reflected(at: Surface, wi: vec3<f32>) -> f32 {
    if (at.is_diffuse) { return HEADTAIL_INVERSE_PI * max(dot(at.n, wi), 0.0); }
    return dot(headtail_fitted_reflected(at.n, at.wo, wi), vec3<f32>(0.2126, 0.7152, 0.0722));
}

fn surface_pdf(at: Surface, wi: vec3<f32>) -> f32 {
    if (at.is_diffuse) { return HEADTAIL_INVERSE_PI * max(dot(at.n, wi), 0.0); }
    return headtail_fitted_pdf(at.n, at.wo, wi);
}

fn surface_draw(at: Surface, u: vec2<f32>) -> vec3<f32> {
    if (at.is_diffuse) { return headtail_brdf_sample(at.n, at.wo, 0.0, u); }
    return headtail_fitted_draw(at.n, at.wo, u);
}
