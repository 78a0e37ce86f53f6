// The sampler of patches of sky.

// The mixture weight beside sampling the BSDF, the fraction of samples to draw here; 1 for diffuse surfaces.
fn headtail_share(n: vec3<f32>, wo: vec3<f32>, lobes: vec4<f32>) -> f32 {
    if (!(lobes.y > 0.0)) { return 1.0; }
    return headtail_clusters(HeadtailSurface(n, wo, lobes)).mixture_weight;
}

// Draws a direction for a uniform point z of [0, 1)^2: (wi, solid-angle pdf); pdf 0 is no sample.
fn headtail_sample(n: vec3<f32>, wo: vec3<f32>, lobes: vec4<f32>, z: vec2<f32>) -> vec4<f32> {
    let y = headtail_patches_draw(HeadtailSurface(n, wo, lobes), z);
    return headtail_through_tail(y.xy, y.z);
}

// The solid-angle pdf with which `headtail_sample` draws a unit direction.
fn headtail_pdf(n: vec3<f32>, wo: vec3<f32>, lobes: vec4<f32>, wi: vec3<f32>) -> f32 {
    let x = headtail_square(wi);
    let cell = headtail_cell(x.xy);
    return headtail_patch_of(HeadtailSurface(n, wo, lobes), cell).density * headtail_density(cell) * x.z;
}
