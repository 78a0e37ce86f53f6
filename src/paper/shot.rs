//! An object before a photograph, ready to be composited.

use std::sync::{Arc, atomic::AtomicBool};

use anyhow::Result;
use glam::{Affine3A, Quat, Vec2, Vec3, Vec3A};
use headtail_render::{
    composite::{Backdrop, Catcher, Composition, Film, Mask, MaskForm, Settings, Stage, compose, rectified_view},
    environment::Environment,
    estimator::Estimator,
    image::{Image, Photograph},
    scene::Camera,
};

use super::PaperContext;

/// Maximum width of photographs: masks are smooth, and their references expensive.
const MAX_WIDTH: usize = 240;
/// A mask below this value is in shadow.
pub const IN_SHADOW: f32 = 0.98;

/// An object before a rectified view of a map.
pub struct Shot {
    /// The object's name.
    pub name: String,
    /// The light.
    pub environment: Arc<Environment>,
    /// Object and catcher.
    pub stage: Stage,
    /// The photograph's camera.
    pub camera: Camera,
    /// The photograph behind the object.
    pub photograph: Photograph,
    /// Stops films early; set by a signal.
    pub stop: Arc<AtomicBool>,
}

impl Shot {
    /// Places an object on a plane before a rectified view of a map.
    pub fn new(context: &PaperContext, index: usize) -> Result<Self> {
        let environment = context.data.map(index)?;
        let (name, scene) = context.data.object(index)?;
        let (width, height) = size(context);
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
        let stage = Stage::new(object, catcher)?;
        Ok(Self { name, environment, stage, camera, photograph, stop: context.stop.clone() })
    }

    /// Computes the catcher's appearance and irradiance. A mesh needs all normals, which takes longer.
    pub fn backdrop(&self) -> Backdrop<'_> {
        Backdrop::new(&self.stage, &self.environment, &self.photograph, self.camera, Vec3A::ONE)
    }

    /// Renders one pass.
    pub fn film(&self, backdrop: &Backdrop<'_>, estimator: &dyn Estimator, settings: Settings) -> Film {
        let composition = Composition { stage: &self.stage, backdrop, camera: &self.camera, estimator };
        compose(composition, settings, &self.stop, &|_| {})
    }

    /// Settings for the mask alone.
    pub fn settings(&self, spp: u32, seed: u64) -> Settings {
        let Image { width, height, .. } = self.photograph.image;
        Settings { width, height, spp, depth: 1, seed, mask_only: true, without_object: false }
    }

    /// Returns the mask of two passes of `spp` samples each, with the object divided by without it, and the
    /// film with the object.
    pub fn two_passes(&self, backdrop: &Backdrop<'_>, estimator: &dyn Estimator, spp: u32, seed: u64) -> (Mask, Film) {
        let with = self.film(backdrop, estimator, self.settings(spp, seed));
        let without = self.film(backdrop, estimator, Settings { without_object: true, ..self.settings(spp, seed + 1) });
        (Mask::of_two(&with, &without), with)
    }

    /// Returns the mask that selects pixels in shadow, see [`Truth`].
    pub fn chooses_shadow(&self, context: &PaperContext, backdrop: &Backdrop<'_>, estimator: &dyn Estimator) -> Mask {
        Mask::of(&self.film(backdrop, estimator, self.settings(context.effort.mask_spp, 55)), MaskForm::ControlVariate)
    }
}

/// Width and height of photographs.
pub fn size(context: &PaperContext) -> (usize, usize) {
    let width = context.effort.width.min(MAX_WIDTH);
    (width, width * 2 / 3)
}

/// The reference mask and the pixels to compare.
pub struct Truth {
    /// The mask.
    pub mask: Mask,
    /// Pixels that the catcher covers entirely.
    is_filled: Vec<bool>,
    /// The covered pixels in shadow, selected with independent samples: selection by a mask itself would
    /// favour pixels that its own noise darkened and bias the errors.
    is_shadow: Vec<bool>,
}

impl Truth {
    /// A reference mask with its film, and `chooses`, which selects the shadow from independent samples.
    pub fn new(mask: Mask, film: &Film, chooses: &Mask) -> Self {
        let is_filled: Vec<bool> = film.catcher.iter().map(|sums| sums.hits == film.spp).collect();
        let dark = chooses.values.iter().map(|value| value[3] < IN_SHADOW);
        let is_shadow = is_filled.iter().zip(dark).map(|(&is_filled, is_dark)| is_filled && is_dark).collect();
        Self { mask, is_filled, is_shadow }
    }

    /// Returns pixels in shadow with the errors of a luminance mask.
    pub fn errors_in_shadow(&self, mask: &Mask) -> impl Iterator<Item = (usize, f64)> {
        let off = |(k, (own, truth)): (usize, (&[f32; 4], &[f32; 4]))| (k, f64::from(own[3]) - f64::from(truth[3]));
        let errors: Vec<_> = mask.values.iter().zip(&self.mask.values).enumerate().map(off).collect();
        errors.into_iter().filter(|&(k, _)| self.is_shadow[k])
    }
}

/// Errors of a mask over the pixels that the catcher covers entirely.
#[derive(Clone, Copy, Default)]
pub struct Errors {
    /// MSE of the luminance mask.
    pub mask: f64,
    /// The same over the pixels in shadow.
    pub shadow: f64,
    /// MSE of the composite, which is the photograph times the mask per channel.
    pub composite: f64,
    /// Mean error over the pixels in shadow.
    pub bias: f64,
}

impl Errors {
    /// Errors of a mask against the reference.
    pub fn of(mask: &Mask, truth: &Truth, photograph: &Photograph) -> Self {
        let (mut sums, mut pixels, mut shadowed) = (Self::default(), 0_u32, 0_u32);
        for (k, (own, exact)) in mask.values.iter().zip(&truth.mask.values).enumerate() {
            if !truth.is_filled[k] {
                continue;
            }
            let off: [f64; 4] = std::array::from_fn(|c| f64::from(own[c]) - f64::from(exact[c]));
            sums.mask += off[3] * off[3];
            let colors = photograph.image.pixels[k].iter().zip(off);
            sums.composite += colors.map(|(&color, off)| (f64::from(color) * off).powi(2)).sum::<f64>() / 3.0;
            pixels += 1;
            if truth.is_shadow[k] {
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

    /// Returns `self + weight * other`.
    pub fn plus(self, other: Self, weight: f64) -> Self {
        Self {
            mask: self.mask + weight * other.mask,
            shadow: self.shadow + weight * other.shadow,
            composite: self.composite + weight * other.composite,
            bias: self.bias + weight * other.bias,
        }
    }
}
