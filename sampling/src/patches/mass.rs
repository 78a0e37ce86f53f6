//! The mass of a patch for a shading point: its light times the reflected fraction of it, in closed form from
//! the patch's moments.

use std::f32::consts::FRAC_1_PI;

use glam::{DMat3, Vec3};

use super::moments::MomentMap;
use crate::{
    simd::{LANES, Lanes, Simd, fused},
    tail::Node,
};

/// The quantities from which the mass of a patch is computed.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    /// Fraction of the map's light.
    energy: f32,
    /// The mean direction, of length below 1.
    centroid: Vec3,
    /// Three times the covariance of directions: xx, yy, zz; then twice xy, xz, yz.
    squares: Vec3,
    mixed: Vec3,
    /// The largest distance of a direction from the centroid.
    reach: f32,
    /// The same in the metric of the spread, and the addition for the size of a cell.
    mahalanobis: f32,
    cell: f32,
    /// The variance of directions, along all axes.
    variance: f32,
}

/// Patches as a structure of arrays, energies first.
pub type Block = [Lanes; 14];

/// Reflection of a shading point in closed form: a diffuse lobe and a Trowbridge-Reitz lobe.
#[derive(Clone, Copy, Debug)]
pub struct Reflection {
    /// Shading normal.
    pub n: Vec3,
    /// Direction to the viewer.
    pub wo: Vec3,
    /// The cosine between the two, at least [`LEAST_COS_O`].
    pub cos_o: f32,
    /// Luminance of the diffuse reflectance.
    pub diffuse: f32,
    /// Weight of the Trowbridge-Reitz lobe.
    pub specular: f32,
    /// Luminance of its reflectance at normal incidence.
    pub f0: f32,
    /// Its width.
    pub alpha: f32,
}

/// Lower bound of the cosine to the viewer.
pub const LEAST_COS_O: f32 = 1e-4;
/// Smallest clamped cosine of a leaf as a fraction of its upper bound; bounds sample weights.
const LEAF_FLOOR: f32 = 0.15;
/// The same for a cluster.
const CLUSTER_FLOOR: f32 = 0.045;
/// Smallest fraction of a patch that counts as above the horizon for a glossy lobe.
const LEAST_VISIBLE: f32 = 0.02;
/// Smallest upper end of the interval of cosines, as a fraction of their upper bound.
const LEAST_TOP: f32 = 0.2;
/// Added to three times the variance: the f32 rounding error of a difference of squares.
const LEAST_VARIANCE: f32 = 3e-7;
/// Bound on half of the diagonal between points of the map, in steps.
const HALF_DIAGONAL: f64 = 0.8;

impl Patch {
    /// The patch of a node that holds light.
    pub fn new(map: &MomentMap<'_>, node: Node) -> Self {
        let moments = map.moments(node);
        let (s, covariance) = (moments.centroid(), moments.covariance());
        let cell = HALF_DIAGONAL * map.step();
        // A cosine that is uniform on an interval of half width a has a variance of a^2 / 3.
        let spread = 3.0 * covariance;
        let regular = spread + DMat3::from_diagonal(glam::DVec3::splat(f64::from(LEAST_VARIANCE)));
        let inverse = regular.inverse();
        let [reach, mahalanobis] = map.farthest(node, s, inverse);
        let reach = reach.sqrt();
        let diagonal = glam::DVec3::new(spread.col(0)[0], spread.col(1)[1], spread.col(2)[2]);
        Self {
            energy: moments.energy as f32,
            centroid: s.as_vec3(),
            squares: diagonal.as_vec3(),
            mixed: 2.0 * Vec3::new(spread.col(0)[1] as f32, spread.col(0)[2] as f32, spread.col(1)[2] as f32),
            reach: (reach + cell) as f32,
            // Exceeds the f32 rounding of its factor.
            mahalanobis: 1.001 * mahalanobis.max(0.0).sqrt() as f32,
            cell: cell as f32,
            variance: moments.variance() as f32,
        }
    }

