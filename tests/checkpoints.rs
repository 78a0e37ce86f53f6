//! The shipped samplers load, match the built-in environments, and reproduce the quality of their commands.

use std::{path::Path, sync::Arc};

use glam::{Vec2, Vec3A};
use headtail_render::{
    bake::direct_bake,
    environment::{Environment, built_in},
    export::{ExportedSampler, Intermediate},
    head::Head,
    random::{Purpose, Stream},
    tail::Tail,
};

fn open(environment: &str, kind: &str) -> (ExportedSampler, Arc<Environment>) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("checkpoints/{environment}-{kind}.safetensors"));
    let exported = ExportedSampler::read(&file).unwrap();
    let environment = Arc::new(built_in(environment).unwrap());
    exported.check_environment(&environment).unwrap();
    (exported, environment)
}

/// KL(q* || q) at a normal by the midpoint rule on 256 x 256 cells of Y, for a mixture of the head and cosine
/// sampling. With the exact tail, q* is proportional to the cosine.
fn divergence(head: &Head, tail: &Tail, normal: Vec3A) -> Option<f64> {
    let centre = |k: usize| Vec2::new((k % 256) as f32 + 0.5, (k / 256) as f32 + 0.5) / 256.0;
    let y: Vec<Vec2> = (0..256 * 256).map(centre).collect();
    let head = head.at(&normal.to_array()).unwrap();
    let mixture_weight = head.mixture_weight();
    let (mut light, mut kl) = (0.0, 0.0);
    for ((_, q), (_, wi, pdf)) in head.invert(&y).into_iter().zip(tail.forward_directions(&y)) {
        let g = normal.dot(wi).max(0.0);
        let q = f64::from(mixture_weight * q + (1.0 - mixture_weight) * g / std::f32::consts::PI / pdf);
        let g = f64::from(g);
        light += g;
        if g > 0.0 {
            kl += g * (g / q).ln();
        }
    }
    (light > 0.0).then(|| kl / light - (light / 65536.0).ln())
}

#[test]
fn heads_reach_their_stated_divergence() {
    for environment in ["studio", "window"] {
        let (exported, _) = open(environment, "head");
        let training = exported.training.expect("a head says how it was trained");
        let Intermediate::Head(head) = &exported.intermediate else { panic!("{environment}: not a head") };
        assert!(head.has_mixture_weight(), "{environment}: the default learns a mixture weight");
        let (mut sum, mut count) = (0.0, 0.0);
        for index in 0..40 {
            let normal = Stream::new(3, Purpose::Test, index).direction();
            // The distribution of `head+mis`.
            let Some(kl) = divergence(head, &exported.tail, normal) else { continue };
            sum += kl;
            count += 1.0;
        }
        // Forty normals that differ from those of the validation, so the mean KL has a sampling error.
        let mean = sum / count;
        assert!(mean < 1.5 * training.final_kl, "{environment}: KL {mean}, the file claims {}", training.final_kl);
    }
}

#[test]
fn shipped_direct_bakes_are_reproducible() {
    for environment in ["studio", "window"] {
        let (exported, _) = open(environment, "direct");
        let Intermediate::DirectBake(table) = &exported.intermediate else {
            panic!("{environment}: not a direct bake")
        };
        let again = direct_bake(&exported.tail, table.normals(), table.cells()).unwrap();
        // Sines can round differently on other processors.
        for (stored, computed) in table.masses().iter().zip(again.masses()) {
            assert!((stored - computed).abs() < 1e-4, "{environment}: {stored} {computed}");
        }
    }
}
