//! The paper's figure of compositing, what one pass gains over two, and the bias of its estimator.

use std::sync::{Arc, atomic::AtomicBool};

use anyhow::Result;
use glam::{Affine3A, Quat, Vec2, Vec3, Vec3A};
use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    composite::{
        Backdrop, Catcher, Composition, Film, Layers, Mask, MaskForm, Settings, Stage, compose, rectified_view,
    },
    environment::Environment,
    estimator::{Estimator, SingleSample},
    image::{Image, Photograph, encode_png, encode_png_rgb8, srgb_code},
    sampler::{Covering, EnvironmentLight, ProductSampler},
    scene::Camera,
    spec::{FileKind, SamplerSpec},
    tail::TailKind,
};
use headtail_train::Material;

use super::{
    Workshop,
    figure::{Panel, legend, strip, table},
    scenes::baked,
};
use crate::{
    report::{
        chart::Scale,
        number::{escape, text, times},
    },
    view::automatic_exposure,
};

/// Shadow rays per pixel of the catcher.
const RAYS: u32 = 16;
/// The largest width: masks are smooth, and their references long.
const MAX_WIDTH: usize = 240;

/// An object before a rectified view of a map.
struct Shot {
    name: String,
    environment: Arc<Environment>,
    stage: Stage,
    camera: Camera,
    photograph: Photograph,
}

impl Shot {
    fn new(workshop: &Workshop, index: usize) -> Result<Self> {
        let environment = workshop.data.map(index)?;
        let (name, scene) = workshop.data.object(index)?;
        let width = workshop.effort.width.min(MAX_WIDTH);
        let height = width * 2 / 3;
        let turn = Quat::from_rotation_y(-2.1 * index as f32) * Quat::from_rotation_x(-0.42);
        let at = Vec3A::from(turn * Vec3::new(0.0, 0.15, 3.6));
        let camera = Camera::of_photograph(Affine3A::from_rotation_translation(turn, at.into()), 0.4, Vec2::ZERO)?;
        let photograph = Photograph::of_radiance(rectified_view(&environment, &camera, width, height));
        let bounds = scene.bounds();
        let foot = Vec3A::new(bounds.center().x, bounds.min.y, bounds.center().z);
        let scale = 1.1 / bounds.extent().max_element();
        let to_place = Affine3A::from_scale(Vec3::splat(scale)) * Affine3A::from_translation((-foot).into());
        let object = scene.moved(&to_place)?;
        let catcher = Catcher::plane(Vec3A::ZERO, Vec3A::Y, &object, &camera)?;
        Ok(Self { name, environment, stage: Stage::new(object, catcher)?, camera, photograph })
    }

    fn film(&self, estimator: &dyn Estimator, settings: Settings) -> Film {
        let backdrop = Backdrop::new(&self.stage, &self.environment, &self.photograph, self.camera, 1.0);
        let composition = Composition { stage: &self.stage, backdrop: &backdrop, camera: &self.camera, estimator };
        compose(composition, settings, &AtomicBool::new(false), &|_| {})
    }

    fn settings(&self, spp: u32, seed: u64) -> Settings {
        let Image { width, height, .. } = self.photograph.image;
        Settings { width, height, spp, depth: 1, seed, mask_only: true, without_object: false }
    }
}

/// The section.
pub fn section(workshop: &Workshop) -> Result<String> {
    let mut html = String::from(
        "<p class=\"note\">Objects before rectified views of maps, in one pass: photograph, composite and mask (per channel, control variate). The object is lit over up to four \
         surfaces, throws light back, and sees the photograph on the ground.</p>\n",
    );
    let mut rows = Vec::new();
    for index in 0..3 {
        workshop.check()?;
        let shot = Shot::new(workshop, index)?;
        html += &pictures(&shot)?;
        rows.extend(passes(workshop, &shot)?);
    }
    html += "<h3>One pass against two</h3>\n<p class=\"note\">MSE of the mask of luminance over the pixels of the catcher and over those in shadow (mask below 0.98), and of the composite's pixels on the catcher, against a converged mask, with 16 shadow rays per pixel: 16 samples in one pass, \
             or 8 with the object and 8 without. How many times lower than two passes with one-sample MIS stands beside each. Bias is the mean error in the shadow.</p>\n";
    html += &table("shadow-catcher", &["", "form", "mask", "mask in shadow", "composite", "bias"], &rows);
    html += &bias(workshop)?;
    Ok(html)
}

