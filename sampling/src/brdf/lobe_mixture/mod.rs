//! BRDF sampling for BRDFs without a sampling method of their own: a mixture of a cosine lobe and
//! Trowbridge-Reitz lobes, fitted to the BRDF, with the exact pdf of the mixture.
//!
//! The widths of the lobes are fixed per BRDF; their weights depend on the cosine of `wo`. The specular
//! lobes are sampled by visible normals.

mod fit;

use glam::{Vec2, Vec3};

use super::{Ggx, Kernel, Lambert, Surfaces, parameters::LATENTS};
use crate::{
    columns::vectorized,
    discrete::BELOW_ONE,
    simd::{LANES, Lanes},
};

/// Number of Trowbridge-Reitz lobes of a mixture.
const LOBES: usize = 3;
/// Nodes along the square root of the cosine of `wo`, between which weights are linear.
const NODES: usize = 16;

/// Weights at one cosine of `wo`.
#[derive(Clone, Copy, Debug, Default)]
struct Weights {
    /// The weight of the cosine lobe, then those of the others; their sum is 1.
    techniques: [f32; LOBES + 1],
    /// Weight and width of the lobe in the closest approximation by a single Trowbridge-Reitz lobe.
    single: [f32; 2],
}

/// A mixture of lobes fitted to a BRDF.
#[derive(Clone, Debug)]
pub struct LobeMixture {
    /// The widths of the lobes, the narrowest first.
    alphas: [f32; LOBES],
    nodes: Box<[Weights; NODES]>,
    /// The relative second moment, averaged over the nodes.
    second_moment: f64,
}

/// The cosine of a node.
fn cosine_of(node: usize) -> f32 {
    (node as f32 / (NODES - 1) as f32).powi(2)
}

impl LobeMixture {
    /// The widths of the Trowbridge-Reitz lobes, the narrowest first.
    pub fn alphas(&self) -> [f32; LOBES] {
        self.alphas
    }

    /// The relative variance of an estimate under a white sky, averaged over views.
    pub fn relative_variance(&self) -> f64 {
        self.second_moment - 1.0
    }

    /// The width of the narrowest lobe that gets more than 10 % of the samples at some view; 1 if there
    /// is none.
    pub fn alpha(&self) -> f32 {
        let counts = |lobe: usize| self.nodes.iter().any(|node| node.techniques[lobe + 1] > 0.1);
        (0..LOBES).find(|&lobe| counts(lobe)).map_or(1.0, |lobe| self.alphas[lobe])
    }

    /// Draws a direction at one point; returns it and its pdf.
    pub fn draw_at(&self, n: Vec3, wo: Vec3, u: Vec2) -> (Vec3, f32) {
        self.draw(&self.techniques(n.dot(wo)), n, wo, u)
    }

    /// The pdf of a direction, at one point.
    pub fn pdf_at(&self, n: Vec3, wo: Vec3, wi: Vec3) -> f32 {
        self.density(&self.techniques(n.dot(wo)), n, wo, wi)
    }

    /// Describes the mixture by numbers of the order of 1: at cosines 0.8 and 0.3, the weight of the
    /// closest single lobe, 1/4 of the logarithm of its width, and the weight of the cosine lobe.
    pub fn latent(&self) -> [f32; LATENTS] {
        let of = |cos: f32| {
            let (node, _) = Self::place(cos);
            let Weights { techniques, single } = self.nodes[node as usize];
            [single[0], 0.25 * single[1].ln(), techniques[0]]
        };
        let [[a, b, c], [d, e, f]] = [of(0.8), of(0.3)];
        [a, b, c, d, e, f]
    }

    /// Appends the numbers of [`super::FlatBrdf::Measured`].
    pub(super) fn append_to(&self, out: &mut Vec<f32>) {
        out.extend(self.alphas);
        out.extend(self.nodes.iter().flat_map(|node| node.techniques.into_iter().chain(node.single)));
    }

    /// [`super::Brdf::sample`].
    pub fn sample(&self, at: &Surfaces<'_>, u: [&[Lanes]; 2], wi: [&mut [Lanes]; 3], pdf: &mut [Lanes]) {
        sample(self, at, u, wi, pdf);
    }

    /// [`super::Brdf::pdf`].
    pub fn pdf(&self, at: &Surfaces<'_>, wi: [&[Lanes]; 3], out: &mut [Lanes]) {
        pdf(self, at, wi, out);
    }

    /// [`super::Brdf::lobes`].
    pub fn lobes(&self, at: &Surfaces<'_>, out: [&mut [Lanes]; 4]) {
        lobes(self, at, out);
    }

    /// The node below a cosine and the distance to it in nodes.
    #[inline(always)]
    fn place(cos: f32) -> (i32, f32) {
        let cos = if cos > 0.0 { cos } else { 0.0 };
        let place = if cos < 1.0 { cos } else { 1.0 }.sqrt() * (NODES - 1) as f32;
        let node = place as i32;
        let node = if node < NODES as i32 - 2 { node } else { NODES as i32 - 2 };
        (node, place - node as f32)
    }

    /// The weights of the techniques at a cosine of `wo`.
    #[inline(always)]
    fn techniques(&self, cos_o: f32) -> [f32; LOBES + 1] {
        let (node, t) = Self::place(cos_o);
        let (near, far) = (&self.nodes[node as usize].techniques, &self.nodes[node as usize + 1].techniques);
        let mut mixed = [0.0; LOBES + 1];
        for k in 0..=LOBES {
            mixed[k] = near[k] + t * (far[k] - near[k]);
        }
        mixed
    }

