//! A neural material as a BRDF over columns. Parameters: the features, the tangent's cosine and sine in
//! the frame of the normal, handedness.

use glam::{Vec2, Vec3};

use super::{
    FEATURES, LARGEST_LOG, Mixture, NeuralTexture,
    mixture::{OUTPUTS, lobe_weight, width},
    network::WIDEST,
};
use crate::{
    brdf::{Brdf, FlatBrdf, Kernel, Lambert, OF_MATERIAL, Surfaces},
    columns::vectorized,
    discrete::BELOW_ONE,
    frame::Frame,
    simd::{self, LANES, Lanes, Simd},
};

/// Number of parameters.
const PARAMETERS: usize = FEATURES + 3;

impl Brdf for NeuralTexture {
    fn parameters(&self) -> usize {
        PARAMETERS
    }

    fn evaluate_cosine(&self, at: &Surfaces<'_>, wi: [&[Lanes]; 3], out: [&mut [Lanes]; 3]) {
        evaluate_cosine(self, at, wi, out);
    }

    fn sample(&self, at: &Surfaces<'_>, u: [&[Lanes]; 2], wi: [&mut [Lanes]; 3], pdf: &mut [Lanes]) {
        sample(self, at, u, wi, pdf);
    }

    fn pdf(&self, at: &Surfaces<'_>, wi: [&[Lanes]; 3], out: &mut [Lanes]) {
        pdf(self, at, wi, out);
    }

    fn alpha(&self, at: &Surfaces<'_>, out: &mut [Lanes]) {
        alpha(self, at, out);
    }

    fn lobes(&self, at: &Surfaces<'_>, out: [&mut [Lanes]; 4]) {
        lobes(self, at, out);
    }

    fn frames(&self, at: &Surfaces<'_>, [sx, sy, sz, tx, ty, tz]: [&mut [Lanes]; 6]) {
        frames(at, [sx, sy, sz], [tx, ty, tz]);
    }

    fn features(&self, at: &Surfaces<'_>, out: [&mut [Lanes]; FEATURES]) {
        for (from, to) in at.parameters.iter().zip(out) {
            to.copy_from_slice(&from[..to.len()]);
        }
    }

    fn texture(&self, at: &Surfaces<'_>, out: [&mut [Lanes]; OF_MATERIAL]) {
        texture(at, out);
    }

    fn identity(&self) -> Option<blake3::Hash> {
        Some(self.hash())
    }

    fn flat(&self) -> Option<FlatBrdf> {
        Some(FlatBrdf::Neural(self.flat_numbers()))
    }
}

/// The tangent frame of one lane: the frame of the normal, rotated to the tangent.
#[inline(always)]
fn tangent_frame(at: &Strip, lane: usize) -> Frame {
    let n = Vec3::new(at.n[0][lane], at.n[1][lane], at.n[2][lane]);
    let Frame { s, t, .. } = Frame::from_normal(n);
    let (cos, sin, hand) = (at.tangent[0][lane], at.tangent[1][lane], at.tangent[2][lane]);
    Frame { s: s * cos + t * sin, t: (t * cos - s * sin) * hand, n }
}

/// One loaded strip of surfaces: the networks' inputs, and directions to the viewer in the tangent frame.
struct Strip {
    /// Features, then `wo.xy`, and two rows for `wi.xy`.
    input: [Lanes; FEATURES + 4],
    n: [Lanes; 3],
    wo: [Lanes; 3],
    tangent: [Lanes; 3],
}

impl Strip {
    #[inline(always)]
    fn load(at: &Surfaces<'_>, strip: usize) -> Self {
        let mut input = [[0.0; LANES]; FEATURES + 4];
        for k in 0..FEATURES {
            input[k] = at.parameters[k][strip];
        }
        let [n, world] = [at.n, at.wo].map(|column| [column[0][strip], column[1][strip], column[2][strip]]);
        let tangent = [8, 9, 10].map(|k: usize| at.parameters[k][strip]);
        let mut loaded = Self { input, n, wo: [[0.0; LANES]; 3], tangent };
        loaded.wo = loaded.to_local(&world);
        loaded.input[FEATURES] = loaded.wo[0];
        loaded.input[FEATURES + 1] = loaded.wo[1];
        loaded
    }

