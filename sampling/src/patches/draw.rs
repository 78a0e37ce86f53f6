//! Sampling from patches, and its density: kernels over columns.

use glam::{Vec2, Vec3};

use super::{
    hierarchy::{Level, PARTS, Patches},
    mass::{Block, LEAST_COS_O, Patch, Reflection, highest, masses},
    small_lights,
    tree::{Aim, Cuts, Places, Points},
};
use crate::{
    columns::vectorized,
    environment::BilinearDensity,
    simd::{self, LANES, Lanes, Simd},
    tile::Rows,
    visibility::{CLUSTERS, Weighting},
};

/// Largest and smallest mixture weight of BRDF sampling for a lobe, by its width alone.
const MOST_BRDF: f32 = 0.9;
const LEAST_BRDF: f32 = 0.03;
/// Log odds of BRDF sampling under a uniform sky for a lobe of width 1, and the exponents with which the odds
/// fall with the lobe's width and with the unevenness of the light.
const ODDS_AT_ONE: f32 = -4.35;
const ODDS_BY_WIDTH: f32 = 2.14;
const ODDS_BY_LIGHT: f32 = 1.92;
/// Smallest mixture weight of BRDF sampling for lobes of width 0.1 and above, and the exponent with which it
/// rises for narrower ones: their masses are less accurate, and ignore the remaining light where a lamp is in
/// shadow.
const LEAST_BRDF_SEEN: f32 = 0.02;
const LEAST_BY_WIDTH: f32 = 3.0;
const MOST_LEAST: f32 = 0.5;
/// Range to which unevenness is clamped, as masses are not exact integrals.
const LEAST_UNEVENNESS: f32 = 0.1;
const MOST_UNEVENNESS: f32 = 1e6;
/// The logarithm of 0.1.
const LN_TENTH: f32 = -std::f32::consts::LN_10;
/// Smallest reflectance assumed for the mixture weight.
const LEAST_REFLECTED: f32 = 0.3;

/// State of a shading point: its [`Reflection`]'s lobes, the index of its weights, its mixture weight beside
/// BRDF sampling, then the running sums of the masses of the clusters.
pub(super) const COLUMNS: usize = SUMS + CLUSTERS;
pub(super) const LOBES: usize = 4;
/// The column of the indices of weights.
pub(super) const WEIGHTS: usize = LOBES;
/// The column of the mixture weights beside BRDF sampling.
pub(super) const MIXTURE_WEIGHT: usize = WEIGHTS + 1;
/// The first column of running sums.
pub(super) const SUMS: usize = MIXTURE_WEIGHT + 1;

/// Reflections of the shading points of a strip.
pub(super) struct Reflections<'a> {
    n: [Lanes; 3],
    wo: [Lanes; 3],
    cos_o: Lanes,
    lobes: &'a [Lanes],
}

impl<'a> Reflections<'a> {
    #[inline(always)]
    pub fn new(at: &Rows<'_>, strip: usize, lobes: &'a [Lanes]) -> Self {
        let (n, wo, mut cos_o) = (at.normals(strip), at.views(strip), [0.0; LANES]);
        for k in 0..LANES {
            let cos = n[0][k] * wo[0][k] + (n[1][k] * wo[1][k] + n[2][k] * wo[2][k]);
            cos_o[k] = if cos > LEAST_COS_O { cos } else { LEAST_COS_O };
        }
        Self { n, wo, cos_o, lobes }
    }

    #[inline(always)]
    fn normal(&self, lane: usize) -> Vec3 {
        Vec3::new(self.n[0][lane], self.n[1][lane], self.n[2][lane])
    }

    #[inline(always)]
    pub fn lane(&self, lane: usize) -> Reflection {
        Reflection {
            n: self.normal(lane),
            wo: Vec3::new(self.wo[0][lane], self.wo[1][lane], self.wo[2][lane]),
            cos_o: self.cos_o[lane],
            diffuse: self.lobes[0][lane],
            specular: self.lobes[1][lane],
            f0: self.lobes[2][lane],
            alpha: self.lobes[3][lane],
        }
    }
}

