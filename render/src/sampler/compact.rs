//! Compact emitters sampled on their own, in a mixture with a sampler for the rest of the light.

use std::sync::Arc;

use glam::{Vec2, Vec3A};

use super::{CoversIntegrand, DirectionSample, DirectionSampler, EnvironmentLight, ShadingPoint};
use crate::{
    color::luminance,
    environment::{Environment, compact_emitters},
    error::{Error, Result},
    tail::{Tail, TailKind},
};

/// Points at which the light of an emitter, and of the rest, is judged for a shading point.
const POINTS: usize = 8;
/// Least share of samples of each emitter: a disc on the horizon may be seen by a corner that no point shows.
const LEAST_SHARE: f32 = 0.01;
/// Least share of the rest.
const LEAST_REST: f32 = 0.05;
/// Columns and rows of the coarse map of the rest.
const COARSE: (usize, usize) = (64, 32);
/// Most emitters of a map, and the rest.
const MOST_SHARES: usize = 5;

/// The compact emitters of a map, and a coarse map of the rest.
#[derive(Clone, Debug)]
pub struct CompactEmitters {
    emitters: Vec<Emitter>,
    /// Mean luminance of the rest, `[COARSE.1 * COARSE.0]`.
    coarse: Vec<f32>,
}

#[derive(Clone, Debug)]
struct Emitter {
    light: EnvironmentLight,
    /// Integral of its luminance over solid angle.
    power: f32,
    /// Directions spread over it in proportion to its light.
    towards: [Vec3A; POINTS],
}

impl CompactEmitters {
    /// The emitters of a map that was brought down to `rest`, see [`crate::environment::without_compact_emitters`].
    ///
    /// # Errors
    /// `rest` is not of the map's size, is brighter than the map, or leaves no emitters or too many.
    pub fn new(environment: &Arc<Environment>, rest: &[f32]) -> Result<Self> {
        let (width, height, map) = (environment.width(), environment.height(), environment.luminance());
        // To rounding: another processor may add the three channels in another order.
        if rest.len() != map.len() || rest.iter().zip(&map).any(|(rest, map)| !(0.0..=map * 1.000_01).contains(rest)) {
            return Err(Error::argument("tail.luminance", "is not a part of the map's: the file is damaged"));
        }
        // What is equal to rounding is equal.
        let clean: Vec<f32> =
            rest.iter().zip(&map).map(|(&rest, &map)| if rest >= map * 0.999_99 { map } else { rest }).collect();
        let parts = compact_emitters(width, height, &map, &clean).ok_or_else(|| {
            Error::argument("compact_emitters", "the map and the file differ by no emitter, or by too many")
        })?;
        let emitters = parts.iter().map(|part| Emitter::new(environment, part)).collect::<Result<_>>()?;
        Ok(Self { emitters, coarse: coarse(width, height, &clean) })
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.emitters.len()
    }

    /// The share of samples of each emitter, then of the rest: in proportion to the light that a shading point reflects of each, as
    /// far as a few fixed points show it.
    fn shares(&self, at: &ShadingPoint) -> [f32; MOST_SHARES] {
        let mut shares = [0.0; MOST_SHARES];
        let count = self.emitters.len();
        for (share, emitter) in shares.iter_mut().zip(&self.emitters) {
            let reflected: f32 = emitter.towards.iter().map(|&wi| luminance(at.brdf_cosine(wi))).sum();
            *share = reflected / POINTS as f32 * emitter.power;
        }
        shares[count] = self.reflected_rest(at);
        let total: f32 = shares.iter().sum();
        if !(total > 0.0 && total.is_finite()) {
            shares[..=count].fill(1.0 / (count + 1) as f32);
            return shares;
        }
        let free = 1.0 - LEAST_REST - LEAST_SHARE * count as f32;
        for (index, share) in shares[..=count].iter_mut().enumerate() {
            *share = *share / total * free + if index == count { LEAST_REST } else { LEAST_SHARE };
        }
        shares
    }

    /// The light of the rest that a shading point reflects, by a few BRDF samples in the coarse map.
    fn reflected_rest(&self, at: &ShadingPoint) -> f32 {
        let estimate = |k: usize| {
            let u = Vec2::new((k as f32 + 0.5) / POINTS as f32, radical_inverse(k));
            let (wi, pdf) = at.brdf.sample(at.ns, at.wo, u)?;
            let x = crate::latlong::square(wi);
            let column = ((x.x * COARSE.0 as f32) as usize).min(COARSE.0 - 1);
            let row = ((x.y * COARSE.1 as f32) as usize).min(COARSE.1 - 1);
            Some(luminance(at.brdf_cosine(wi)) / pdf * self.coarse[row * COARSE.0 + column])
        };
        (0..POINTS).filter_map(estimate).filter(|value| value.is_finite()).sum::<f32>() / POINTS as f32
    }
}