    /// Stores the patch in a lane of a block.
    pub fn store(&self, block: &mut Block, lane: usize) {
        let vectors = [self.centroid, self.squares, self.mixed].into_iter().flat_map(|vector| vector.to_array());
        let rest = [self.reach, self.mahalanobis, self.cell, self.variance];
        for (column, number) in block.iter_mut().zip([self.energy].into_iter().chain(vectors).chain(rest)) {
            column[lane] = number;
        }
    }

    /// Loads the patch in a lane of a block.
    #[inline(always)]
    pub fn load(block: &Block, lane: usize) -> Self {
        Self {
            energy: block[0][lane],
            centroid: Vec3::new(block[1][lane], block[2][lane], block[3][lane]),
            squares: Vec3::new(block[4][lane], block[5][lane], block[6][lane]),
            mixed: Vec3::new(block[7][lane], block[8][lane], block[9][lane]),
            reach: block[10][lane],
            mahalanobis: block[11][lane],
            cell: block[12][lane],
            variance: block[13][lane],
        }
    }

    /// Returns three times the variance of `t . w` over the patch.
    #[inline(always)]
    fn spread<S: Simd>(&self, simd: S, t: Vec3) -> f32 {
        // Each component times its row of the upper triangle of the symmetric matrix.
        let first = fused(simd, t.y, self.mixed.x, fused(simd, t.z, self.mixed.y, t.x * self.squares.x));
        let second = fused(simd, t.z, self.mixed.z, t.y * self.squares.y);
        let third = t.z * self.squares.z;
        larger(fused(simd, t.x, first, fused(simd, t.y, second, t.z * third)), 0.0)
    }

    /// Returns the interval of cosines over the patch, as if they were uniform on it.
    #[inline(always)]
    pub fn cosines<S: Simd>(&self, simd: S, n: Vec3) -> Cosines {
        let mean = dot(simd, n, self.centroid);
        let half_width = (self.spread(simd, n) + LEAST_VARIANCE).sqrt();
        // By the Cauchy-Schwarz inequality, no direction is farther along n.
        let reach = smaller(fused(simd, self.mahalanobis, half_width, self.cell), self.reach);
        Cosines { mean, half_width, bound: mean + reach }
    }

    /// Returns the mass for a diffuse surface.
    #[inline(always)]
    pub fn diffuse_mass<S: Simd, const LEAF: bool>(&self, simd: S, n: Vec3) -> f32 {
        self.energy * self.cosines(simd, n).clamped::<LEAF>()
    }

    /// Returns the middle of the part of the patch above the horizon.
    #[inline(always)]
    fn middle<S: Simd>(&self, simd: S, n: Vec3, cosines: &Cosines) -> Middle {
        let (visible, cos_i) = cosines.visible();
        let raised = cos_i - cosines.mean;
        let w = Vec3::new(
            fused(simd, n.x, raised, self.centroid.x),
            fused(simd, n.y, raised, self.centroid.y),
            fused(simd, n.z, raised, self.centroid.z),
        );
        let scale = 1.0 / larger(dot(simd, w, w), 1e-6).sqrt();
        Middle { w: w * scale, cos_i: smaller(larger(cos_i * scale, 1e-4), 1.0), visible }
    }

    /// Returns the half vectors between the viewer and the patch: their middle, and their spread added to a
    /// lobe's width.
    #[inline(always)]
    fn half_vectors<S: Simd>(&self, simd: S, at: &Reflection, middle: &Middle) -> HalfVectors {
        let Middle { w, cos_i, .. } = *middle;
        let cos_o = at.cos_o;
        let cos = smaller(dot(simd, at.wo, w), 1.0 - 1e-6);
        // The squared cosine of half of the angle between both directions; its reciprocal, and that of the
        // squared sine of the whole angle.
        let squared_half = larger(fused(simd, 0.5, cos, 0.5), 1e-3);
        let away = 1.0 - cos;
        let both = 1.0 / (squared_half * away);
        let (per_half, per_squared_sine) = (away * both, 0.5 * both);
        let squared_cos_h = smaller((cos_i + cos_o) * (cos_i + cos_o) * (0.25 * per_half), 1.0);
        // In the plane of incidence, half vectors spread half as much as directions; across it, more.
        let across = Vec3::new(
            fused(simd, at.wo.y, w.z, -(at.wo.z * w.y)),
            fused(simd, at.wo.z, w.x, -(at.wo.x * w.z)),
            fused(simd, at.wo.x, w.y, -(at.wo.y * w.x)),
        );
        let variance_across = self.spread(simd, across) * (1.0 / 3.0) * per_squared_sine;
        let variance_along = larger(self.variance - variance_across, 0.0);
        let own = at.alpha * at.alpha;
        let tilt_across = dot(simd, at.n, across);
        HalfVectors {
            squared_half,
            squared_cos_h,
            tilt_across: tilt_across * tilt_across * per_squared_sine,
            along: smaller(fused(simd, 0.5, variance_along, own), 1.0),
            over: smaller(fused(simd, 0.5 * variance_across, per_half, own), 1.0),
        }
    }
}