vectorized! {
    /// Computes the running sums of the clusters' masses and the mixture weights beside BRDF sampling, from
    /// the lobes in `state`.
    pub(super) fn prepare['a, W: Weighting](simd, patches: &'a Patches, weighting: &'a W, at: &'a Rows<'a>, state: &'a mut [Lanes]) {
        for (strip, state) in state.chunks_exact_mut(COLUMNS).enumerate() {
            let (lobes, sums) = state.split_at_mut(SUMS);
            let mut weights = [[1.0; LANES]; CLUSTERS];
            weighting.of_clusters(&lobes[WEIGHTS], &mut weights);
            let points = Reflections::new(at, strip, lobes);
            let [is_diffuse, is_glossy] = [0, 1].map(|lobe| highest(&lobes[lobe]) > 0.0);
            let (mut sum, mut squared) = ([0.0; LANES], [0.0; LANES]);
            for (((patch, brightness), number), out) in patches.clusters.iter().zip(&patches.brightness).zip(&patches.numbers).zip(&mut *sums) {
                let weights = &weights[*number];
                if is_glossy {
                    let masses = if is_diffuse {
                        masses::<_, false, true>(simd, |_| *patch, |k| points.lane(k))
                    } else {
                        masses::<_, false, false>(simd, |_| *patch, |k| points.lane(k))
                    };
                    for k in 0..LANES {
                        let mass = weights[k] * masses[k];
                        sum[k] += mass;
                        squared[k] += mass * brightness;
                    }
                } else {
                    for k in 0..LANES {
                        sum[k] += weights[k] * patch.diffuse_mass::<_, false>(simd, points.normal(k));
                    }
                }
                *out = sum;
            }
            let mut mixture_weights = [1.0; LANES];
            if is_glossy {
                for k in 0..LANES {
                    let (sum, squared) = (sum[k] / W::UNIT, squared[k] / W::UNIT);
                    mixture_weights[k] = mixture_weight_beside_brdf(&points.lane(k), sum, squared);
                }
            }
            lobes[MIXTURE_WEIGHT] = mixture_weights;
            if patches.small > 0 {
                let mut at_leaves = [false; LANES];
                for k in 0..LANES {
                    at_leaves[k] = !goes_on(patches, lobes, k);
                }
                let [factor, added] = small_lights::scales(&sums[patches.small - 1], &sum, &mixture_weights, at_leaves);
                for (cluster, out) in sums[..patches.clusters.len()].iter_mut().enumerate() {
                    for k in 0..LANES {
                        out[k] = if cluster < patches.small { out[k] * factor[k] } else { out[k] + added[k] };
                    }
                }
                for k in 0..LANES {
                    sum[k] += added[k];
                }
            }
            for out in &mut sums[patches.clusters.len()..] {
                *out = sum;
            }
        }
    }
}

/// Returns the running sums of the weighted masses of the parts of a patch for one shading point.
#[inline(always)]
pub(super) fn part_sums<S: Simd>(simd: S, block: &Block, at: &Reflection, weights: &Lanes) -> Lanes {
    let mut masses = if at.specular > 0.0 && at.diffuse > 0.0 {
        masses::<_, true, true>(simd, |k| Patch::load(block, k), |_| *at)
    } else if at.specular > 0.0 {
        masses::<_, true, false>(simd, |k| Patch::load(block, k), |_| *at)
    } else {
        let mut masses = [0.0; LANES];
        for k in 0..LANES {
            masses[k] = Patch::load(block, k).diffuse_mass::<_, true>(simd, at.n);
        }
        masses
    };
    let mut sum = 0.0;
    for k in 0..LANES {
        sum += weights[k] * masses[k];
        masses[k] = sum;
    }
    masses
}

/// Positions of lanes in the descent.
struct Path {
    /// The number of the patch in its level.
    number: [u32; LANES],
    probability: Lanes,
    cuts: Cuts,
}

/// Whether a lane descends to twigs.
#[inline(always)]
fn goes_on(patches: &Patches, lobes: &[Lanes], lane: usize) -> bool {
    lobes[3][lane] < patches.narrow
}

