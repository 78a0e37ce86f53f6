//! The example that reads an exported file is short and estimates the correct light.

#[path = "../examples/exported_sampler.rs"]
#[expect(dead_code)]
mod exported_sampler;

use std::{f32::consts::PI, path::Path};

use glam::{Vec2, Vec3A};
use headtail_render::{environment::built_in, latlong};

/// Integrates the light on an upward-facing surface by the midpoint rule over the map.
fn reflected_upwards(map: &str) -> Vec3A {
    const ROWS: usize = 1024;
    let map = built_in(map).unwrap();
    let mut sum = Vec3A::ZERO;
    for row in 0..ROWS / 2 {
        let height = (row as f32 + 0.5) / ROWS as f32;
        // cosine / pi times the cell's solid angle.
        let weight = (height * PI).cos() / PI * (height * PI).sin() * (PI / ROWS as f32).powi(2);
        for column in 0..2 * ROWS {
            let wi = latlong::direction(Vec2::new((column as f32 + 0.5) / (2 * ROWS) as f32, height));
            sum += weight * map.radiance(wi);
        }
    }
    sum
}

#[test]
fn the_example_is_short_and_estimates_the_correct_light() {
    assert!(include_str!("../examples/exported_sampler.rs").lines().count() < 40);
    for kind in ["direct", "head"] {
        let file = format!("../checkpoints/window-{kind}.safetensors");
        let estimate = exported_sampler::reflected(Path::new(&file), "window").unwrap();
        let ratio = estimate / reflected_upwards("window");
        // 4096 points of Sobol's sequence.
        assert!((ratio - 1.0).abs().max_element() < 0.02, "{kind}: {ratio}");
    }
}