/// The part of a patch that is above the horizon.
#[derive(Clone, Copy)]
struct Middle {
    /// Direction to its middle.
    w: Vec3,
    /// Cosine between the direction and the normal.
    cos_i: f32,
    /// Its fraction of the patch.
    visible: f32,
}

impl Middle {
    #[inline(always)]
    fn of_lane(columns: &[Lanes; 5], k: usize) -> Self {
        let [x, y, z, cos_i, visible] = lane(columns, k);
        Self { w: Vec3::new(x, y, z), cos_i, visible }
    }
}

/// Half vectors between the viewer and a patch.
#[derive(Clone, Copy)]
struct HalfVectors {
    /// The squared cosine between the middle one and either direction.
    squared_half: f32,
    /// The squared cosine between the middle one and the normal.
    squared_cos_h: f32,
    /// The squared tilt of the middle one out of the plane of incidence.
    tilt_across: f32,
    /// The lobe's squared widths in that plane and across it, with the spread of half vectors.
    along: f32,
    over: f32,
}

/// Evaluates the Trowbridge-Reitz lobe times cosine in the middle of the part of a patch above the horizon,
/// widened by the spread of half vectors over the patch.
#[inline(always)]
fn lobe<S: Simd, const LEAF: bool>(simd: S, at: &Reflection, middle: &Middle, half: &HalfVectors) -> f32 {
    let (cos_i, cos_o) = (middle.cos_i, at.cos_o);
    let HalfVectors { squared_half, squared_cos_h, tilt_across, along, over } = *half;
    let tilt_along = larger(1.0 - squared_cos_h - tilt_across, 0.0);
    // D = 1 / (pi a b (cos^2 + x^2 / a^2 + y^2 / b^2)^2), with along = a^2 and over = b^2, over a common denominator.
    let product = along * over;
    let scaled = fused(simd, squared_cos_h, product, fused(simd, tilt_along, over, tilt_across * along));
    // Smith's shadowing in the root-free form of Hammon (2017): G2 / (4 n.wi n.wo) = 1 / (2 mix(2 n.wi n.wo,
    // n.wi + n.wo, alpha)).
    let (smooth, rough) = (2.0 * cos_i * cos_o, cos_i + cos_o);
    let shadowing = 2.0 * fused(simd, at.alpha, rough - smooth, smooth);
    // (1 - cos^2)^12 approximates (1 - cos)^5.
    let x = 1.0 - squared_half;
    let fourth = (x * x) * (x * x);
    let fresnel = fused(simd, 1.0 - at.f0, fourth * fourth * fourth, at.f0);
    let fraction = if LEAF { middle.visible.sqrt() } else { middle.visible };
    let lobe = FRAC_1_PI * product * product.sqrt() * cos_i / (scaled * scaled * shadowing);
    fraction * fresnel * lobe
}