    #[inline(always)]
    fn to_local(&self, world: &[Lanes; 3]) -> [Lanes; 3] {
        let mut local = [[0.0; LANES]; 3];
        for lane in 0..LANES {
            let w = Vec3::new(world[0][lane], world[1][lane], world[2][lane]);
            let w = tangent_frame(self, lane).to_local(w);
            (local[0][lane], local[1][lane], local[2][lane]) = (w.x, w.y, w.z);
        }
        local
    }

    /// Outputs of the mixture's network.
    #[inline(always)]
    fn mixture<S: Simd>(&self, simd: S, material: &NeuralTexture) -> [Lanes; OUTPUTS] {
        let mut out = [[0.0; LANES]; WIDEST];
        material.mixture.forward(simd, &self.input[..FEATURES + 2], &mut out);
        let mut raw = [[0.0; LANES]; OUTPUTS];
        raw.copy_from_slice(&out[..OUTPUTS]);
        raw
    }
}

#[inline(always)]
fn mixture_of(raw: &[Lanes; OUTPUTS], lane: usize) -> Mixture {
    Mixture::of([raw[0][lane], raw[1][lane], raw[2][lane], raw[3][lane], raw[4][lane]])
}

vectorized! {
    fn evaluate_cosine['a](
        simd, material: &'a NeuralTexture, at: &'a Surfaces<'a>, wi: [&'a [Lanes]; 3], out: [&'a mut [Lanes]; 3],
    ) {
        let [red, green, blue] = out;
        for strip in 0..red.len() {
            let mut surfaces = Strip::load(at, strip);
            let local = surfaces.to_local(&[wi[0][strip], wi[1][strip], wi[2][strip]]);
            surfaces.input[FEATURES + 2] = local[0];
            surfaces.input[FEATURES + 3] = local[1];
            let mut logs = [[0.0; LANES]; WIDEST];
            material.reflectance.forward(simd, &surfaces.input, &mut logs);
            let mut cosine = [0.0; LANES];
            for lane in 0..LANES {
                let both = (local[2][lane] > 0.0) & (surfaces.wo[2][lane] > 0.0);
                cosine[lane] = if both { local[2][lane] } else { 0.0 };
            }
            for (k, column) in [&mut *red, &mut *green, &mut *blue].into_iter().enumerate() {
                for lane in 0..LANES {
                    let log = logs[k][lane];
                    let log = if log < LARGEST_LOG { log } else { LARGEST_LOG };
                    column[strip][lane] = cosine[lane] * simd::exp(log);
                }
            }
        }
    }
}

vectorized! {
    fn sample['a](
        simd, material: &'a NeuralTexture, at: &'a Surfaces<'a>, u: [&'a [Lanes]; 2], wi: [&'a mut [Lanes]; 3],
        pdf: &'a mut [Lanes],
    ) {
        let [x, y, z] = wi;
        for strip in 0..pdf.len() {
            let surfaces = Strip::load(at, strip);
            let raw = surfaces.mixture(simd, material);
            let u = [u[0][strip], u[1][strip]];
            let (mut drawn, mut pdfs) = ([[0.0; LANES]; 3], [0.0; LANES]);
            for lane in 0..LANES {
                let mixture = mixture_of(&raw, lane);
                let wo = Vec3::new(surfaces.wo[0][lane], surfaces.wo[1][lane], surfaces.wo[2][lane]);
                let mirrors = u[0][lane] < mixture.lobe_weight;
                // Stretches the chosen part of the number to the whole interval; a quotient may round
                // up to 1.
                let rest = (u[0][lane] - mixture.lobe_weight) / (1.0 - mixture.lobe_weight);
                let first = if mirrors { u[0][lane] / mixture.lobe_weight } else { rest };
                let stretched = Vec2::new(if first < BELOW_ONE { first } else { BELOW_ONE }, u[1][lane]);
                let mirrored = mixture.mirrored(wo, stretched);
                let (diffuse, _) = Lambert { albedo: Vec3::ONE }.sample(Vec3::Z, Vec3::Z, stretched);
                let pick = |a: f32, b: f32| if mirrors { a } else { b };
                let w = Vec3::new(pick(mirrored.x, diffuse.x), pick(mirrored.y, diffuse.y), pick(mirrored.z, diffuse.z));
                pdfs[lane] = mixture.pdf(wo, w);
                let world = tangent_frame(&surfaces, lane).to_world(w);
                (drawn[0][lane], drawn[1][lane], drawn[2][lane]) = (world.x, world.y, world.z);
            }
            (x[strip], y[strip], z[strip]) = (drawn[0], drawn[1], drawn[2]);
            pdf[strip] = pdfs;
        }
    }
}

