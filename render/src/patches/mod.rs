//! Patches of sky: product sampling without a table and without training.
//!
//! A map is divided into rectangles, clusters of them and leaves within each cluster. A patch has its energy and the first two moments of its
//! directions; from these the light that a surface reflects of it follows in closed form ([`mass`]). A draw picks a cluster, then a leaf, in proportion
//! to these masses, and lets the tail draw within the leaf: the density over Y is constant on a leaf.
//!
//! The square of uniform points is cut along the tree in which the map is halved, so that neighbouring points stay neighbours and
//! low-discrepancy points keep their strata.

mod choice;
mod lookup;
mod mass;
mod moments;
mod tree;

use std::collections::HashMap;

use choice::Choice;
use glam::{Vec2, Vec3};
use lookup::Lookup;
use mass::{Block, Patch, Reflection};
use moments::MomentMap;
use rayon::prelude::*;
use tree::{Cuts, Forest};

use crate::{
    columns::{Arena, vectorized},
    environment::BilinearDensity,
    error::{Error, Result},
    latlong,
    sampler::{Coverage, Draws, EnvironmentLight, Sampler},
    simd::{LANES, Lanes},
    tail::{Hierarchical, Node, Tail, TailWarp},
    tile::Rows,
};

/// Most clusters.
const CLUSTERS: usize = 64;
/// Most leaves of a cluster: as many as there are lanes, as a point looks at all leaves of a cluster at once.
const LEAVES: usize = LANES;

/// The patches of a map.
#[derive(Clone, Debug)]
pub struct Patches {
    clusters: Vec<Patch>,
    leaves: Vec<Block>,
    /// The rectangle of Y of each leaf: left, right, top, bottom; and one over its energy.
    rectangles: Vec<[f32; 5]>,
    /// The tree over the clusters, then one over the leaves of each.
    forest: Forest,
    roots: Vec<u32>,
    lookup: Lookup,
}

impl Patches {
    /// Divides the light of a quad-tree tail.
    pub fn new(tail: &Hierarchical) -> Self {
        let map = MomentMap::new(tail.grid());
        let choice = Choice::new(&map, tail);
        let clusters = choice.divide(map.root(), CLUSTERS);
        let leaves: Vec<Vec<Node>> = clusters.par_iter().map(|&cluster| choice.divide(cluster, LEAVES)).collect();
        let mut forest = Forest::default();
        let mut roots = vec![forest.plant(map.root(), &clusters)];
        let mut numbers = HashMap::new();
        let mut rectangles = vec![[0.0; 5]; CLUSTERS * LEAVES];
        for (cluster, (start, own)) in clusters.iter().zip(&leaves).enumerate() {
            roots.push(forest.plant(*start, own));
            for (place, leaf) in own.iter().enumerate() {
                let number = cluster * LEAVES + place;
                numbers.insert(*leaf, number as u16);
                let [left, right, top, bottom] = tail.rectangle(*leaf);
                rectangles[number] = [left, right, top, bottom, (1.0 / map.moments(*leaf).energy) as f32];
            }
        }
        let blocks = leaves.par_iter().map(|own| {
            let mut block = Block::default();
            for (place, leaf) in own.iter().enumerate() {
                Patch::new(&map, *leaf).store(&mut block, place);
            }
            block
        });
        Self {
            leaves: blocks.collect(),
            clusters: clusters.par_iter().map(|&cluster| Patch::new(&map, cluster)).collect(),
            rectangles,
            forest,
            roots,
            lookup: Lookup::new(map.root(), &numbers),
        }
    }
}

/// State of a shading point: its [`Reflection`]'s lobes, then the running sums of the masses of the clusters.
const COLUMNS: usize = LOBES + CLUSTERS;
const LOBES: usize = 4;

/// One lane of what shading points reflect.
#[inline(always)]
fn reflection(n: &[Lanes; 3], wo: &[Lanes; 3], lobes: &[Lanes], lane: usize) -> Reflection {
    Reflection {
        n: Vec3::new(n[0][lane], n[1][lane], n[2][lane]),
        wo: Vec3::new(wo[0][lane], wo[1][lane], wo[2][lane]),
        diffuse: lobes[0][lane],
        specular: lobes[1][lane],
        f0: lobes[2][lane],
        alpha: lobes[3][lane],
    }
}

