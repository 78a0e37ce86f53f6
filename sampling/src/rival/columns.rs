//! Rivals over columns of shading points.

use super::encoding::Seen;
use crate::{
    brdf::{Brdf, Surfaces, neural_texture::FEATURES},
    columns::{Arena, vectorized},
    simd::{self, LANES, Lanes, Simd},
};

/// A sampler of directions in the tangent frame, for a strip of points.
pub(super) trait Local {
    /// Maps uniform numbers to directions with their solid-angle pdfs. Directions without a positive z are
    /// rejected.
    fn sample<S: Simd>(&self, simd: S, seen: &Seen, u: [Lanes; 2]) -> ([Lanes; 3], Lanes);

    /// Computes the solid-angle pdfs of [`Self::sample`] for directions above the surface.
    fn pdf<S: Simd>(&self, simd: S, seen: &Seen, wi: [Lanes; 3]) -> Lanes;
}

/// Returns two independent normal deviates, from a uniform number and the cosine and sine of a uniform angle
/// (Box and Muller 1958).
#[inline(always)]
pub(super) fn normal_pair(u: f32, cos: f32, sin: f32) -> (f32, f32) {
    let radius = (-2.0 * simd::ln(1.0 - u)).sqrt();
    (radius * cos, radius * sin)
}

/// Number of columns of tangents and features.
const COLUMNS: usize = 6 + FEATURES;

fn load(brdf: &dyn Brdf, at: &Surfaces<'_>, columns: [&mut [Lanes]; COLUMNS]) {
    let [sx, sy, sz, tx, ty, tz, features @ ..] = columns;
    brdf.frames(at, [sx, sy, sz, tx, ty, tz]);
    brdf.features(at, features);
}

pub(super) fn sample_columns<L: Local>(
    local: &L,
    brdf: &dyn Brdf,
    at: &Surfaces<'_>,
    u: [&[Lanes]; 2],
    wi: [&mut [Lanes]; 3],
    pdf: &mut [Lanes],
    arena: &Arena,
) {
    let mut columns = arena.columns::<COLUMNS>(pdf.len());
    load(brdf, at, columns.get_mut());
    sample(local, at, columns.get(), u, wi, pdf);
}

pub(super) fn density_columns<L: Local>(
    local: &L,
    brdf: &dyn Brdf,
    at: &Surfaces<'_>,
    wi: [&[Lanes]; 3],
    out: &mut [Lanes],
    arena: &Arena,
) {
    let mut columns = arena.columns::<COLUMNS>(out.len());
    load(brdf, at, columns.get_mut());
    density(local, at, columns.get(), wi, out);
}

/// The axes of a strip of tangent frames.
type Axes = [[Lanes; 3]; 3];

#[inline(always)]
fn axes(at: &Surfaces<'_>, columns: &[&[Lanes]; COLUMNS], strip: usize) -> Axes {
    let s = [columns[0][strip], columns[1][strip], columns[2][strip]];
    let t = [columns[3][strip], columns[4][strip], columns[5][strip]];
    [s, t, [at.n[0][strip], at.n[1][strip], at.n[2][strip]]]
}

#[inline(always)]
fn to_local(axes: &Axes, world: &[Lanes; 3]) -> [Lanes; 3] {
    let mut local = [[0.0; LANES]; 3];
    for k in 0..3 {
        for lane in 0..LANES {
            local[k][lane] = axes[k][0][lane] * world[0][lane]
                + axes[k][1][lane] * world[1][lane]
                + axes[k][2][lane] * world[2][lane];
        }
    }
    local
}

#[inline(always)]
fn to_world(axes: &Axes, local: &[Lanes; 3]) -> [Lanes; 3] {
    let mut world = [[0.0; LANES]; 3];
    for k in 0..3 {
        for lane in 0..LANES {
            world[k][lane] = axes[0][k][lane] * local[0][lane]
                + axes[1][k][lane] * local[1][lane]
                + axes[2][k][lane] * local[2][lane];
        }
    }
    world
}

#[inline(always)]
fn seen(at: &Surfaces<'_>, axes: &Axes, columns: &[&[Lanes]; COLUMNS], strip: usize) -> Seen {
    let mut features = [[0.0; LANES]; FEATURES];
    for k in 0..FEATURES {
        features[k] = columns[6 + k][strip];
    }
    Seen { features, wo: to_local(axes, &[at.wo[0][strip], at.wo[1][strip], at.wo[2][strip]]) }
}

/// Sets the pdfs of rejected samples to 0: directions or views below the surface, and pdfs that are not
/// positive or reach 1e30.
#[inline(always)]
fn masked(pdf: &Lanes, wi: &Lanes, wo: &Lanes) -> Lanes {
    let mut out = [0.0; LANES];
    for lane in 0..LANES {
        let is_one = (wi[lane] > 0.0) & (wo[lane] > 0.0) & (pdf[lane] > 0.0) & (pdf[lane] < 1e30);
        out[lane] = if is_one { pdf[lane] } else { 0.0 };
    }
    out
}

vectorized! {
    fn sample['a, L: Local](
        simd, local: &'a L, at: &'a Surfaces<'a>, columns: [&'a [Lanes]; COLUMNS], u: [&'a [Lanes]; 2],
        wi: [&'a mut [Lanes]; 3], pdf: &'a mut [Lanes],
    ) {
        let [x, y, z] = wi;
        for strip in 0..pdf.len() {
            let axes = axes(at, &columns, strip);
            let seen = seen(at, &axes, &columns, strip);
            let (own, density) = local.sample(simd, &seen, [u[0][strip], u[1][strip]]);
            pdf[strip] = masked(&density, &own[2], &seen.wo[2]);
            let world = to_world(&axes, &own);
            (x[strip], y[strip], z[strip]) = (world[0], world[1], world[2]);
        }
    }
}

vectorized! {
    fn density['a, L: Local](
        simd, local: &'a L, at: &'a Surfaces<'a>, columns: [&'a [Lanes]; COLUMNS], wi: [&'a [Lanes]; 3], out: &'a mut [Lanes],
    ) {
        for strip in 0..out.len() {
            let axes = axes(at, &columns, strip);
            let seen = seen(at, &axes, &columns, strip);
            let own = to_local(&axes, &[wi[0][strip], wi[1][strip], wi[2][strip]]);
            out[strip] = masked(&local.pdf(simd, &seen, own), &own[2], &seen.wo[2]);
        }
    }
}
