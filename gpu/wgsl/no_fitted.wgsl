// No measured and no neural materials.

const HEADTAIL_HAS_FITTED: bool = false;

fn headtail_fitted_point(given: HeadtailPoint, material: u32, tile: vec3<f32>, axes: HeadtailUvAxes) -> HeadtailPoint { return given; }
fn headtail_fitted_reflected(at: HeadtailPoint, wi: vec3<f32>) -> vec3<f32> { return vec3<f32>(0.0); }
fn headtail_fitted_pdf(at: HeadtailPoint, wi: vec3<f32>) -> f32 { return 0.0; }
fn headtail_fitted_sample(at: HeadtailPoint, u: vec2<f32>) -> vec4<f32> { return vec4<f32>(0.0); }