vectorized! {
    /// The running sums of the clusters' masses; the lobes are there.
    fn prepare['a](_simd, clusters: &'a [Patch], at: &'a Rows<'a>, state: &'a mut [Lanes]) {
        for (strip, state) in state.chunks_exact_mut(COLUMNS).enumerate() {
            let (n, wo) = (at.normals(strip), at.views(strip));
            let (lobes, sums) = state.split_at_mut(LOBES);
            let mut is_glossy = false;
            for k in 0..LANES {
                is_glossy |= lobes[1][k] > 0.0;
            }
            let mut sum = [0.0; LANES];
            for (patch, out) in clusters.iter().zip(&mut *sums) {
                if is_glossy {
                    for k in 0..LANES {
                        sum[k] += patch.mass::<false>(&reflection(&n, &wo, lobes, k));
                    }
                } else {
                    for k in 0..LANES {
                        sum[k] += patch.diffuse_mass::<false>(Vec3::new(n[0][k], n[1][k], n[2][k]));
                    }
                }
                *out = sum;
            }
            for out in &mut sums[clusters.len()..] {
                *out = sum;
            }
        }
    }
}

/// The running sums of the masses of a cluster's leaves for one shading point.
#[inline(always)]
fn leaf_sums(leaves: &Block, at: &Reflection) -> Lanes {
    let mut masses = [0.0; LANES];
    if at.specular > 0.0 {
        for k in 0..LANES {
            masses[k] = Patch::load(leaves, k).mass::<true>(at);
        }
    } else {
        for k in 0..LANES {
            masses[k] = Patch::load(leaves, k).diffuse_mass::<true>(at.n);
        }
    }
    let mut sum = 0.0;
    for k in 0..LANES {
        sum += masses[k];
        masses[k] = sum;
    }
    masses
}

/// The density over Y in a leaf: its probability over its area; 0 where there is nothing to draw.
#[inline(always)]
fn density_of(cluster: f32, clusters: f32, leaf: f32, leaves: f32, inverse_energy: f32) -> f32 {
    let probability = (cluster / clusters) * (leaf / leaves);
    let is_there = (cluster > 0.0) & (leaf > 0.0);
    if is_there { probability * inverse_energy } else { 0.0 }
}

vectorized! {
    fn sample['a](
        _simd, patches: &'a Patches, at: &'a Rows<'a>, state: &'a [Lanes],
        z: [&'a [Lanes]; 2], y: [&'a mut [Lanes]; 2], q: &'a mut [Lanes],
    ) {
        let [y_u, y_v] = y;
        for strip in 0..q.len() {
            let (n, wo) = (at.normals(strip), at.views(strip));
            let (lobes, sums) = state[strip * COLUMNS..][..COLUMNS].split_at(LOBES);
            let z = [z[0][strip], z[1][strip]];
            let clusters = sums[CLUSTERS - 1];
            let root = [patches.roots[0]; LANES];
            let sums = (sums.as_flattened(), clusters);
            let (cluster, cuts) = patches.forest.descend::<LANES, 1>(&root, z, sums, Cuts::SQUARE);
            let (mut sums, mut leaves, mut roots) = ([[0.0; LEAVES]; LANES], [0.0; LANES], [0; LANES]);
            for k in 0..LANES {
                let place = cluster.place[k] as usize;
                sums[k] = leaf_sums(&patches.leaves[place], &reflection(&n, &wo, lobes, k));
                leaves[k] = sums[k][LEAVES - 1];
                roots[k] = patches.roots[1 + place];
            }
            let sums = (sums.as_flattened(), leaves);
            let (leaf, cuts) = patches.forest.descend::<1, LEAVES>(&roots, z, sums, cuts);
            let inside = cuts.inside(&z[0], &z[1]);
            let mut rectangles = [[0.0; LANES]; 5];
            for k in 0..LANES {
                let numbers = &patches.rectangles[cluster.place[k] as usize * LEAVES + leaf.place[k] as usize];
                for (column, number) in rectangles.iter_mut().zip(numbers) {
                    column[k] = *number;
                }
            }
            let [left, right, top, bottom, inverse_energy] = &rectangles;
            for k in 0..LANES {
                y_u[strip][k] = within(left[k], right[k], inside[0][k]);
                y_v[strip][k] = within(top[k], bottom[k], inside[1][k]);
                q[strip][k] = density_of(cluster.mass[k], clusters[k], leaf.mass[k], leaves[k], inverse_energy[k]);
            }
        }
    }
}

/// A place in the interval from `from` to `to`, and never `to` itself, which belongs to the next patch.
#[inline(always)]
fn within(from: f32, to: f32, inside: f32) -> f32 {
    let place = from + (to - from) * inside;
    if place < to { place } else { f32::from_bits(to.to_bits().wrapping_sub(1)) }
}

