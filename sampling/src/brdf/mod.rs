//! BRDFs. A [`Kernel`] evaluates one sample; [`Brdf`] runs it over columns of samples in SIMD lanes.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | the traits `Kernel` (one sample) and `Brdf` (columns) |
//! | `table.rs`, `parameters.rs` | the table of BRDFs, and their parameters |
//! | `lambert.rs`, `ggx.rs`, `metallic_roughness.rs` | analytic BRDFs |
//! | `lobe_albedo.rs` | the tabulated albedo of the specular lobe |
//! | `lobe_mixture/` | fitted BRDF sampling, for BRDFs without their own |
//! | `neural/` | measured materials as networks |
//! | `neural_texture/` | neural materials over a surface |

mod ggx;
mod lambert;
mod lobe_albedo;
mod lobe_mixture;
mod metallic_roughness;
pub mod neural;
pub mod neural_texture;
mod parameters;
mod table;

pub use ggx::Ggx;
pub use lambert::Lambert;
pub use lobe_albedo::{flat_lobe_albedo, tabulate as tabulate_lobe_albedo};
pub use lobe_mixture::LobeMixture;
pub use metallic_roughness::MetallicRoughness;
pub use neural_texture::NeuralTexture;
pub use parameters::{LATENTS, MAX_PARAMETERS};
pub use table::{BrdfTable, Surface};

use std::{fmt, marker::PhantomData};

use glam::{Vec2, Vec3};

use crate::{
    columns::vectorized,
    frame::Frame,
    simd::{LANES, Lanes},
};

/// Numbers of a textured material that a head reads: features, a tangent, and the handedness.
pub const OF_MATERIAL: usize = neural_texture::FEATURES + 4;

/// A BRDF at one point with its parameters. Functions are `#[inline(always)]` and free of branches and
/// calls, so that loops over them are vectorized.
///
/// Directions are unit vectors that point away from the surface; `n` is the shading normal.
pub trait Kernel: Copy + fmt::Debug + Send + Sync + 'static {
    /// Number of parameters, at most [`MAX_PARAMETERS`].
    const PARAMETERS: usize;

    /// Makes the BRDF of its parameters.
    fn of_parameters(parameters: &[f32; MAX_PARAMETERS]) -> Self;

    /// The parameters, followed by zeros.
    fn parameters(&self) -> [f32; MAX_PARAMETERS];

    /// `f_r(wo, wi) max(0, n . wi)` per channel, in 1/sr.
    fn evaluate_cosine(&self, n: Vec3, wo: Vec3, wi: Vec3) -> Vec3;

    /// Draws a direction from an approximation of `f_r cos`: `(wi, solid-angle pdf)`; pdf 0 means no sample.
    fn sample(&self, n: Vec3, wo: Vec3, u: Vec2) -> (Vec3, f32);

    /// The solid-angle pdf of [`Self::sample`].
    fn pdf(&self, n: Vec3, wo: Vec3, wi: Vec3) -> f32;

    /// The Trowbridge-Reitz width of the narrowest lobe; 1 for a diffuse surface.
    fn alpha(&self) -> f32;

    /// The approximation by two lobes at `cos_o = n . wo`, for samplers in closed form.
    fn lobes(&self, cos_o: f32) -> Lobes;
}

/// A BRDF as a diffuse lobe and a Trowbridge-Reitz lobe. Only their ratio matters.
#[derive(Clone, Copy, Debug)]
pub struct Lobes {
    /// Luminance of the diffuse reflectance.
    pub diffuse: f32,
    /// Weight of the Trowbridge-Reitz lobe; 0 if there is none.
    pub specular: f32,
    /// Luminance of that lobe's reflectance at normal incidence.
    pub f0: f32,
    /// Width of that lobe.
    pub alpha: f32,
}

/// The luminance of a reflectance per channel.
#[inline(always)]
fn luminance(c: Vec3) -> f32 {
    0.2126 * c.x + 0.7152 * c.y + 0.0722 * c.z
}

