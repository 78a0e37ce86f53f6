//! The samplers that ship with the project load, belong to the built-in environments, and are as good as their commands make them.

use std::{path::Path, sync::Arc};

use glam::{Vec2, Vec3A};
use headtail_render::{
    bake::direct_bake,
    environment::{Environment, built_in},
    export::{ExportedSampler, Intermediate},
    random::{Purpose, Stream},
    sampler::IntermediateDensity,
    tail::Tail,
};

fn open(environment: &str, kind: &str) -> (ExportedSampler, Arc<Environment>) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("checkpoints/{environment}-{kind}.safetensors"));
    let exported = ExportedSampler::read(&file).unwrap();
    let environment = Arc::new(built_in(environment).unwrap());
    exported.check_environment(&environment).unwrap();
    (exported, environment)
}

/// The density over Y of cosine sampling.
fn cosine_density(tail: &Tail, normal: Vec3A, y: Vec2) -> f32 {
    let (_, wi, pdf) = tail.forward_direction(y);
    normal.dot(wi).max(0.0) / std::f32::consts::PI / pdf
}

/// KL(q* || q) at a normal, by 256 x 256 midpoints of Y; through the exact tail q* is the cosine.
fn divergence(tail: &Tail, normal: Vec3A, density: impl Fn(Vec2) -> f32) -> Option<f64> {
    let (mut light, mut kl) = (0.0, 0.0);
    for k in 0..256 * 256 {
        let y = Vec2::new((k % 256) as f32 + 0.5, (k / 256) as f32 + 0.5) / 256.0;
        let (g, q) = (f64::from(normal.dot(tail.forward_direction(y).1).max(0.0)), f64::from(density(y)));
        light += g;
        if g > 0.0 {
            kl += g * (g / q).ln();
        }
    }
    (light > 0.0).then(|| kl / light - (light / 65536.0).ln())
}

#[test]
fn heads_reach_the_divergence_that_they_claim() {
    for environment in ["studio", "window"] {
        let (exported, _) = open(environment, "head");
        let training = exported.training.expect("a head says how it was trained");
        let Intermediate::Head(head) = &exported.intermediate else { panic!("{environment}: not a head") };
        assert!(head.has_selection(), "{environment}: the default learns a share");
        let (mut sum, mut count) = (0.0, 0.0);
        for index in 0..40 {
            let normal = Stream::new(3, Purpose::Test, index).direction();
            let prepared = head.prepare_normal(normal);
            // As `head+mis` draws.
            let share = head.share_beside_brdf(&prepared);
            let density =
                |y| share * head.inverse_at(&prepared, y).1 + (1.0 - share) * cosine_density(&exported.tail, normal, y);
            let Some(kl) = divergence(&exported.tail, normal, density) else { continue };
            sum += kl;
            count += 1.0;
        }
        // Forty normals other than those of the validation: their mean KL differs from it by its own sampling error.
        let mean = sum / count;
        assert!(mean < 1.5 * training.final_kl, "{environment}: KL {mean}, the file claims {}", training.final_kl);
    }
}

#[test]
fn direct_bakes_are_what_the_command_makes_today() {
    for environment in ["studio", "window"] {
        let (exported, _) = open(environment, "direct");
        let Intermediate::DirectBake(table) = &exported.intermediate else {
            panic!("{environment}: not a direct bake")
        };
        let again = direct_bake(&exported.tail, table.normals(), table.cells()).unwrap();
        // Other processors may round sines differently.
        for (stored, computed) in table.masses().iter().zip(again.masses()) {
            assert!((stored - computed).abs() < 1e-4, "{environment}: {stored} {computed}");
        }
    }
}