/// Descends one level for the lanes that `goes_on` selects.
#[inline(always)]
fn step<S: Simd, A: Aim>(
    simd: S,
    (patches, level): (&Patches, &Level),
    goes_on: &[bool; LANES],
    at: &[Reflection; LANES],
    weights: impl Fn(usize, usize) -> Lanes,
    aim: &A,
    path: &mut Path,
) {
    let (mut sums, mut totals, mut roots) = ([[0.0; PARTS]; LANES], [1.0; LANES], [patches.rest; LANES]);
    for k in 0..LANES {
        if goes_on[k] {
            let number = path.number[k] as usize;
            sums[k] = part_sums(simd, &level.blocks[number], &at[k], &weights(k, number));
            totals[k] = sums[k][PARTS - 1];
            roots[k] = level.roots[number];
        }
    }
    let (found, cuts) = patches.forest.descend::<1, PARTS>(&roots, aim, (sums.as_flattened(), totals), path.cuts);
    path.cuts = cuts;
    for k in 0..LANES {
        path.probability[k] *= fraction(found.mass[k], totals[k]);
        path.number[k] = if goes_on[k] { path.number[k] * PARTS as u32 + found.place[k] } else { path.number[k] };
    }
}

/// Returns the mixture weight of BRDF sampling for a lobe by its width alone.
///
/// Fitted to the least relative variance over maps and views: 0.5 at alpha = 0.05, 0.2 at 0.1, 0.09 at 0.2 and 0.04 at 0.4.
#[inline(always)]
fn by_width(alpha: f32) -> f32 {
    let of_lobe = 0.5 * simd::exp(1.25 * simd::ln(0.05 / alpha));
    let of_lobe = if of_lobe < MOST_BRDF { of_lobe } else { MOST_BRDF };
    if of_lobe > LEAST_BRDF { of_lobe } else { LEAST_BRDF }
}

/// Returns the mixture weight of patches beside BRDF sampling: 1 for diffuse surfaces, otherwise larger for
/// lobes that are wider relative to the patches and for more uneven light.
///
/// `sum` is the reflected light, `squared` the same weighted by the density of the light. BRDF sampling draws
/// in proportion to the reflection of a white sky, so their ratio is 1 plus the relative variance of its
/// weights. The odds are fitted to the least variance of the mixture over maps and views, both relative to
/// each view and absolute: absolute variance is what images are judged by, and views that see a lamp dominate
/// it.
#[inline(always)]
fn mixture_weight_beside_brdf(at: &Reflection, sum: f32, squared: f32) -> f32 {
    let grazing = 1.0 - at.cos_o;
    let fourth = (grazing * grazing) * (grazing * grazing);
    let albedo = at.diffuse + at.specular * (at.f0 + (1.0 - at.f0) * (fourth * grazing));
    let sum = if sum > f32::MIN_POSITIVE { sum } else { f32::MIN_POSITIVE };
    let unevenness = (albedo / sum) * (squared / sum);
    let unevenness = if unevenness > LEAST_UNEVENNESS { unevenness } else { LEAST_UNEVENNESS };
    let unevenness = if unevenness < MOST_UNEVENNESS { unevenness } else { MOST_UNEVENNESS };
    let width = simd::ln(at.alpha);
    let odds = simd::exp(ODDS_AT_ONE - ODDS_BY_WIDTH * width - ODDS_BY_LIGHT * simd::ln(unevenness));
    let narrower = LN_TENTH - width;
    let narrower = if narrower > 0.0 { narrower } else { 0.0 };
    let least = LEAST_BRDF_SEEN * simd::exp(LEAST_BY_WIDTH * narrower);
    let least = if least < MOST_LEAST { least } else { MOST_LEAST };
    let of_lobe = odds / (1.0 + odds);
    // Under a broad sky BRDF sampling alone would have the lowest variance with independent points, but with
    // Sobol points a mixture has the lowest error.
    let by_width = by_width(at.alpha);
    let of_lobe = if of_lobe < by_width { of_lobe } else { by_width };
    let of_lobe = if of_lobe > least { of_lobe } else { least };
    mixture_weight_beside_lobe(of_lobe, at.diffuse, at.specular, at.f0)
}

/// Returns the mixture weight beside BRDF sampling of a surface, from that of BRDF sampling for its glossy
/// lobe alone.
#[inline(always)]
fn mixture_weight_beside_lobe(of_lobe: f32, diffuse: f32, specular: f32, f0: f32) -> f32 {
    // A diffuse lobe needs no BRDF sampling; a dielectric reflects about 30 % at grazing angles.
    let reflected = specular * if f0 > LEAST_REFLECTED { f0 } else { LEAST_REFLECTED };
    let mixture_weight = 1.0 - of_lobe * reflected / (reflected + diffuse);
    if specular > 0.0 { mixture_weight } else { 1.0 }
}

