// Measured materials (Sztrajman et al. 2021): a network of half and difference vector, and a mixture of a cosine lobe and three
// Trowbridge-Reitz lobes, whose weights depend on the cosine of `wo`.

const HEADTAIL_SMALLEST_SQUARED_SINE: f32 = 1e-13;
const HEADTAIL_MIXTURE_NODES: u32 = 16u;
const HEADTAIL_MEASURED_NETWORK: u32 = 99u;

// The weights of the cosine lobe and of the others.
var<private> headtail_techniques: vec4<f32>;

fn headtail_measured_lobes(at: HeadtailPoint) -> vec4<f32> {
    let place = sqrt(clamp(dot(at.ns, at.wo), 0.0, 1.0)) * f32(HEADTAIL_MIXTURE_NODES - 1u);
    let node = min(u32(place), HEADTAIL_MIXTURE_NODES - 2u);
    let inside = place - f32(node);
    let near = headtail_fitted + 3u + 6u * node;
    headtail_techniques = mix(headtail_four_numbers(near), headtail_four_numbers(near + 6u), inside);
    let weight = mix(headtail_number(near + 4u), headtail_number(near + 10u), inside);
    return vec4<f32>(1.0 - weight, weight, 1.0, mix(headtail_number(near + 5u), headtail_number(near + 11u), inside));
}

fn headtail_measured_reflected(at: HeadtailPoint, wi: vec3<f32>) -> vec3<f32> {
    let h = headtail_unit(at.wo + wi);
    var across = cross(at.ns, h);
    let squared_sine = dot(across, across);
    // A half vector without azimuth takes that of `wi`.
    if (!(squared_sine > HEADTAIL_SMALLEST_SQUARED_SINE)) { across = cross(at.ns, wi); }
    let y = headtail_unit(across);
    let x = cross(y, at.ns);
    let cosine = dot(at.ns, h);
    let sine = sqrt(squared_sine);
    headtail_fitted_units[0] = sine;
    headtail_fitted_units[1] = 0.0;
    headtail_fitted_units[2] = cosine;
    headtail_fitted_units[3] = cosine * dot(x, wi) - sine * dot(at.ns, wi);
    headtail_fitted_units[4] = dot(y, wi);
    headtail_fitted_units[5] = dot(h, wi);
    let logs = headtail_three_units(headtail_fitted_network(headtail_fitted + HEADTAIL_MEASURED_NETWORK));
    return dot(at.ns, wi) * max(exp(logs) - 1.0, vec3<f32>(0.0));
}

fn headtail_measured_pdf(at: HeadtailPoint, wi: vec3<f32>) -> f32 {
    var pdf = headtail_techniques.x * HEADTAIL_INVERSE_PI * dot(at.ns, wi);
    for (var k = 0u; k < 3u; k++) {
        pdf += headtail_techniques[k + 1u] * headtail_brdf_pdf(at.ns, at.wo, wi, headtail_number(headtail_fitted + k));
    }
    return pdf;
}

fn headtail_measured_draw(at: HeadtailPoint, u: vec2<f32>) -> vec3<f32> {
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
    return headtail_brdf_sample(at.ns, at.wo, alpha, vec2<f32>(headtail_remap(u.x, bounds.x, bounds.y), u.y));
}
