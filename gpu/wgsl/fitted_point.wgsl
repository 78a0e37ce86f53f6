// Points of measured and neural materials.

const HEADTAIL_HAS_FITTED: bool = true;
const HEADTAIL_NEURAL: u32 = 4u;

// Completes a point: `tile` has its texture coordinates and, in these, the standard deviation of the pixel's footprint.
fn headtail_fitted_point(given: HeadtailPoint, material: u32, tile: vec3<f32>, axes: HeadtailUvAxes) -> HeadtailPoint {
    headtail_fitted = headtail_surfaces[material + 1u];
    headtail_is_neural = headtail_surfaces[material] == HEADTAIL_NEURAL;
    var at = given;
    at.is_fitted = true;
    if (headtail_is_neural) {
        headtail_see_texture(at, headtail_number(material + 2u) * tile, axes);
        at.lobes = headtail_neural_lobes();
    } else {
        at.lobes = headtail_measured_lobes(at.ns, at.wo);
    }
    return at;
}
