// A sampler at a shading point. What all draws at a point share is prepared once: `headtail_prepare`, then any number of `_here` functions;
// the other three functions are both.

// Unit shading normal and direction to the viewer; lobes: luminance of the diffuse reflectance, weight of the Trowbridge-Reitz lobe, luminance of
// its reflectance at normal incidence, its width; (1, 0, 1, 1) for a diffuse surface.
struct HeadtailSurface { n: vec3<f32>, wo: vec3<f32>, lobes: vec4<f32> }

// The position of the point in metres, which only portals read: to be set before it is prepared.
var<private> headtail_position: vec3<f32>;

// The point that was prepared.
var<private> headtail_at: HeadtailSurface;

// The mixture weight beside sampling the BSDF, the fraction of samples to draw here.
fn headtail_share(n: vec3<f32>, wo: vec3<f32>, lobes: vec4<f32>) -> f32 {
    headtail_prepare(HeadtailSurface(n, wo, lobes));
    return headtail_share_here();
}

// Draws a direction for a uniform point z of [0, 1)^2: (wi, solid-angle pdf); pdf 0 is no sample.
fn headtail_sample(n: vec3<f32>, wo: vec3<f32>, lobes: vec4<f32>, z: vec2<f32>) -> vec4<f32> {
    headtail_prepare(HeadtailSurface(n, wo, lobes));
    return headtail_sample_here(z);
}

// The solid-angle pdf with which `headtail_sample` draws a unit direction.
fn headtail_pdf(n: vec3<f32>, wo: vec3<f32>, lobes: vec4<f32>, wi: vec3<f32>) -> f32 {
    headtail_prepare(HeadtailSurface(n, wo, lobes));
    return headtail_pdf_here(wi);
}

// The direction that the tail carries a point of Y to, and its solid-angle pdf, given the point's density.
fn headtail_through_tail(y: vec2<f32>, density: f32) -> vec4<f32> {
    let x = headtail_tail(y);
    let w = headtail_direction(x.xy);
    return vec4<f32>(w.xyz, density * x.z * w.w);
}
