// Measured materials (Sztrajman et al. 2021): a network of half and difference vector, and a mixture of a cosine lobe and three
// Trowbridge-Reitz lobes, whose weights depend on the cosine of `wo`.

const HEADTAIL_SMALLEST_SQUARED_SINE: f32 = 1e-13;
const HEADTAIL_MIXTURE_NODES: u32 = 16u;
const HEADTAIL_MEASURED_LATENTS: u32 = 99u;
const HEADTAIL_MEASURED_NETWORK: u32 = 105u;

// The weights of the cosine lobe and of the others.
var<private> headtail_techniques: vec4<f32>;

// Finds them; returns the closest approximation by two lobes, as `headtail_sample` takes it.
fn headtail_measured_lobes(n: vec3<f32>, wo: vec3<f32>) -> vec4<f32> {
    let place = sqrt(clamp(dot(n, wo), 0.0, 1.0)) * f32(HEADTAIL_MIXTURE_NODES - 1u);
    let node = min(u32(place), HEADTAIL_MIXTURE_NODES - 2u);
    let inside = place - f32(node);
    let near = headtail_fitted + 3u + 6u * node;
    headtail_techniques = mix(headtail_four_numbers(near), headtail_four_numbers(near + 6u), inside);
    let weight = mix(headtail_number(near + 4u), headtail_number(near + 10u), inside);
    return vec4<f32>(1.0 - weight, weight, 1.0, mix(headtail_number(near + 5u), headtail_number(near + 11u), inside));
}

fn headtail_measured_reflected(n: vec3<f32>, wo: vec3<f32>, wi: vec3<f32>) -> vec3<f32> {
    let h = headtail_unit(wo + wi);
    var across = cross(n, h);
    let squared_sine = dot(across, across);
    // A half vector without azimuth takes that of `wi`.
    if (!(squared_sine > HEADTAIL_SMALLEST_SQUARED_SINE)) { across = cross(n, wi); }
    let y = headtail_unit(across);
    let x = cross(y, n);
    let cosine = dot(n, h);
    let sine = sqrt(squared_sine);
    headtail_fitted_units[0] = sine;
    headtail_fitted_units[1] = 0.0;
    headtail_fitted_units[2] = cosine;
    headtail_fitted_units[3] = cosine * dot(x, wi) - sine * dot(n, wi);
    headtail_fitted_units[4] = dot(y, wi);
    headtail_fitted_units[5] = dot(h, wi);
    let logs = headtail_three_units(headtail_fitted_network(headtail_fitted + HEADTAIL_MEASURED_NETWORK));
    return dot(n, wi) * max(exp(logs) - 1.0, vec3<f32>(0.0));
}

fn headtail_measured_pdf(n: vec3<f32>, wo: vec3<f32>, wi: vec3<f32>) -> f32 {
    var pdf = headtail_techniques.x * HEADTAIL_INVERSE_PI * dot(n, wi);
    for (var k = 0u; k < 3u; k++) {
        pdf += headtail_techniques[k + 1u] * headtail_brdf_pdf(n, wo, wi, headtail_number(headtail_fitted + k));
    }
    return pdf;
}

fn headtail_measured_draw(n: vec3<f32>, wo: vec3<f32>, u: vec2<f32>) -> vec3<f32> {
    // The technique whose part of the unit interval contains u.x.
    var bounds = vec2<f32>(0.0, headtail_techniques.x);
    var alpha = 0.0;
    var sum = headtail_techniques.x;
    for (var k = 0u; k < 3u; k++) {
        let own = headtail_techniques[k + 1u];
        if (u.x >= sum && own > 0.0) {
            bounds = vec2<f32>(sum, sum + own);
            alpha = headtail_number(headtail_fitted + k);
        }
        sum += own;
    }
    return headtail_brdf_sample(n, wo, alpha, vec2<f32>(headtail_remap(u.x, bounds.x, bounds.y), u.y));
}
