//! Checks of properties that a network does not guarantee: finite values, reciprocity, energy conservation.

use std::fmt;

use glam::{Vec2, Vec3};

use super::network::Network;
use crate::{
    brdf::{LobeMixture, luminance},
    error::{Error, Result},
    random::{Purpose, Stream},
};

/// Cosines of `wo` at which albedos are measured.
pub const VIEWS: [f32; 6] = [1.0, 0.9, 0.7, 0.5, 0.3, 0.1];
/// Largest `f_r cos` that is accepted, in 1/sr: `1 / (4 pi alpha^2)` of a Trowbridge-Reitz mirror with
/// `alpha` = 1e-4 at normal incidence.
const LARGEST_VALUE: f32 = 8e6;
/// Largest accepted bound on the logarithm: larger intermediate values leave no significant digits in a sum.
const LARGEST_BOUND: f32 = 1e6;
/// Directions per view, and pairs of directions.
const SAMPLES: usize = 4096;
/// Numbers of half-vector angles, difference-vector angles and azimuths of the search for the largest value.
const GRID: [usize; 3] = [24, 24, 8];

/// Rejects networks that overflow or exceed [`LARGEST_VALUE`].
pub(super) fn refuse_absurd(name: &str, network: &Network) -> Result<()> {
    let bound = network.bound();
    if bound.is_nan() || bound > LARGEST_BOUND {
        let reason = format!("its weights allow logarithms up to {bound:e}; at most {LARGEST_BOUND:e} is read");
        return Err(Error::argument(name, reason));
    }
    let largest =
        network.of_pairs(&half_vector_grid()).iter().fold(0.0_f32, |most, value| most.max(value.max_element()));
    if largest.is_nan() || largest > LARGEST_VALUE {
        let reason = format!("it reflects up to {largest:e} per steradian, more than any surface does");
        return Err(Error::argument(name, reason));
    }
    Ok(())
}

/// Pairs of directions whose half and difference vectors are on a grid, which is denser around mirror
/// directions.
fn half_vector_grid() -> Vec<[Vec3; 2]> {
    let [halves, differences, azimuths] = GRID;
    let mut pairs = Vec::new();
    for k in 0..halves * differences * azimuths {
        let place = |index: usize, of: usize| index as f32 / (of - 1) as f32;
        let theta_h = std::f32::consts::FRAC_PI_2 * place(k % halves, halves).powi(3);
        let theta_d = std::f32::consts::FRAC_PI_2 * place(k / halves % differences, differences);
        let phi = std::f32::consts::TAU * (k / halves / differences) as f32 / azimuths as f32;
        let d = Vec3::new(theta_d.sin() * phi.cos(), theta_d.sin() * phi.sin(), theta_d.cos());
        let turn = glam::Quat::from_rotation_y(theta_h);
        pairs.push([turn * Vec3::new(-d.x, -d.y, d.z), turn * d]);
    }
    pairs
}

/// Measured properties of a BRDF.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaterialCheck {
    /// The directional albedo per channel at each of [`VIEWS`]; above 1, energy is not conserved.
    pub albedos: [Vec3; VIEWS.len()],
    /// The mean of `|f_r(wo, wi) - f_r(wi, wo)|` over that of `f_r`, luminance times both cosines, over
    /// all pairs of directions.
    pub reciprocity_error: f64,
    /// The width of the narrowest lobe, see [`LobeMixture::alpha`].
    pub alpha: f32,
    /// The largest `f_r cos` towards the mirrored direction at [`VIEWS`], luminance in 1/sr; 1 / pi =
    /// 0.32 for a white diffuse surface seen from above.
    pub mirror_peak: f32,
    /// The relative variance of an estimate by the BRDF's own sampling under a white sky, averaged over
    /// views.
    pub own_variance: f64,
}

fn view(cos: f32) -> Vec3 {
    Vec3::new((1.0 - cos * cos).sqrt(), 0.0, cos)
}