fn pictures(shot: &Shot) -> Result<String> {
    let estimator = SamplerSpec::patches().build(&shot.environment)?;
    let film = shot.film(&*estimator, Settings { depth: 4, mask_only: false, ..shot.settings(64, 3) });
    let mask = Mask::of(&film, MaskForm::ControlVariate);
    let layers = Layers::new(&film, &mask, &shot.photograph, 1.0, true);
    let stops = automatic_exposure(&shot.photograph.image) + 0.5;
    let codes: Vec<[u8; 3]> = layers.shadow.pixels.iter().map(|pixel| pixel.map(srgb_code)).collect();
    let panels = [
        Panel::new(&encode_png(&shot.photograph.image, stops)?, "photograph", shot.environment.name()),
        Panel::new(&encode_png(&layers.composite(), stops)?, "composite", shot.name.as_str()),
        Panel::new(&encode_png_rgb8(film.width, film.height, &codes)?, "mask", "64 spp"),
    ];
    Ok(strip("wide", &panels))
}

/// Errors of a mask over the pixels that the catcher fills.
#[derive(Clone, Copy, Default)]
struct Errors {
    /// Mean squared error of the mask of luminance.
    mask: f64,
    /// The same over the pixels in shadow.
    shadow: f64,
    /// Mean squared error of the composite, whose pixels are the photograph times the mask per channel.
    composite: f64,
    /// Mean error over the pixels in shadow.
    bias: f64,
}

/// Below this a pixel is in shadow.
const IN_SHADOW: f32 = 0.98;

impl Errors {
    fn of(mask: &Mask, truth: &Mask, film: &Film, photograph: &Photograph) -> Self {
        let (mut sums, mut pixels, mut shadowed) = (Self::default(), 0_u32, 0_u32);
        for (k, (own, truth)) in mask.values.iter().zip(&truth.values).enumerate() {
            if film.catcher[k].hits < film.spp {
                continue;
            }
            let off: [f64; 4] = std::array::from_fn(|c| f64::from(own[c]) - f64::from(truth[c]));
            sums.mask += off[3] * off[3];
            let colors = photograph.image.pixels[k].iter().zip(off);
            sums.composite += colors.map(|(&color, off)| (f64::from(color) * off).powi(2)).sum::<f64>() / 3.0;
            pixels += 1;
            if truth[3] < IN_SHADOW {
                sums.shadow += off[3] * off[3];
                sums.bias += off[3];
                shadowed += 1;
            }
        }
        let (pixels, shadowed) = (f64::from(pixels.max(1)), f64::from(shadowed.max(1)));
        Self {
            mask: sums.mask / pixels,
            shadow: sums.shadow / shadowed,
            composite: sums.composite / pixels,
            bias: sums.bias / shadowed,
        }
    }

    fn plus(self, other: Self, weight: f64) -> Self {
        Self {
            mask: self.mask + weight * other.mask,
            shadow: self.shadow + weight * other.shadow,
            composite: self.composite + weight * other.composite,
            bias: self.bias + weight * other.bias,
        }
    }
}

/// The forms that are compared.
const FORMS: [&str; 4] = ["two passes", "one pass, paper", "one pass, ratio", "one pass, control variate"];

fn passes(workshop: &Workshop, shot: &Shot) -> Result<Vec<Vec<String>>> {
    let best = SamplerSpec::patches().build(&shot.environment)?;
    let truth_film = shot.film(&*best, shot.settings(2 * workshop.effort.mask_spp, 99));
    let truth = Mask::of(&truth_film, MaskForm::ControlVariate);
    let mut results: Vec<(&str, &str, Errors)> = Vec::new();
    for (name, spec) in
        [("mis", SamplerSpec::mis()), ("ris:4", SamplerSpec::ris(4)), ("patches", SamplerSpec::patches())]
    {
        workshop.check()?;
        let estimator = spec.build(&shot.environment)?;
        let mut sums = [Errors::default(); 4];
        let runs = workshop.effort.runs.min(4);
        for run in 0..runs {
            let seed = 10 * u64::from(run) + 1;
            let one = shot.film(&*estimator, shot.settings(RAYS, seed));
            let with = shot.film(&*estimator, shot.settings(RAYS / 2, seed + 1));
            let without =
                shot.film(&*estimator, Settings { without_object: true, ..shot.settings(RAYS / 2, seed + 2) });
            let single = [MaskForm::Paper, MaskForm::Ratio, MaskForm::ControlVariate].map(|form| Mask::of(&one, form));
            for (sum, mask) in sums.iter_mut().zip([Mask::of_two(&with, &without)].iter().chain(&single)) {
                *sum = sum.plus(Errors::of(mask, &truth, &truth_film, &shot.photograph), 1.0 / f64::from(runs));
            }
        }
        results.extend(FORMS.into_iter().zip(sums).map(|(form, errors)| (name, form, errors)));
    }
    let base = results[0].2;
    let title = format!("{} under {}", shot.name, shot.environment.name());
    let times_lower = |base: f64, own: f64| format!("{} <small>{}\u{d7}</small>", text(own), times(base / own));
    let line = |(name, form, errors): &(&str, &str, Errors)| {
        vec![
            format!("{}: {name}", escape(&title)),
            (*form).to_owned(),
            times_lower(base.mask, errors.mask),
            times_lower(base.shadow, errors.shadow),
            times_lower(base.composite, errors.composite),
            format!("{:+.1e}", errors.bias),
        ]
    };
    Ok(results.iter().map(line).collect())
}

