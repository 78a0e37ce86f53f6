//! The environment map as `map.wgsl` reads it.

use headtail_render::environment::Environment;

/// Returns the radiance of all texels, three numbers each.
pub fn texels(environment: &Environment) -> Vec<f32> {
    environment.to_image().pixels.into_flattened()
}