impl MaterialCheck {
    pub(super) fn new(network: &Network, mixture: &LobeMixture) -> Self {
        let mirrored = |cos: f32| {
            let wo = view(cos);
            [wo, Vec3::new(-wo.x, 0.0, wo.z)]
        };
        let peaks = network.of_pairs(&VIEWS.map(mirrored));
        Self {
            albedos: VIEWS.map(|cos| albedo(network, mixture, cos)),
            reciprocity_error: reciprocity_error(network, mixture),
            alpha: mixture.alpha(),
            mirror_peak: peaks.into_iter().map(luminance).fold(0.0, f32::max),
            own_variance: mixture.relative_variance(),
        }
    }

    /// The largest albedo of any channel and view.
    pub fn largest_albedo(&self) -> f32 {
        self.albedos.iter().map(|albedo| albedo.max_element()).fold(0.0, f32::max)
    }
}

impl fmt::Display for MaterialCheck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let normal = luminance(self.albedos[0]);
        write!(
            f,
            "albedo {normal:.3} seen from above and {:.3} at most, reciprocity error {:.1} %, lobe width {:.3}, mirror peak {:.2}/sr, own relative \
             variance {:.2}",
            self.largest_albedo(),
            100.0 * self.reciprocity_error,
            self.alpha,
            self.mirror_peak,
            self.own_variance
        )?;
        if self.largest_albedo() > 1.0 { f.write_str("; reflects more than it receives") } else { Ok(()) }
    }
}

/// Estimates the directional albedo per channel by the BRDF's own sampling.
fn albedo(network: &Network, mixture: &LobeMixture, cos: f32) -> Vec3 {
    let wo = view(cos);
    let draw = |k: usize| {
        let u = Vec2::new((k as f32 + 0.5) / SAMPLES as f32, (k as u32).reverse_bits() as f32 / 4_294_967_296.0);
        mixture.draw_at(Vec3::Z, wo, u)
    };
    let drawn: Vec<(Vec3, f32)> = (0..SAMPLES).map(draw).filter(|(_, pdf)| *pdf > 0.0).collect();
    let pairs: Vec<[Vec3; 2]> = drawn.iter().map(|(wi, _)| [wo, *wi]).collect();
    let values = network.of_pairs(&pairs).into_iter().zip(drawn);
    values.map(|(value, (_, pdf))| value / pdf).sum::<Vec3>() / SAMPLES as f32
}

/// The relative mean difference between both directions of light, over pairs that the mixture draws for
/// cosine-distributed views.
fn reciprocity_error(network: &Network, mixture: &LobeMixture) -> f64 {
    let mut random = Stream::new(0, Purpose::Test, 0);
    let mut there = Vec::with_capacity(SAMPLES);
    let mut weights = Vec::with_capacity(SAMPLES);
    for _ in 0..SAMPLES {
        let cos = random.uniform().sqrt().max(1e-3);
        let wo = view(cos);
        let (wi, pdf) = mixture.draw_at(Vec3::Z, wo, random.uniform2());
        if pdf > 0.0 && wi.z > 1e-3 {
            there.push([wo, wi]);
            weights.push(1.0 / pdf);
        }
    }
    let back: Vec<[Vec3; 2]> = there.iter().map(|&[wo, wi]| [wi, wo]).collect();
    let (mut difference, mut sum) = (0.0, 0.0);
    let both = network.of_pairs(&there).into_iter().zip(network.of_pairs(&back));
    for (((there, back), [wo, wi]), weight) in both.zip(&there).zip(weights) {
        // Both values times the cosine of wi; the cosine of wo is in the density of views.
        let (there, back) = (luminance(there), luminance(back) / wo.z * wi.z);
        difference += f64::from((there - back).abs() * weight);
        sum += f64::from(there * weight);
    }
    if sum > 0.0 { difference / sum } else { 0.0 }
}
