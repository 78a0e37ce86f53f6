//! The bias of the paper's estimator of the mask.

use std::sync::Arc;

use anyhow::Result;
use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    composite::{Mask, MaskForm},
    environment::Environment,
    estimator::{Estimator, SingleSample},
    sampler::{Covering, EnvironmentLight, ProductSampler},
    scene::MaterialSpec,
    spec::{FileKind, SamplerSpec},
    tail::TailKind,
};

use super::{
    PaperContext,
    figure::{Layout, Panel, Strip, heading, note},
    part::PartOutput,
    scenes::baked,
    shot::{Errors, IN_SHADOW, Shot, Truth},
};
use crate::report::{
    chart::Scale,
    number::{escape, text},
    table::Cell,
};

/// Measures the bias of the paper's estimator and of the control variate with nearly product-proportional
/// samplers.
pub fn bias(context: &PaperContext) -> Result<PartOutput> {
    let shot = Shot::new(context, 0)?;
    let environment = &shot.environment;
    let backdrop = shot.backdrop();
    let samplers = samplers(context, environment)?;
    let spp = context.effort.mask_spp;
    let patches = SamplerSpec::patches().build(environment)?;
    let reference = shot.film(&backdrop, &*patches, shot.settings(4 * spp, 77));
    context.check()?;
    let chooses = shot.chooses_shadow(context, &backdrop, &*patches);
    let truth = Truth::new(Mask::of(&reference, MaskForm::ControlVariate), &reference, &chooses);
    let (mut panels, mut rows) = (Vec::new(), Vec::new());
    let scale = Scale { top: 0.1, decades: 2.0 };
    for (name, estimator) in &samplers {
        context.check()?;
        let film = shot.film(&backdrop, &**estimator, shot.settings(spp, 5));
        for form in [MaskForm::Paper, MaskForm::ControlVariate] {
            let mask = Mask::of(&film, form);
            let off: Vec<f32> = mask.values.iter().zip(&truth.mask.values).map(|(a, b)| (a[3] - b[3]).abs()).collect();
            let errors = Errors::of(&mask, &truth, &shot.photograph);
            let root = errors.shadow.sqrt();
            let interval = half_width(&mask, &truth);
            let note = format!("mean error {:+.1e}, root mean square {}", errors.bias, text(root));
            panels.push(Panel::new(&scale.png(&off, film.width)?, format!("{name}, {form}"), note));
            rows.push(vec![
                Cell::text(format!("{name}, {form}")),
                Cell::number(errors.bias).beside(format!("\u{b1} {interval:.1e}")),
                Cell::number(root),
            ]);
        }
    }
    let mut output = PartOutput::of(heading("Bias of the paper's estimator"));
    output.html += &note(&format!(
        "{} under {}: the absolute error of masks of luminance after {spp} samples per pixel, where noise is small: what is left of \
         the mean visibility is bias. The unbiased form uses the same samples. Mean errors with 95 % intervals over blocks of the shadow's pixels (mask below {IN_SHADOW}), against a control variate of {} samples.",
        escape(&shot.name),
        escape(environment.name()),
        4 * spp,
    ));
    let scales = vec![(scale, "absolute error of the mask")];
    output.strip("bias", &Strip { layout: Layout::Four, panels, scales })?;
    output.table("mask-bias", &["sampler, form", "mean error in shadow", "root mean square"], rows);
    Ok(output)
}

/// Samplers that are nearly proportional to light times cosine, and `mis`, which is not.
fn samplers(context: &PaperContext, environment: &Arc<Environment>) -> Result<Vec<(&'static str, Box<dyn Estimator>)>> {
    let light = EnvironmentLight::new(environment.clone(), TailKind::Hierarchical)?;
    let table = direct_bake(light.tail(), NormalGrid::new(16, 32)?, CellGrid::new(32, 32)?)?;
    let direct = SingleSample::new(Covering::new(ProductSampler::new(light, table))?, environment.clone());
    let head = context.heads.of(environment, &MaterialSpec::LAMBERT)?.file;
    Ok(vec![
        ("head", SamplerSpec::file(FileKind::Head, head.clone()).build(environment)?),
        ("baked 8\u{d7}8", baked(&head, environment, 8)?),
        ("direct 32\u{d7}32", Box::new(direct)),
        ("patches", SamplerSpec::patches().build(environment)?),
        ("mis", SamplerSpec::mis().build(environment)?),
    ])
}

/// Half-width of the 95 % interval of the mean error in shadow, from blocks of 8 x 8 pixels. It covers the
/// noise of the mask and of the reference.
fn half_width(mask: &Mask, truth: &Truth) -> f64 {
    let columns = mask.width.div_ceil(8);
    let mut blocks = vec![(0.0, 0_u32); columns * mask.values.len().div_ceil(mask.width).div_ceil(8)];
    for (k, off) in truth.errors_in_shadow(mask) {
        let block = &mut blocks[k / mask.width / 8 * columns + k % mask.width / 8];
        block.0 += off;
        block.1 += 1;
    }
    let pixels: u32 = blocks.iter().map(|block| block.1).sum();
    let mean = blocks.iter().map(|block| block.0).sum::<f64>() / f64::from(pixels.max(1));
    let squares: f64 = blocks.iter().map(|(sum, count)| (sum - mean * f64::from(*count)).powi(2)).sum();
    1.96 * squares.sqrt() / f64::from(pixels.max(1))
}
