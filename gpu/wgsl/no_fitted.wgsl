// No measured and no neural materials.

const HEADTAIL_HAS_FITTED: bool = false;

fn headtail_fitted_point(given: HeadtailPoint, material: u32, tile: vec3<f32>, axes: HeadtailUvAxes) -> HeadtailPoint { return given; }
fn headtail_fitted_reflected(n: vec3<f32>, wo: vec3<f32>, wi: vec3<f32>) -> vec3<f32> { return vec3<f32>(0.0); }
fn headtail_fitted_pdf(n: vec3<f32>, wo: vec3<f32>, wi: vec3<f32>) -> f32 { return 0.0; }
fn headtail_fitted_draw(n: vec3<f32>, wo: vec3<f32>, u: vec2<f32>) -> vec3<f32> { return vec3<f32>(0.0); }
