// Points of the square of a head over patches over a tail.

fn prepare_square(at: Surface) {
    headtail_prepare_patches(HeadtailSurface(at.n, at.wo, surface_lobes(at)));
}

// The point of X that patches and the tail carry z to, the density |dz/dx| there, and that of patches over Y: 0 where nothing is reflected.
fn image_of(z: vec2<f32>) -> vec4<f32> {
    let y = headtail_patches_draw(z);
    let x = headtail_tail(y.xy);
    return vec4<f32>(x.xy, x.z * y.z, y.z);
}

// The point of the square that is carried to a point of X, and a positive number if there is one.
fn back_to_square(x: vec2<f32>) -> vec3<f32> {
    let cell = headtail_cell(x);
    let back = headtail_patches_back(cell, headtail_inverse(cell));
    return vec3<f32>(back.xy, back.z * headtail_density(cell));
}