/// Computes the masses of patches for shading points: one of either, or one per lane. For surfaces without a
/// glossy lobe, use [`Patch::diffuse_mass`]. For surfaces without diffuse reflection, `DIFFUSE` may be false,
/// with equal masses.
///
/// Four loops, because each step waits for the roots and divisions of the previous one: within a loop, the
/// processor overlaps the lanes. The loops are written out: a closure that the compiler does not inline loses the
/// instruction set of its caller.
#[inline(always)]
pub fn masses<S: Simd, const LEAF: bool, const DIFFUSE: bool>(
    simd: S,
    patch: impl Fn(usize) -> Patch,
    at: impl Fn(usize) -> Reflection,
) -> Lanes {
    let mut cosines = [[0.0; LANES]; 3];
    for k in 0..LANES {
        let Cosines { mean, half_width, bound } = patch(k).cosines(simd, at(k).n);
        set_lane(&mut cosines, k, [mean, half_width, bound]);
    }
    if highest(&cosines[2]) <= 0.0 {
        return [0.0; LANES];
    }
    let mut middles = [[0.0; LANES]; 5];
    for k in 0..LANES {
        let Middle { w, cos_i, visible } = patch(k).middle(simd, at(k).n, &Cosines::of_lane(&cosines, k));
        set_lane(&mut middles, k, [w.x, w.y, w.z, cos_i, visible]);
    }
    let mut halves = [[0.0; LANES]; 5];
    for k in 0..LANES {
        let half = patch(k).half_vectors(simd, &at(k), &Middle::of_lane(&middles, k));
        set_lane(&mut halves, k, [half.squared_half, half.squared_cos_h, half.tilt_across, half.along, half.over]);
    }
    let mut masses = [0.0; LANES];
    for k in 0..LANES {
        let (at, cosines, middle) = (at(k), Cosines::of_lane(&cosines, k), Middle::of_lane(&middles, k));
        let [squared_half, squared_cos_h, tilt_across, along, over] = lane(&halves, k);
        let half = HalfVectors { squared_half, squared_cos_h, tilt_across, along, over };
        let diffuse = if DIFFUSE { cosines.clamped::<LEAF>() } else { 0.0 };
        let glossy = lobe::<S, LEAF>(simd, &at, &middle, &half);
        let glossy = if cosines.bound > 0.0 { glossy } else { 0.0 };
        let both = fused(simd, at.specular, glossy, at.diffuse * FRAC_1_PI * diffuse);
        masses[k] = patch(k).energy * if at.specular > 0.0 { both } else { diffuse };
    }
    masses
}

/// Sets one lane of columns.
#[inline(always)]
fn set_lane<const N: usize>(columns: &mut [Lanes; N], lane: usize, numbers: [f32; N]) {
    for i in 0..N {
        columns[i][lane] = numbers[i];
    }
}

/// Returns one lane of columns.
#[inline(always)]
fn lane<const N: usize>(columns: &[Lanes; N], k: usize) -> [f32; N] {
    let mut numbers = [0.0; N];
    for i in 0..N {
        numbers[i] = columns[i][k];
    }
    numbers
}

/// Returns the largest number, by halving, which avoids a chain of dependent comparisons.
#[inline(always)]
pub fn highest(numbers: &Lanes) -> f32 {
    let (mut largest, mut count) = (*numbers, LANES / 2);
    while count > 0 {
        for k in 0..count {
            largest[k] = larger(largest[k + count], largest[k]);
        }
        count /= 2;
    }
    largest[0]
}

/// Cosines over a patch.
#[derive(Clone, Copy, Debug)]
pub struct Cosines {
    /// The mean.
    pub mean: f32,
    /// Half width of the interval with the same variance.
    pub half_width: f32,
    /// Upper bound of all cosines.
    pub bound: f32,
}

impl Cosines {
    #[inline(always)]
    fn of_lane(columns: &[Lanes; 3], k: usize) -> Self {
        let [mean, half_width, bound] = lane(columns, k);
        Self { mean, half_width, bound }
    }

    /// Returns the clamped cosine: its root mean square for a leaf, its mean for a cluster; at least a
    /// fraction of its upper bound, and 0 where the bound is not positive.
    #[inline(always)]
    fn clamped<const LEAF: bool>(&self) -> f32 {
        let Self { mean, half_width, bound } = *self;
        let above = larger(mean + half_width, 0.0);
        let value = if LEAF {
            let part = above * above * above / (6.0 * half_width);
            (if mean > half_width { mean * mean + half_width * half_width * (1.0 / 3.0) } else { part }).sqrt()
        } else {
            let part = above * above / (4.0 * half_width);
            if mean > half_width { mean } else { part }
        };
        let floor = bound * if LEAF { LEAF_FLOOR } else { CLUSTER_FLOOR };
        if bound > 0.0 { larger(value, floor) } else { 0.0 }
    }