vectorized! {
    fn pdf['a](
        simd, material: &'a NeuralTexture, at: &'a Surfaces<'a>, wi: [&'a [Lanes]; 3], out: &'a mut [Lanes],
    ) {
        for strip in 0..out.len() {
            let surfaces = Strip::load(at, strip);
            let local = surfaces.to_local(&[wi[0][strip], wi[1][strip], wi[2][strip]]);
            let raw = surfaces.mixture(simd, material);
            let mut pdfs = [0.0; LANES];
            for lane in 0..LANES {
                let wo = Vec3::new(surfaces.wo[0][lane], surfaces.wo[1][lane], surfaces.wo[2][lane]);
                let wi = Vec3::new(local[0][lane], local[1][lane], local[2][lane]);
                pdfs[lane] = mixture_of(&raw, lane).pdf(wo, wi);
            }
            out[strip] = pdfs;
        }
    }
}

vectorized! {
    fn alpha['a](simd, material: &'a NeuralTexture, at: &'a Surfaces<'a>, out: &'a mut [Lanes]) {
        for strip in 0..out.len() {
            let raw = Strip::load(at, strip).mixture(simd, material);
            for lane in 0..LANES {
                out[strip][lane] = width(raw[6][lane]);
            }
        }
    }
}

vectorized! {
    fn lobes['a](simd, material: &'a NeuralTexture, at: &'a Surfaces<'a>, out: [&'a mut [Lanes]; 4]) {
        let [diffuse, specular, f0, alpha] = out;
        for strip in 0..alpha.len() {
            let raw = Strip::load(at, strip).mixture(simd, material);
            for lane in 0..LANES {
                let lobe_weight = lobe_weight(raw[5][lane]);
                diffuse[strip][lane] = 1.0 - lobe_weight;
                specular[strip][lane] = lobe_weight;
                f0[strip][lane] = 1.0;
                alpha[strip][lane] = width(raw[6][lane]);
            }
        }
    }
}

vectorized! {
    fn frames['a](_simd, at: &'a Surfaces<'a>, s: [&'a mut [Lanes]; 3], t: [&'a mut [Lanes]; 3]) {
        for strip in 0..s[0].len() {
            let surfaces = Strip::load(at, strip);
            for lane in 0..LANES {
                let Frame { s: first, t: second, .. } = tangent_frame(&surfaces, lane);
                (s[0][strip][lane], s[1][strip][lane], s[2][strip][lane]) = (first.x, first.y, first.z);
                (t[0][strip][lane], t[1][strip][lane], t[2][strip][lane]) = (second.x, second.y, second.z);
            }
        }
    }
}

vectorized! {
    fn texture['a](_simd, at: &'a Surfaces<'a>, out: [&'a mut [Lanes]; OF_MATERIAL]) {
        let [a, b, c, d, e, f, g, h, x, y, z, hand] = out;
        for strip in 0..hand.len() {
            let surfaces = Strip::load(at, strip);
            for (k, column) in [&mut *a, &mut *b, &mut *c, &mut *d, &mut *e, &mut *f, &mut *g, &mut *h].into_iter().enumerate() {
                column[strip] = surfaces.input[k];
            }
            for lane in 0..LANES {
                let Frame { s, .. } = tangent_frame(&surfaces, lane);
                (x[strip][lane], y[strip][lane], z[strip][lane]) = (s.x, s.y, s.z);
            }
            hand[strip] = surfaces.tangent[2];
        }
    }
}