/// The bias of the paper's estimator with samplers that are nearly the product, and of the control variate with the same.
fn bias(workshop: &Workshop) -> Result<String> {
    let shot = Shot::new(workshop, 0)?;
    let environment = &shot.environment;
    let light = EnvironmentLight::new(environment.clone(), TailKind::Hierarchical)?;
    let table_of = |side: usize| -> Result<Box<dyn Estimator>> {
        let table = direct_bake(light.tail(), NormalGrid::new(16, 32)?, CellGrid::new(side, side)?)?;
        Ok(Box::new(SingleSample::new(Covering::new(ProductSampler::new(light.clone(), table))?, environment.clone())))
    };
    let file = workshop.heads.of(environment, Material::Lambert)?.file;
    let samplers: Vec<(&str, Box<dyn Estimator>)> = vec![
        ("head", SamplerSpec::file(FileKind::Head, file.clone()).build(environment)?),
        ("baked 8\u{d7}8", baked(&file, environment, 8)?),
        ("direct 32\u{d7}32", table_of(32)?),
        ("patches", SamplerSpec::patches().build(environment)?),
    ];
    let spp = workshop.effort.mask_spp;
    let reference = shot.film(&*samplers[3].1, shot.settings(4 * spp, 77));
    let truth = Mask::of(&reference, MaskForm::ControlVariate);
    let (mut panels, mut rows) = (Vec::new(), Vec::new());
    let scale = Scale { top: 0.1, decades: 2.0 };
    for (name, estimator) in &samplers {
        workshop.check()?;
        let film = shot.film(&**estimator, shot.settings(spp, 5));
        for form in [MaskForm::Paper, MaskForm::ControlVariate] {
            let mask = Mask::of(&film, form);
            let off: Vec<f32> = mask.values.iter().zip(&truth.values).map(|(a, b)| (a[3] - b[3]).abs()).collect();
            let errors = Errors::of(&mask, &truth, &reference, &shot.photograph);
            let squares = errors.shadow;
            let interval = half_width(&mask, &truth, &reference);
            panels.push(Panel::new(
                &scale.png(&off, film.width)?,
                format!("{name}, {form}"),
                format!("root mean square {}", text(squares.sqrt())),
            ));
            rows.push(vec![
                (*name).to_owned(),
                form.to_string(),
                format!("{:+.1e} \u{b1} {interval:.0e}", errors.bias),
                text(squares.sqrt()),
            ]);
        }
    }
    Ok(format!(
        "<h3>Bias of the paper's estimator</h3>\n<p class=\"note\">{} under {}: the absolute error of masks of luminance after {spp} samples per pixel, where noise is small: what is left of \
         the mean visibility is bias. The unbiased form uses the same samples. Mean errors with 95 % intervals over blocks of the shadow's pixels (mask below 0.98).</p>\n{}{}{}",
        escape(&shot.name),
        escape(environment.name()),
        strip("wide", &panels),
        legend(scale, "absolute error of the mask"),
        table("mask-bias", &["sampler", "form", "mean error in shadow", "root mean square"], &rows),
    ))
}

/// Half a 95 % interval of the mean error, by blocks of 8 x 8 pixels.
fn half_width(mask: &Mask, truth: &Mask, film: &Film) -> f64 {
    let columns = film.width.div_ceil(8);
    let mut blocks = vec![(0.0, 0_u32); columns * film.height.div_ceil(8)];
    let is_measured = |k: &usize| film.catcher[*k].hits == film.spp && truth.values[*k][3] < IN_SHADOW;
    for k in (0..film.catcher.len()).filter(is_measured) {
        let block = &mut blocks[k / film.width / 8 * columns + k % film.width / 8];
        block.0 += f64::from(mask.values[k][3]) - f64::from(truth.values[k][3]);
        block.1 += 1;
    }
    let pixels: u32 = blocks.iter().map(|block| block.1).sum();
    let mean = blocks.iter().map(|block| block.0).sum::<f64>() / f64::from(pixels.max(1));
    let squares: f64 = blocks.iter().map(|(sum, count)| (sum - mean * f64::from(*count)).powi(2)).sum();
    1.96 * squares.sqrt() / f64::from(pixels.max(1))
}