vectorized! {
    /// The density over Y at the points of Y that are carried to points `x` of X.
    fn density['a](
        _simd, patches: &'a Patches, grid: &'a BilinearDensity, at: &'a Rows<'a>, state: &'a [Lanes],
        x: [&'a [Lanes]; 2], q: &'a mut [Lanes],
    ) {
        for strip in 0..q.len() {
            let (n, wo) = (at.normals(strip), at.views(strip));
            let (lobes, sums) = state[strip * COLUMNS..][..COLUMNS].split_at(LOBES);
            let (mut columns, mut rows) = ([0; LANES], [0; LANES]);
            for k in 0..LANES {
                let (column, row, _) = grid.cell(Vec2::new(x[0][strip][k], x[1][strip][k]));
                (columns[k], rows[k]) = (column as u32, row as u32);
            }
            let mut numbers = [[0.0; LANES]; 4];
            for k in 0..LANES {
                let number = patches.lookup.patch(columns[k], rows[k]) as usize;
                let (cluster, leaf) = (number / LEAVES, number % LEAVES);
                let leaf_sums = leaf_sums(&patches.leaves[cluster], &reflection(&n, &wo, lobes, k));
                let before = if cluster == 0 { 0.0 } else { sums[cluster - 1][k] };
                numbers[0][k] = sums[cluster][k] - before;
                numbers[1][k] = leaf_sums[leaf] - if leaf == 0 { 0.0 } else { leaf_sums[leaf - 1] };
                numbers[2][k] = leaf_sums[LEAVES - 1];
                numbers[3][k] = patches.rectangles[number][4];
            }
            for k in 0..LANES {
                q[strip][k] =
                    density_of(numbers[0][k], sums[CLUSTERS - 1][k], numbers[1][k], numbers[2][k], numbers[3][k]);
            }
        }
    }
}

/// Draws directions by the patches of a light. It covers the whole integrand, but glossy lobes are narrower than patches: there it belongs into
/// a mixture with BRDF sampling, in which it asks for a share that depends on the lobe.
#[derive(Clone, Debug)]
pub struct PatchSampler {
    light: EnvironmentLight,
    patches: Patches,
}

impl PatchSampler {
    /// The sampler of a light.
    ///
    /// # Errors
    /// Its tail is not a quad-tree, in which alone a rectangle of the map is one of Y.
    pub fn new(light: EnvironmentLight) -> Result<Self> {
        let Tail::Hierarchical(tail) = &**light.tail() else {
            return Err(Error::argument("patches", "need the hierarchical tail"));
        };
        let patches = Patches::new(tail);
        Ok(Self { light, patches })
    }
}

impl Sampler for PatchSampler {
    fn columns(&self) -> usize {
        COLUMNS
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        let mut lobes = arena.columns::<LOBES>(at.strips());
        at.lobes(lobes.get_mut(), arena);
        for (strip, state) in state.chunks_exact_mut(COLUMNS).enumerate() {
            for (to, from) in state.iter_mut().zip(lobes.get()) {
                *to = from[strip];
            }
        }
        prepare(&self.patches.clusters, at, state);
    }

    fn sample(&self, at: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], out: Draws<'_>, arena: &Arena) {
        let mut y = arena.columns::<2>(at.strips());
        sample(&self.patches, at, state, u, y.get_mut(), out.pdf);
        self.light.directions(y.get(), out, arena);
    }

    fn pdf(&self, at: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        let mut columns = arena.columns::<3>(at.strips());
        let [u, v, q] = columns.get_mut();
        latlong::squares(wi, [&mut *u, &mut *v]);
        density(&self.patches, self.light.tail().light(), at, state, [u, v], q);
        self.light.tail().density_columns([u, v], out);
        latlong::to_solid_angle(v, out);
        for (out, q) in out.as_flattened_mut().iter_mut().zip(q.as_flattened()) {
            *out *= q;
        }
    }

    fn share(&self, at: &Rows<'_>, out: &mut [Lanes], arena: &Arena) {
        let mut lobes = arena.columns::<LOBES>(at.strips());
        at.lobes(lobes.get_mut(), arena);
        for (strip, out) in out.iter_mut().enumerate() {
            let [_, specular, _, alpha] = lobes.get().map(|column| column[strip]);
            for (k, out) in out.iter_mut().enumerate() {
                *out = if specular[k] > 0.0 { share(alpha[k]) } else { 1.0 };
            }
        }
    }

    fn coverage(&self) -> Coverage {
        self.light.coverage()
    }
}

/// The share of samples beside BRDF sampling for a lobe of a width.
fn share(alpha: f32) -> f32 {
    (0.2 + (alpha - 0.05) * 5.0).clamp(0.2, 0.95)
}
