// The surfaces of a batch's conditions: diffuse ones, where alpha is 0, and microfacets.

struct Surface { n: vec3<f32>, wo: vec3<f32>, alpha: f32 }

fn surface_of(condition: u32) -> Surface {
    // Diffuse surfaces are told of the normal alone, others of the view direction first.
    let first = condition_vector(0u, condition);
    if (IS_GLOSSY == 0u) { return Surface(first, first, 0.0); }
    var alpha = ALPHA;
    if (HAS_ALPHA == 1u) { alpha = condition_number(10u, condition); }
    return Surface(condition_vector(3u, condition), first, clamp(alpha, 1e-3, 1.0));
}

// Lobes as patches take them. Of microfacets with F = 1, the reflectance at normal incidence is 1.
fn surface_lobes(at: Surface) -> vec4<f32> {
    return select(vec4<f32>(1.0, 0.0, 1.0, 1.0), vec4<f32>(0.0, 1.0, 1.0, at.alpha), at.alpha > 0.0);
}

// BRDF x cosine, up to a factor.
fn surface_reflected(at: Surface, wi: vec3<f32>) -> f32 {
    return headtail_lobe(at.n, at.wo, wi, at.alpha);
}

// The solid-angle pdf of BRDF sampling.
fn surface_pdf(at: Surface, wi: vec3<f32>) -> f32 {
    return headtail_brdf_pdf(at.n, at.wo, wi, at.alpha);
}

// A direction by BRDF sampling; it may be below the horizon, where the pdf is 0.
fn surface_draw(at: Surface, u: vec2<f32>) -> vec3<f32> {
    return headtail_brdf_sample(at.n, at.wo, at.alpha, u);
}