    /// The pdf of the mixture at one point.
    #[inline(always)]
    fn density(&self, techniques: &[f32; LOBES + 1], n: Vec3, wo: Vec3, wi: Vec3) -> f32 {
        let mut mixed = techniques[0] * DIFFUSE.pdf(n, wo, wi);
        for k in 0..LOBES {
            mixed += techniques[k + 1] * Ggx::of(self.alphas[k], Vec3::ONE).pdf(n, wo, wi);
        }
        if (n.dot(wo) > 0.0) & (n.dot(wi) > 0.0) { mixed } else { 0.0 }
    }

    /// Draws a direction at one point; returns it and its pdf, which integrates to 1 minus what the
    /// specular lobes lose below the horizon.
    #[inline(always)]
    fn draw(&self, techniques: &[f32; LOBES + 1], n: Vec3, wo: Vec3, u: Vec2) -> (Vec3, f32) {
        // Chooses the technique whose part of the unit interval contains u.x, and stretches that part
        // to reuse u.x.
        let (mut from, mut to, mut alpha) = (0.0, techniques[0], 1.0);
        let mut sum = techniques[0];
        let is_diffuse = u.x < sum;
        for k in 0..LOBES {
            let is_beyond = (u.x >= sum) & (techniques[k + 1] > 0.0);
            from = if is_beyond { sum } else { from };
            sum += techniques[k + 1];
            to = if is_beyond { sum } else { to };
            alpha = if is_beyond { self.alphas[k] } else { alpha };
        }
        let x = (u.x - from) / (to - from);
        let stretched = Vec2::new(if x < BELOW_ONE { x } else { BELOW_ONE }, u.y);
        let (specular, _) = Ggx::of(alpha, Vec3::ONE).sample(n, wo, stretched);
        let (diffuse, _) = DIFFUSE.sample(n, wo, stretched);
        let pick = |a: f32, b: f32| if is_diffuse { a } else { b };
        let wi = Vec3::new(pick(diffuse.x, specular.x), pick(diffuse.y, specular.y), pick(diffuse.z, specular.z));
        (wi, self.density(techniques, n, wo, wi))
    }
}

const DIFFUSE: Lambert = Lambert { albedo: Vec3::ONE };

/// The vector of one lane of a strip.
#[inline(always)]
fn vector(columns: [&[Lanes]; 3], strip: usize, lane: usize) -> Vec3 {
    Vec3::new(columns[0][strip][lane], columns[1][strip][lane], columns[2][strip][lane])
}

/// The weights of the techniques for a strip of points.
#[inline(always)]
fn techniques_of(mixture: &LobeMixture, at: &Surfaces<'_>, strip: usize) -> [Lanes; LOBES + 1] {
    let mut techniques = [[0.0; LANES]; LOBES + 1];
    for lane in 0..LANES {
        let own = mixture.techniques(vector(at.n, strip, lane).dot(vector(at.wo, strip, lane)));
        for k in 0..=LOBES {
            techniques[k][lane] = own[k];
        }
    }
    techniques
}

vectorized! {
    fn sample['a](
        _simd, mixture: &'a LobeMixture, at: &'a Surfaces<'a>, u: [&'a [Lanes]; 2], wi: [&'a mut [Lanes]; 3], pdf: &'a mut [Lanes],
    ) {
        let [x, y, z] = wi;
        for strip in 0..pdf.len() {
            let techniques = techniques_of(mixture, at, strip);
            let (mut drawn, mut pdfs) = ([[0.0; LANES]; 3], [0.0; LANES]);
            for lane in 0..LANES {
                let own = [techniques[0][lane], techniques[1][lane], techniques[2][lane], techniques[3][lane]];
                let (n, wo) = (vector(at.n, strip, lane), vector(at.wo, strip, lane));
                let (w, density) = mixture.draw(&own, n, wo, Vec2::new(u[0][strip][lane], u[1][strip][lane]));
                (drawn[0][lane], drawn[1][lane], drawn[2][lane]) = (w.x, w.y, w.z);
                pdfs[lane] = density;
            }
            (x[strip], y[strip], z[strip]) = (drawn[0], drawn[1], drawn[2]);
            pdf[strip] = pdfs;
        }
    }
}

vectorized! {
    fn pdf['a](_simd, mixture: &'a LobeMixture, at: &'a Surfaces<'a>, wi: [&'a [Lanes]; 3], out: &'a mut [Lanes]) {
        for strip in 0..out.len() {
            let techniques = techniques_of(mixture, at, strip);
            let mut pdfs = [0.0; LANES];
            for lane in 0..LANES {
                let own = [techniques[0][lane], techniques[1][lane], techniques[2][lane], techniques[3][lane]];
                let (n, wo) = (vector(at.n, strip, lane), vector(at.wo, strip, lane));
                pdfs[lane] = mixture.density(&own, n, wo, vector(wi, strip, lane));
            }
            out[strip] = pdfs;
        }
    }
}

vectorized! {
    fn lobes['a](_simd, mixture: &'a LobeMixture, at: &'a Surfaces<'a>, out: [&'a mut [Lanes]; 4]) {
        let [diffuse, specular, f0, alpha] = out;
        for strip in 0..alpha.len() {
            for lane in 0..LANES {
                let (node, t) = LobeMixture::place(vector(at.n, strip, lane).dot(vector(at.wo, strip, lane)));
                let (near, far) = (&mixture.nodes[node as usize].single, &mixture.nodes[node as usize + 1].single);
                let lobe_weight = near[0] + t * (far[0] - near[0]);
                diffuse[strip][lane] = 1.0 - lobe_weight;
                specular[strip][lane] = lobe_weight;
                f0[strip][lane] = 1.0;
                alpha[strip][lane] = near[1] + t * (far[1] - near[1]);
            }
        }
    }
}