    /// Returns the fraction of the interval above the horizon, and the mean cosine there.
    #[inline(always)]
    fn visible(&self) -> (f32, f32) {
        let top = larger(smaller(self.mean + self.half_width, self.bound), LEAST_TOP * self.bound);
        let bottom = larger(self.mean - self.half_width, 0.0);
        let fraction = smaller((top - bottom) / (2.0 * self.half_width), 1.0);
        (larger(fraction, LEAST_VISIBLE), 0.5 * (top + bottom))
    }
}

/// Returns the scalar product.
#[inline(always)]
fn dot<S: Simd>(simd: S, a: Vec3, b: Vec3) -> f32 {
    fused(simd, a.x, b.x, fused(simd, a.y, b.y, a.z * b.z))
}

/// Returns the larger of two numbers; `b` if `a` is NaN.
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Returns the smaller of two numbers; `b` if `a` is NaN.
#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[cfg(test)]
mod tests {
    use pulp::Scalar;

    use super::*;
    use crate::{
        environment::BilinearDensity,
        random::{Purpose, Stream},
    };

    fn density() -> BilinearDensity {
        let mut luminance: Vec<f32> = (0..64 * 32).map(|k| ((k * 7919) % 13) as f32).collect();
        luminance[900] = 5e4;
        BilinearDensity::new(64, 32, &luminance).unwrap()
    }

    #[test]
    fn cosines_of_a_patch_are_within_its_bound() {
        let density = density();
        let map = MomentMap::new(&density);
        let mut random = Stream::new(3, Purpose::Test, 0);
        for node in map.root().descendants(5).into_iter().chain(map.root().descendants(9)) {
            if map.moments(node).energy <= 0.0 {
                continue;
            }
            let patch = Patch::new(&map, node);
            for _ in 0..8 {
                let n = Vec3::from(random.direction());
                let bound = patch.cosines(Scalar, n).bound;
                let mass = patch.diffuse_mass::<_, true>(Scalar, n) / patch.energy;
                for w in map.lit_directions(node) {
                    let cosine = n.dot(w.as_vec3());
                    assert!(cosine <= bound + 1e-6, "{node:?} {n}: {cosine} {bound}");
                    // This bounds sample weights by 1 / 0.15 relative to the leaf's mass.
                    assert!(mass >= (LEAF_FLOOR - 1e-6) * cosine, "{node:?} {n}: {mass} {cosine}");
                }
            }
        }
    }

    #[test]
    fn small_patches_have_the_mass_of_their_direction() {
        let density = density();
        let map = MomentMap::new(&density);
        let mut random = Stream::new(4, Purpose::Test, 0);
        // Cells: their directions span 0.1 rad, and D varies by (0.1 / alpha)^2 over them.
        for node in map.root().descendants(11).into_iter().step_by(37) {
            if map.moments(node).energy <= 0.0 || !node.is_cell() {
                continue;
            }
            let (patch, w) = (Patch::new(&map, node), map.moments(node).centroid().as_vec3().normalize());
            for _ in 0..20 {
                let (n, wo) = (Vec3::from(random.direction()), Vec3::from(random.direction()));
                if n.dot(w) < 0.3 || n.dot(wo) < 0.3 {
                    continue;
                }
                let at = Reflection { n, wo, cos_o: n.dot(wo), diffuse: 0.0, specular: 1.0, f0: 1.0, alpha: 0.7 };
                let expected = crate::brdf::Ggx::new(0.7, Vec3::ONE).lobe_cosine(n, wo, w);
                let ratio = masses::<_, true, false>(Scalar, |_| patch, |_| at)[3] / patch.energy / expected;
                // Hammon's shadowing is within 10 %; widening by the cell's spread contributes about 5 %.
                assert!((0.8..1.25).contains(&ratio), "{node:?} {n} {wo}: {ratio}");
            }
        }
    }
}
