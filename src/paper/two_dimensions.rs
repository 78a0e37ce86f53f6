//! The paper's two-dimensional example: an image as the tail's density, times a moving Gaussian.

use std::f32::consts::TAU;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result};
use glam::{Vec2, Vec3A};
use headtail_render::{
    color::luminance,
    integrator::{Budget, View, render},
    latlong,
    points::{PointSet, Points},
    random::Stream,
    scene::{MaterialSpec, Scene},
    spec::SamplerSpec,
    tail::{Tail, TailKind},
};
use headtail_train::{
    FitConfig, Loss,
    integrand::{NaiveTarget, ProductTarget, Surface},
};

use super::{
    PaperContext,
    densities::Densities,
    figure::{Layout, Panel, Strip},
    fits::weights,
    part::{Part, PartOutput},
};
use crate::{
    cost,
    report::{chart::Scale, number::text, table::Cell},
};

/// Standard deviation of the Gaussian relative to the square.
const SIGMA: f32 = 0.11;
/// Rows of the image; it has twice the columns.
const ROWS: usize = 128;

/// A Gaussian over X that wraps around in u. Its condition is the centre `(u, v)` as `(cos 2 pi u, sin 2 pi
/// u, 2 v - 1)`.
struct Gaussian;

fn encode(centre: Vec2) -> [f32; 3] {
    let (sin, cos) = (TAU * centre.x).sin_cos();
    [cos, sin, 2.0 * centre.y - 1.0]
}

impl Gaussian {
    fn at(condition: &[f32], x: Vec2) -> f32 {
        let u = condition[1].atan2(condition[0]) / TAU;
        let across = (x.x - u).rem_euclid(1.0);
        let across = across.min(1.0 - across);
        let down = x.y - 0.5 * (condition[2] + 1.0);
        (-0.5 * (across * across + down * down) / (SIGMA * SIGMA)).exp()
    }
}

impl Surface for Gaussian {
    fn condition(&self) -> headtail_render::head::Condition {
        headtail_render::head::Condition::Normal
    }

    fn draw_condition(&self, stream: &mut Stream, condition: &mut [f32]) {
        let centre = Vec2::new(stream.uniform(), 0.15 + 0.7 * stream.uniform());
        condition.copy_from_slice(&encode(centre));
    }

    fn lobes(&self, condition: &[f32], wi: &[Vec3A]) -> Vec<f32> {
        wi.iter().map(|&wi| Self::at(condition, latlong::square(wi))).collect()
    }

    fn samples(&self, _condition: &[f32], u: &[Vec2]) -> Vec<Option<Vec3A>> {
        vec![None; u.len()]
    }

    fn pdfs(&self, _condition: &[f32], wi: &[Vec3A]) -> Vec<f32> {
        vec![0.0; wi.len()]
    }
}

/// The section.
pub fn section(context: &PaperContext) -> (String, Vec<Part>) {
    let cost = 2.0 * cost::training(&context.heads.config(&MaterialSpec::LAMBERT));
    (String::new(), vec![Part::new("image and Gaussian", cost, example)])
}