vectorized! {
    /// Computes the mixture weights beside BRDF sampling that heads start from, by the width of lobes alone.
    pub(super) fn mixture_weights_by_width['a](_simd, lobes: [&'a [Lanes]; LOBES], out: &'a mut [Lanes]) {
        for strip in 0..out.len() {
            let [diffuse, specular, f0, alpha] = [lobes[0][strip], lobes[1][strip], lobes[2][strip], lobes[3][strip]];
            let mut mixture_weights = [0.0; LANES];
            for k in 0..LANES {
                mixture_weights[k] = mixture_weight_beside_lobe(by_width(alpha[k]), diffuse[k], specular[k], f0[k]);
            }
            out[strip] = mixture_weights;
        }
    }
}

/// Returns a mass as a fraction of the total; 0 where there is nothing to draw.
#[inline(always)]
fn fraction(mass: f32, all: f32) -> f32 {
    let fraction = mass / all;
    if (mass > 0.0) & (all > 0.0) { fraction } else { 0.0 }
}

/// Descends the levels to the patches that `aims` select, with the state of one strip.
#[inline(always)]
fn walk<S: Simd, A: Aim, W: Weighting>(
    simd: S,
    patches: &Patches,
    weighting: &W,
    (at, strip): (&Rows<'_>, usize),
    state: &[Lanes],
    aims: [&A; 3],
) -> (Path, [bool; LANES]) {
    let (lobes, sums) = state[strip * COLUMNS..][..COLUMNS].split_at(SUMS);
    let reflections = Reflections::new(at, strip, lobes);
    let total = sums[CLUSTERS - 1];
    let root = [patches.root; LANES];
    let sums = (sums.as_flattened(), total);
    let (found, cuts) = patches.forest.descend::<LANES, 1>(&root, aims[0], sums, Cuts::SQUARE);
    let mut path = Path { number: found.place, probability: [0.0; LANES], cuts };
    let mut points = [reflections.lane(0); LANES];
    let (mut narrow, mut any) = ([false; LANES], false);
    for k in 0..LANES {
        path.probability[k] = fraction(found.mass[k], total[k]);
        points[k] = reflections.lane(k);
        narrow[k] = goes_on(patches, lobes, k);
        any |= narrow[k];
    }
    let weights = |lane: usize, cluster: usize| weighting.of_parts(lobes[WEIGHTS][lane], patches.numbers[cluster]);
    step(simd, (patches, &patches.leaves), &[true; LANES], &points, weights, aims[1], &mut path);
    if any {
        step(simd, (patches, &patches.twigs), &narrow, &points, |_, _| [1.0; LANES], aims[2], &mut path);
    }
    (path, narrow)
}

/// Returns the rectangles in Y that lanes have reached: left, right, top, bottom, and the reciprocal of their
/// energy.
#[inline(always)]
fn rectangles(patches: &Patches, path: &Path, narrow: &[bool; LANES]) -> [Lanes; 5] {
    let mut rectangles = [[0.0; LANES]; 5];
    for k in 0..LANES {
        let level = if narrow[k] { &patches.twigs } else { &patches.leaves };
        let numbers = &level.rectangles[path.number[k] as usize];
        for (column, number) in rectangles.iter_mut().zip(numbers) {
            column[k] = *number;
        }
    }
    rectangles
}

vectorized! {
    /// Maps uniform points `z` to points of Y, with their densities over Y: 0 where there is nothing to draw.
    pub(super) fn sample['a, W: Weighting](
        simd, patches: &'a Patches, weighting: &'a W, at: &'a Rows<'a>, state: &'a [Lanes],
        z: [&'a [Lanes]; 2], y: [&'a mut [Lanes]; 2], q: &'a mut [Lanes],
    ) {
        let [y_u, y_v] = y;
        for strip in 0..q.len() {
            let aim = Points([z[0][strip], z[1][strip]]);
            let (path, narrow) = walk(simd, patches, weighting, (at, strip), state, [&aim; 3]);
            let inside = path.cuts.inside(&aim.0[0], &aim.0[1]);
            let [left, right, top, bottom, inverse_energy] = &rectangles(patches, &path, &narrow);
            for k in 0..LANES {
                y_u[strip][k] = within(left[k], right[k], inside[0][k]);
                y_v[strip][k] = within(top[k], bottom[k], inside[1][k]);
                q[strip][k] = path.probability[k] * inverse_energy[k];
            }
        }
    }
}

vectorized! {
    /// Inverts [`sample`]: maps points `y` of Y, with their images `x` in X by which patches are found, to
    /// the points `z` that map to them, with the densities over Y. Where the density is 0, no point maps to
    /// `y`.
    pub(super) fn invert['a, W: Weighting](
        simd, patches: &'a Patches, weighting: &'a W, grid: &'a BilinearDensity, at: &'a Rows<'a>, state: &'a [Lanes],
        x: [&'a [Lanes]; 2], y: [&'a [Lanes]; 2], z: [&'a mut [Lanes]; 2], q: &'a mut [Lanes],
    ) {
        let [z_u, z_v] = z;
        for strip in 0..q.len() {
            let (mut clusters, mut leaves, mut twigs) = ([0; LANES], [0; LANES], [0; LANES]);
            for k in 0..LANES {
                let (column, row, _) = grid.cell(Vec2::new(x[0][strip][k], x[1][strip][k]));
                let twig = patches.lookup.patch(column as u32, row as u32);
                let parts = PARTS as u32;
                (clusters[k], leaves[k], twigs[k]) = (twig / parts / parts, twig / parts % parts, twig % parts);
            }
            let aims = [&Places(clusters), &Places(leaves), &Places(twigs)];
            let (path, narrow) = walk(simd, patches, weighting, (at, strip), state, aims);
            let [left, right, top, bottom, inverse_energy] = rectangles(patches, &path, &narrow);
            let rectangle = Cuts { left, right, top, bottom };
            let inside = rectangle.inside(&y[0][strip], &y[1][strip]);
            [z_u[strip], z_v[strip]] = path.cuts.outside(&inside);
            for k in 0..LANES {
                q[strip][k] = path.probability[k] * inverse_energy[k];
            }
        }
    }
}

/// Interpolates from `from` to `to`, excluding `to` itself, which belongs to the next patch.
#[inline(always)]
pub(super) fn within(from: f32, to: f32, inside: f32) -> f32 {
    let place = from + (to - from) * inside;
    if place < to { place } else { f32::from_bits(to.to_bits().wrapping_sub(1)) }
}

vectorized! {
    /// Computes the density over Y at the points of Y that map to points `x` of X.
    pub(super) fn density['a, W: Weighting](
        simd, patches: &'a Patches, weighting: &'a W, grid: &'a BilinearDensity, at: &'a Rows<'a>, state: &'a [Lanes],
        x: [&'a [Lanes]; 2], q: &'a mut [Lanes],
    ) {
        for strip in 0..q.len() {
            let (lobes, sums) = state[strip * COLUMNS..][..COLUMNS].split_at(SUMS);
            let points = Reflections::new(at, strip, lobes);
            let (mut columns, mut rows) = ([0; LANES], [0; LANES]);
            for k in 0..LANES {
                let (column, row, _) = grid.cell(Vec2::new(x[0][strip][k], x[1][strip][k]));
                (columns[k], rows[k]) = (column as u32, row as u32);
            }
            for k in 0..LANES {
                let point = points.lane(k);
                let twig = patches.lookup.patch(columns[k], rows[k]) as usize;
                let (leaf, cluster) = (twig / PARTS, twig / (PARTS * PARTS));
                let own = sums[cluster][k] - if cluster == 0 { 0.0 } else { sums[cluster - 1][k] };
                let mut probability = fraction(own, sums[CLUSTERS - 1][k]);
                let weights = weighting.of_parts(lobes[WEIGHTS][k], patches.numbers[cluster]);
                probability *= fraction_of(&part_sums(simd, &patches.leaves.blocks[cluster], &point, &weights), leaf % PARTS);
                let mut inverse_energy = patches.leaves.rectangles[leaf][4];
                if goes_on(patches, lobes, k) {
                    probability *= fraction_of(&part_sums(simd, &patches.twigs.blocks[leaf], &point, &[1.0; LANES]), twig % PARTS);
                    inverse_energy = patches.twigs.rectangles[twig][4];
                }
                q[strip][k] = probability * inverse_energy;
            }
        }
    }
}

/// Returns a part's fraction of the total, from running sums.
#[inline(always)]
fn fraction_of(sums: &Lanes, place: usize) -> f32 {
    fraction(sums[place] - if place == 0 { 0.0 } else { sums[place - 1] }, sums[PARTS - 1])
}