/// Van der Corput's sequence in base 2, shifted off 0.
fn radical_inverse(k: usize) -> f32 {
    (k as u32).reverse_bits() as f32 / 4_294_967_296.0 + 0.5 / POINTS as f32
}

/// Means over cells of the sphere.
fn coarse(width: usize, height: usize, luminance: &[f32]) -> Vec<f32> {
    let mut sums = vec![(0.0_f64, 0.0_f64); COARSE.0 * COARSE.1];
    for (k, &value) in luminance.iter().enumerate() {
        let v = (k / width) as f32 / (height - 1) as f32;
        let row = ((v * COARSE.1 as f32) as usize).min(COARSE.1 - 1);
        let weight = f64::from(crate::latlong::sin_theta(v));
        let cell = &mut sums[row * COARSE.0 + (k % width) * COARSE.0 / width];
        *cell = (cell.0 + weight * f64::from(value), cell.1 + weight);
    }
    let mean: f64 = sums.iter().map(|sum| sum.0).sum::<f64>() / sums.iter().map(|sum| sum.1).sum::<f64>();
    // Maps smaller than the grid leave cells without a texel.
    sums.iter().map(|&(sum, weight)| if weight > 0.0 { sum / weight } else { mean } as f32).collect()
}

impl Emitter {
    fn new(environment: &Arc<Environment>, luminance: &[f32]) -> Result<Self> {
        let (width, height) = (environment.width(), environment.height());
        let tail = Tail::new(TailKind::RowColumn, width, height, luminance)?;
        let light = EnvironmentLight::with_tail(environment.clone(), Arc::new(tail));
        let towards = std::array::from_fn(|k| {
            let y = Vec2::new((k as f32 + 0.5) / POINTS as f32, radical_inverse(k));
            light.tail().forward_direction(y).1
        });
        let power = light.tail().light().power() as f32;
        Ok(Self { light, power, towards })
    }
}

/// The mixture of compact emitters with a sampler of the rest. Its shares depend on the shading point, its pdf is that of the
/// mixture.
#[derive(Clone, Debug)]
pub struct WithCompactEmitters<S> {
    compact: Arc<CompactEmitters>,
    rest: S,
}

impl<S> WithCompactEmitters<S> {
    /// The mixture; `rest` covers the integrand with the light of the rest.
    pub fn new(compact: Arc<CompactEmitters>, rest: S) -> Self {
        Self { compact, rest }
    }
}

impl<S: DirectionSampler> WithCompactEmitters<S> {
    /// The mixture's pdf, with that of the rest given.
    fn mixed(&self, shares: &[f32; MOST_SHARES], of_rest: f32, wi: Vec3A) -> f32 {
        let emitters = &self.compact.emitters;
        let of_emitters: f32 = emitters.iter().zip(shares).map(|(emitter, share)| share * emitter.light.pdf(wi)).sum();
        of_emitters + shares[emitters.len()] * of_rest
    }
}

impl<S: DirectionSampler> DirectionSampler for WithCompactEmitters<S> {
    type Prepared = ([f32; MOST_SHARES], S::Prepared);

    fn prepare(&self, at: &ShadingPoint) -> Self::Prepared {
        (self.compact.shares(at), self.rest.prepare(at))
    }

    fn sample(&self, (shares, rest): &Self::Prepared, at: &ShadingPoint, u: Vec2) -> Option<DirectionSample> {
        /// The largest f32 below 1.
        const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;
        let mut before = 0.0;
        for (emitter, &share) in self.compact.emitters.iter().zip(shares) {
            if u.x < before + share {
                let stretched = ((u.x - before) / share).clamp(0.0, BELOW_ONE);
                let mut sample = emitter.light.sample_through_tail(Vec2::new(stretched, u.y), 1.0)?;
                sample.pdf = self.mixed(shares, self.rest.pdf(rest, at, sample.wi), sample.wi);
                return Some(sample);
            }
            before += share;
        }
        let stretched = ((u.x - before) / (1.0 - before)).clamp(0.0, BELOW_ONE);
        let mut sample = self.rest.sample(rest, at, Vec2::new(stretched, u.y))?;
        sample.pdf = self.mixed(shares, sample.pdf, sample.wi);
        Some(sample)
    }

    fn share_batch(&self, _at: &[ShadingPoint], shares: &mut [f32]) {
        shares.fill(0.5);
    }

    fn pdf(&self, (shares, rest): &Self::Prepared, at: &ShadingPoint, wi: Vec3A) -> f32 {
        self.mixed(shares, self.rest.pdf(rest, at, wi), wi)
    }
}

impl<S: CoversIntegrand> CoversIntegrand for WithCompactEmitters<S> {}