/// Columns of shading points that BRDFs read.
#[derive(Clone, Copy, Debug)]
pub struct Surfaces<'a> {
    /// Shading normals.
    pub n: [&'a [Lanes]; 3],
    /// Directions to the viewer.
    pub wo: [&'a [Lanes]; 3],
    /// Parameters; only those that the BRDF has are valid.
    pub parameters: [&'a [Lanes]; MAX_PARAMETERS],
}

/// A BRDF over columns; all columns of a call have the same number of strips. BRDFs of single points
/// implement [`Kernel`]; those that are evaluated in batches (networks) implement this trait.
pub trait Brdf: fmt::Debug + Send + Sync {
    /// Number of parameters.
    fn parameters(&self) -> usize;

    /// [`Kernel::evaluate_cosine`].
    fn evaluate_cosine(&self, at: &Surfaces<'_>, wi: [&[Lanes]; 3], out: [&mut [Lanes]; 3]);

    /// [`Kernel::sample`].
    fn sample(&self, at: &Surfaces<'_>, u: [&[Lanes]; 2], wi: [&mut [Lanes]; 3], pdf: &mut [Lanes]);

    /// [`Kernel::pdf`].
    fn pdf(&self, at: &Surfaces<'_>, wi: [&[Lanes]; 3], out: &mut [Lanes]);

    /// [`Kernel::alpha`].
    fn alpha(&self, at: &Surfaces<'_>, out: &mut [Lanes]);

    /// [`Kernel::lobes`]: columns of diffuse, specular, f0 and alpha.
    fn lobes(&self, at: &Surfaces<'_>, out: [&mut [Lanes]; 4]);

    /// A description for heads that serve many materials; zeros by default.
    fn latent(&self) -> [f32; LATENTS] {
        [0.0; LATENTS]
    }

    /// Computes the tangents `s` and `t` of the material's frame, whose third axis is the normal:
    /// columns of x, y and z for each. By default the material is isotropic, and `s` is the direction
    /// to the viewer projected onto the surface.
    fn frames(&self, at: &Surfaces<'_>, [sx, sy, sz, tx, ty, tz]: [&mut [Lanes]; 6]) {
        frames_of_views(at, [sx, sy, sz], [tx, ty, tz]);
    }

    /// Features of a neural material's texture at the points; zeros by default.
    fn features(&self, _at: &Surfaces<'_>, out: [&mut [Lanes]; neural_texture::FEATURES]) {
        out.into_iter().for_each(|column| column.fill([0.0; LANES]));
    }

    /// Inputs of heads from a neural texture: its features, the first tangent, and the handedness;
    /// zeros for other BRDFs.
    fn texture(&self, _at: &Surfaces<'_>, out: [&mut [Lanes]; OF_MATERIAL]) {
        out.into_iter().for_each(|column| column.fill([0.0; LANES]));
    }

    /// A hash of the BRDF's content, if it has one, which identifies samplers made for it.
    fn identity(&self) -> Option<blake3::Hash> {
        None
    }

    /// The BRDF for implementations on other devices; `None` for analytic ones, and by default.
    fn flat(&self) -> Option<FlatBrdf> {
        None
    }

    /// Findings from loading the BRDF: a line for the user.
    fn note(&self) -> Option<String> {
        None
    }
}

/// A measured or neural material as a list, for implementations on other devices. A network in it is its number of layers, the slope
/// of the leaky ReLU before the last one, and for each layer its inputs, its outputs, the weights `[blocks, inputs, 4]` of four
/// outputs each, and the biases `[blocks, 4]`; missing outputs of the last block are 0.
#[derive(Clone, Debug)]
pub enum FlatBrdf {
    /// Three widths of lobes; for each of 16 nodes along the square root of the cosine of `wo` the weights of the cosine lobe and of
    /// these three, and weight and width of the closest single lobe; the six [latents](Brdf::latent); the network.
    Measured(Vec<f32>),
    /// The side of the finest texture; the places of the networks of mixture and reflectance and of the texels; the networks of
    /// shift, mixture and reflectance; the texels of all levels, the finest first, of eight features each.
    Neural(Vec<f32>),
}

/// A [`Kernel`] as a [`Brdf`] over columns.
#[derive(Debug)]
pub struct OfKernel<K>(PhantomData<K>);

impl<K> OfKernel<K> {
    /// The only value.
    pub const NEW: Self = Self(PhantomData);
}

impl<K: Kernel> Brdf for OfKernel<K> {
    fn parameters(&self) -> usize {
        K::PARAMETERS
    }

    fn evaluate_cosine(&self, at: &Surfaces<'_>, wi: [&[Lanes]; 3], out: [&mut [Lanes]; 3]) {
        evaluate_cosine::<K>(at, wi, out);
    }

    fn sample(&self, at: &Surfaces<'_>, u: [&[Lanes]; 2], wi: [&mut [Lanes]; 3], pdf: &mut [Lanes]) {
        sample::<K>(at, u, wi, pdf);
    }

    fn pdf(&self, at: &Surfaces<'_>, wi: [&[Lanes]; 3], out: &mut [Lanes]) {
        pdf::<K>(at, wi, out);
    }

    fn alpha(&self, at: &Surfaces<'_>, out: &mut [Lanes]) {
        for (strip, out) in out.iter_mut().enumerate() {
            let parameters = Strip::<K>::parameters(at, strip);
            for (lane, out) in out.iter_mut().enumerate() {
                *out = K::of_parameters(&parameters.map(|column| column[lane])).alpha();
            }
        }
    }

    fn lobes(&self, at: &Surfaces<'_>, out: [&mut [Lanes]; 4]) {
        lobes::<K>(at, out);
    }
}

/// One loaded strip of surfaces.
struct Strip<K> {
    parameters: [Lanes; MAX_PARAMETERS],
    n: [Lanes; 3],
    wo: [Lanes; 3],
    kind: PhantomData<K>,
}

impl<K: Kernel> Strip<K> {
    #[inline(always)]
    fn parameters(at: &Surfaces<'_>, strip: usize) -> [Lanes; MAX_PARAMETERS] {
        let mut parameters = [[0.0; LANES]; MAX_PARAMETERS];
        for k in 0..K::PARAMETERS {
            parameters[k] = at.parameters[k][strip];
        }
        parameters
    }

    #[inline(always)]
    fn load(at: &Surfaces<'_>, strip: usize) -> Self {
        let [n, wo] = [at.n, at.wo].map(|column| [column[0][strip], column[1][strip], column[2][strip]]);
        Self { parameters: Self::parameters(at, strip), n, wo, kind: PhantomData }
    }

    #[inline(always)]
    fn kernel(&self, lane: usize) -> K {
        let mut parameters = [0.0; MAX_PARAMETERS];
        for k in 0..K::PARAMETERS {
            parameters[k] = self.parameters[k][lane];
        }
        K::of_parameters(&parameters)
    }
}

#[inline(always)]
fn vector(columns: &[Lanes; 3], lane: usize) -> Vec3 {
    Vec3::new(columns[0][lane], columns[1][lane], columns[2][lane])
}

vectorized! {
    fn evaluate_cosine['a, K: Kernel](_simd, at: &'a Surfaces<'a>, wi: [&'a [Lanes]; 3], out: [&'a mut [Lanes]; 3]) {
        let [red, green, blue] = out;
        for strip in 0..red.len() {
            let surfaces = Strip::<K>::load(at, strip);
            let wi = [wi[0][strip], wi[1][strip], wi[2][strip]];
            let mut value = [[0.0; LANES]; 3];
            for lane in 0..LANES {
                let kernel = surfaces.kernel(lane);
                let f = kernel.evaluate_cosine(vector(&surfaces.n, lane), vector(&surfaces.wo, lane), vector(&wi, lane));
                (value[0][lane], value[1][lane], value[2][lane]) = (f.x, f.y, f.z);
            }
            (red[strip], green[strip], blue[strip]) = (value[0], value[1], value[2]);
        }
    }
}

vectorized! {
    fn sample['a, K: Kernel](
        _simd, at: &'a Surfaces<'a>, u: [&'a [Lanes]; 2], wi: [&'a mut [Lanes]; 3], pdf: &'a mut [Lanes],
    ) {
        let [x, y, z] = wi;
        for strip in 0..pdf.len() {
            let surfaces = Strip::<K>::load(at, strip);
            let u = [u[0][strip], u[1][strip]];
            let (mut drawn, mut pdfs) = ([[0.0; LANES]; 3], [0.0; LANES]);
            for lane in 0..LANES {
                let kernel = surfaces.kernel(lane);
                let (n, wo) = (vector(&surfaces.n, lane), vector(&surfaces.wo, lane));
                let (w, density) = kernel.sample(n, wo, Vec2::new(u[0][lane], u[1][lane]));
                (drawn[0][lane], drawn[1][lane], drawn[2][lane]) = (w.x, w.y, w.z);
                pdfs[lane] = density;
            }
            (x[strip], y[strip], z[strip]) = (drawn[0], drawn[1], drawn[2]);
            pdf[strip] = pdfs;
        }
    }
}

vectorized! {
    fn pdf['a, K: Kernel](_simd, at: &'a Surfaces<'a>, wi: [&'a [Lanes]; 3], out: &'a mut [Lanes]) {
        for strip in 0..out.len() {
            let surfaces = Strip::<K>::load(at, strip);
            let wi = [wi[0][strip], wi[1][strip], wi[2][strip]];
            let mut pdfs = [0.0; LANES];
            for lane in 0..LANES {
                let kernel = surfaces.kernel(lane);
                pdfs[lane] = kernel.pdf(vector(&surfaces.n, lane), vector(&surfaces.wo, lane), vector(&wi, lane));
            }
            out[strip] = pdfs;
        }
    }
}

vectorized! {
    fn lobes['a, K: Kernel](_simd, at: &'a Surfaces<'a>, out: [&'a mut [Lanes]; 4]) {
        let [diffuse, specular, f0, alpha] = out;
        for strip in 0..alpha.len() {
            let surfaces = Strip::<K>::load(at, strip);
            for lane in 0..LANES {
                let cos_o = vector(&surfaces.n, lane).dot(vector(&surfaces.wo, lane));
                let lobes = surfaces.kernel(lane).lobes(cos_o);
                diffuse[strip][lane] = lobes.diffuse;
                specular[strip][lane] = lobes.specular;
                f0[strip][lane] = lobes.f0;
                alpha[strip][lane] = lobes.alpha;
            }
        }
    }
}

/// Sine of the angle to the normal below which a view has no direction along the surface.
const LEAST_SINE: f32 = 1e-4;

vectorized! {
    /// The default of [`Brdf::frames`].
    fn frames_of_views['a](_simd, at: &'a Surfaces<'a>, s: [&'a mut [Lanes]; 3], t: [&'a mut [Lanes]; 3]) {
        for strip in 0..s[0].len() {
            let [n, wo] = [at.n, at.wo].map(|column| [column[0][strip], column[1][strip], column[2][strip]]);
            let (mut first, mut second) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
            for lane in 0..LANES {
                let (n, wo) = (vector(&n, lane), vector(&wo, lane));
                let along = wo - n * n.dot(wo);
                let length = along.dot(along).sqrt();
                let any = Frame::from_normal(n).s;
                let has_one = length > LEAST_SINE;
                let scale = 1.0 / if has_one { length } else { 1.0 };
                let pick = |a: f32, b: f32| if has_one { a * scale } else { b };
                let s = Vec3::new(pick(along.x, any.x), pick(along.y, any.y), pick(along.z, any.z));
                let t = n.cross(s);
                (first[0][lane], first[1][lane], first[2][lane]) = (s.x, s.y, s.z);
                (second[0][lane], second[1][lane], second[2][lane]) = (t.x, t.y, t.z);
            }
            (s[0][strip], s[1][strip], s[2][strip]) = (first[0], first[1], first[2]);
            (t[0][strip], t[1][strip], t[2][strip]) = (second[0], second[1], second[2]);
        }
    }
}