fn example(context: &PaperContext) -> Result<PartOutput> {
    let image = picture()?;
    // A tail weights by solid angle: division by sin theta makes its density over the square equal the image.
    let luminance: Vec<f32> = image
        .iter()
        .enumerate()
        .map(|(k, value)| {
            value
                / latlong::sin_theta(
                    ((k / (2 * ROWS)) as f32 / (ROWS - 1) as f32).clamp(0.5 / ROWS as f32, 1.0 - 0.5 / ROWS as f32),
                )
        })
        .collect();
    let tail = Tail::new(TailKind::Hierarchical, 2 * ROWS, ROWS, &luminance)?;
    let config = FitConfig { learning_rate: 8e-3, ..context.heads.config(&MaterialSpec::LAMBERT) };
    let (head, summary) = context.heads.train(&config, &ProductTarget::of_surface(Gaussian, &tail))?;
    let naive_config = FitConfig { loss: Loss::ForwardKl, learning_rate: 4e-3, ..config };
    let target = NaiveTarget::new(Box::new(ProductTarget::of_surface(Gaussian, &tail)), &tail);
    let (naive, naive_summary) = context.heads.train(&naive_config, &target)?;

    let grid = Densities::new(context.effort.density_rows);
    let first = grid.normalized(grid.points.iter().map(|&x| tail.light().density(x)));
    let mut output = PartOutput::of(format!(
        "<p class=\"note\">An image as the density p1 of the tail, times a Gaussian p2 whose centre is the condition. Both fits have {} weights and {} steps. \
         Over the validation set the divergence from the product is {} nats with the tail (before training {}), and {} nats without ({}). \
         <span class=\"paper\">The paper: \u{201c}a poor result\u{201d} without the tail, \u{201c}a near-perfect fit with an equal number of NF parameters\u{201d} with it.</span></p>\n",
        weights(&head),
        config.steps,
        text(summary.divergence.kl),
        text(summary.initial.kl),
        text(naive_summary.divergence.kl),
        text(naive_summary.initial.kl),
    ));
    let mut lines = Vec::new();
    for centre in [Vec2::new(0.42, 0.55), Vec2::new(0.62, 0.4)] {
        let condition = encode(centre);
        let second = grid.normalized(grid.points.iter().map(|&x| Gaussian::at(&condition, x)));
        let product = grid.normalized(first.iter().zip(&second).map(|(a, b)| a * b));
        let (ours, alone) = (grid.through(&tail, &head, &condition)?, grid.of_head(&naive, &condition)?);
        let columns = 2 * grid.rows;
        let (own, scale) = (Scale::of(&first, 2.0), Scale::of(&product, 3.0));
        let panels = [
            Panel::new(&own.png(&first, columns)?, "p1: image", ""),
            Panel::new(&scale.png(&second, columns)?, "p2: Gaussian", ""),
            Panel::new(&scale.png(&product, columns)?, "p1 \u{d7} p2", ""),
            Panel::new(&scale.png(&alone, columns)?, "naive fit", format!("KL {}", text(grid.kl(&product, &alone)))),
            Panel::new(&scale.png(&ours, columns)?, "our fit", format!("KL {}", text(grid.kl(&product, &ours)))),
        ];
        let scales = vec![(scale, "density over the square"), (own, "density of the image p1")];
        output.strip(
            &format!("example-{}", lines.len() + 1),
            &Strip { layout: Layout::Five, panels: panels.into(), scales },
        )?;
        let divergences = [&alone, &ours].map(|density| Cell::number(grid.kl(&product, density)));
        lines.push(
            std::iter::once(Cell::text(format!("centre {:.2}, {:.2}", centre.x, centre.y)))
                .chain(divergences)
                .collect(),
        );
    }
    lines.push(vec![
        Cell::text("all centres (validation set)"),
        Cell::number(naive_summary.divergence.kl),
        Cell::number(summary.divergence.kl),
    ]);
    output.table("example", &["KL in nats", "naive fit", "our fit"], lines);
    Ok(output)
}

/// A detailed picture: the luminance of the built-in temple, with a floor.
fn picture() -> Result<Vec<f32>> {
    let scene = Scene::built_in("temple").context("a built-in scene")?;
    let environment = crate::arguments::open_environment("window")?;
    let camera = scene.camera();
    let (width, height) = (2 * ROWS, ROWS);
    let view =
        View { scene: &scene, camera: &camera, environment: &environment, width, height, unshadowed: false, depth: 1 };
    let estimator = SamplerSpec::patches().build(&environment)?;
    let points = Points::new(PointSet::Sobol, 0);
    let rendering = render(view, &*estimator, Budget::Spp(32), points, &AtomicBool::new(false), &|_| {});
    let values: Vec<f32> = rendering.composite().pixels.iter().map(|&pixel| luminance(pixel.into())).collect();
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    Ok(values.into_iter().map(|value| value.min(4.0 * mean) + 0.02 * mean).collect())
}
