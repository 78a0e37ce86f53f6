// The integrator: paths from the camera, with an estimate of the map's light at each surface.

// For each pixel of the part: light from surfaces and number of shadow rays; background and number of camera rays that hit; the largest
// luminance of a contribution before its shadow ray.
@group(0) @binding(5) var<storage, read_write> headtail_film: array<vec4<f32>>;

const HEADTAIL_ROULETTE_FROM: u32 = 3u;
const HEADTAIL_MOST_SURVIVAL: f32 = 0.95;
// The angle between rays after a bounce, for footprints on textures.
const HEADTAIL_BOUNCE_SPREAD: f32 = 0.05;

// A sum of contributions, their number, and the largest luminance.
struct HeadtailLight { sum: vec3<f32>, rays: f32, largest: f32 }

fn headtail_largest(v: vec3<f32>) -> f32 {
    return max(max(v.x, v.y), v.z);
}

// Adds light x BRDF x cosine x weight of a direction, if that is not blocked.
fn headtail_add(given: HeadtailLight, at: HeadtailPoint, wi: vec3<f32>, weight: vec3<f32>) -> HeadtailLight {
    let value = headtail_radiance(wi) * headtail_reflected(at, wi) * weight;
    if (!(headtail_largest(value) > 0.0)) { return given; }
    var light = HeadtailLight(given.sum, given.rays + 1.0, max(given.largest, headtail_luminance(value)));
    if (headtail_view.size.w == 1u || headtail_trace(headtail_leaving(at.p, at.ng, wi), HeadtailQuestion(false, true)).triangle == HEADTAIL_NONE) {
        light.sum += value;
    }
    return light;
}

@compute @workgroup_size(8, 8)
fn headtail_render(@builtin(global_invocation_id) place: vec3<u32>) {
    let inside = vec2<u32>(place.x, place.y + headtail_view.work.x);
    if (inside.x >= headtail_view.part.z || inside.y >= headtail_view.part.w) { return; }
    let pixel = headtail_view.part.xy + inside;
    let key = headtail_key(pixel);
    let depth = headtail_view.size.z;
    var light = HeadtailLight(vec3<f32>(0.0), 0.0, 0.0);
    var background = vec4<f32>(0.0);
    for (var sample = 0u; sample < headtail_view.work.y; sample++) {
        let first_group = sample * (1u + depth * (HEADTAIL_LIGHT_GROUPS + 1u));
        var ray = headtail_camera_ray(vec2<f32>(pixel) + headtail_numbers(first_group, key).xy);
        var throughput = vec3<f32>(1.0);
        for (var bounce = 0u; bounce < depth; bounce++) {
            let hit = headtail_trace(ray, HeadtailQuestion(bounce == 0u, false));
            if (hit.triangle == HEADTAIL_NONE) {
                // Beyond the first surface, the estimates cover all light from the map.
                if (bounce == 0u) { background += vec4<f32>(headtail_radiance(ray.direction), 0.0); }
                break;
            }
            let at = headtail_surface(ray, hit, select(HEADTAIL_BOUNCE_SPREAD, headtail_pixel_spread(), bounce == 0u));
            let own = first_group + 1u + bounce * (HEADTAIL_LIGHT_GROUPS + 1u);
            let estimate = headtail_estimate(at, throughput, own, key);
            if (bounce == 0u) { background.w += 1.0; }
            if (HEADTAIL_IS_EMISSIVE) { light.sum += throughput * headtail_emitted(hit); }
            light = HeadtailLight(light.sum + estimate.sum, light.rays + estimate.rays, max(light.largest, estimate.largest));
            if (bounce + 1u == depth) { break; }
            let u = headtail_numbers(own + HEADTAIL_LIGHT_GROUPS, key);
            let drawn = headtail_bsdf_sample(at, u.xy);
            if (!(drawn.w > 0.0)) { break; }
            throughput *= headtail_reflected(at, drawn.xyz) / drawn.w;
            if (bounce + 1u >= HEADTAIL_ROULETTE_FROM) {
                let survival = min(headtail_largest(throughput), HEADTAIL_MOST_SURVIVAL);
                if (!(u.z < survival)) { break; }
                throughput /= survival;
            }
            if (!(headtail_largest(throughput) > 0.0)) { break; }
            ray = headtail_leaving(at.p, at.ng, drawn.xyz);
        }
    }
    let film = 3u * (inside.y * headtail_view.part.z + inside.x);
    headtail_film[film] += vec4<f32>(light.sum, light.rays);
    headtail_film[film + 1u] += background;
    headtail_film[film + 2u].x = max(headtail_film[film + 2u].x, light.largest);
}
