// The sampler of patches of sky.

fn headtail_prepare(at: HeadtailSurface) {
    headtail_prepare_patches(at);
}

// 1 for diffuse surfaces.
fn headtail_share_here() -> f32 {
    return headtail_patches.mixture_weight;
}

fn headtail_sample_here(z: vec2<f32>) -> vec4<f32> {
    let y = headtail_patches_draw(z);
    return headtail_through_tail(y.xy, y.z);
}

fn headtail_pdf_here(wi: vec3<f32>) -> f32 {
    let x = headtail_square(wi);
    let cell = headtail_cell(x.xy);
    return headtail_patch_of(cell).density * headtail_density(cell) * x.z;
}
