//! Patches of sky: product sampling without tables and without training.
//!
//! A map is divided into rectangles: clusters, leaves within each cluster, and twigs within each leaf. A
//! patch stores its energy and the first two moments of its directions; the light from it that a surface
//! reflects follows in closed form (`mass.rs`). A draw picks a cluster, then a leaf, then (for narrow lobes)
//! a twig in proportion to these masses, and the tail samples within it: the density over Y is constant on a
//! patch.
//!
//! A draw is a warp of the square of uniform points, so that a head can precede it: Z → U → Y → X by head,
//! patches and tail. The head then learns only the residual of the closed form.
//!
//! The square of uniform points is cut along the tree in which the map is halved, so that neighbouring points stay neighbours and
//! low-discrepancy points keep their strata.
//!
//! | file | concept |
//! | --- | --- |
//! | `moments.rs` | moments of the light over rectangles of the map |
//! | `choice.rs` | where the map is divided |
//! | `mass.rs` | the light from a patch that a surface reflects |
//! | `tree.rs` | cutting the square along the tree of the map |
//! | `draw.rs` | preparation, sampling and density over columns |
//! | `lookup.rs` | the patch of a cell of the map |
//! | `small_lights.rs` | sample fractions of small lights |
//! | `rays.rs` | rays that visibility is learned from |
//! | `warp.rs` | the warp at one shading point, for training |
//! | `flat.rs` | patches as arrays, for other devices |

mod choice;
mod draw;
mod flat;
mod lookup;
mod mass;
mod moments;
mod rays;
mod small_lights;
mod tree;
mod warp;

pub use rays::SkyRays;
pub use warp::PatchWarp;

use std::{collections::HashMap, sync::Arc};

use crate::parallel::*;
use choice::Choice;
use draw::{COLUMNS, LOBES, MIXTURE_WEIGHT};
use glam::{Vec2, Vec3A};
use lookup::Lookup;
use mass::{Block, Patch};
use moments::MomentMap;
use serde::{Deserialize, Serialize};
use tree::Forest;

use crate::{
    columns::Arena,
    error::{Error, Result},
    head::{Head, logit_of_mixture_weight},
    latlong,
    sampler::{Coverage, Draws, EnvironmentLight, IntermediateDensity, Sampler, prepared},
    simd::{LANES, Lanes},
    tail::{Hierarchical, Node, Tail, TailWarp},
    tile::Rows,
    visibility::{CLUSTERS, Division, PATCHES, Unoccluded, Weighting},
};

/// Largest number of leaves of a cluster and of twigs of a leaf: one per lane, as a point evaluates all of
/// them at once.
const PARTS: usize = LANES;

/// How finely patches divide the light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Detail {
    /// Twigs for narrow lobes only: where visibility dominates noise, leaves are enough.
    Leaves,
    /// Twigs for all surfaces: less variance where nothing is in shadow, but more expensive samples.
    Twigs,
}

impl Detail {
    /// Lobe width below which twigs are used.
    fn narrow(self) -> f32 {
        match self {
            Self::Leaves => 0.3,
            Self::Twigs => f32::INFINITY,
        }
    }
}

/// The patches of a map.
#[derive(Clone, Debug)]
pub struct Patches {
    /// Lobe width below which twigs are used; a diffuse surface counts as a lobe of width 1.
    narrow: f32,
    clusters: Vec<Patch>,
    /// The mean density over solid angle of the light of each cluster, see [`moments::Moments::brightness`].
    brightness: Vec<f32>,
    leaves: Level,
    twigs: Level,
    forest: Forest,
    /// Number of clusters that are small lights; these come first and get a fraction of samples of their own.
    small: usize,
    /// The number of each cluster in the order of the map, by which learned visibility is indexed.
    numbers: Vec<usize>,
    /// The tree over the clusters.
    root: u32,
    /// A tree of one patch, for lanes that do not descend.
    rest: u32,
    lookup: Lookup,
}

/// The parts of all patches of the level above, [`PARTS`] for each.
#[derive(Clone, Debug, Default)]
struct Level {
    blocks: Vec<Block>,
    /// The trees over the parts.
    roots: Vec<u32>,
    /// The rectangle of each part in Y: left, right, top, bottom; and the reciprocal of its energy.
    rectangles: Vec<[f32; 5]>,
}

impl Level {
    /// Divides patches; also returns their parts and the numbers of these.
    fn new(
        (map, tail): (&MomentMap<'_>, &Hierarchical),
        above: &[(usize, Node)],
        forest: &mut Forest,
        divide: impl Fn(Node) -> Vec<Node> + Sync,
    ) -> (Self, Vec<(usize, Node)>) {
        let count = above.last().map_or(0, |(number, _)| number + 1);
        let parts: Vec<Vec<Node>> = above.par_iter().map(|&(_, node)| divide(node)).collect();
        let block = |own: &Vec<Node>| {
            let mut block = Block::default();
            for (place, part) in own.iter().enumerate() {
                Patch::new(map, *part).store(&mut block, place);
            }
            block
        };
        let blocks: Vec<Block> = parts.par_iter().map(block).collect();
        let mut level = Self {
            blocks: vec![Block::default(); count],
            roots: vec![0; count],
            rectangles: vec![[0.0; 5]; count * PARTS],
        };
        let mut numbered = Vec::new();
        for ((&(number, start), own), block) in above.iter().zip(&parts).zip(blocks) {
            level.blocks[number] = block;
            level.roots[number] = forest.plant(start, own);
            for (place, part) in own.iter().enumerate() {
                let [left, right, top, bottom] = tail.rectangle(*part);
                let inverse_energy = (1.0 / map.moments(*part).energy) as f32;
                level.rectangles[number * PARTS + place] = [left, right, top, bottom, inverse_energy];
                numbered.push((number * PARTS + place, *part));
            }
        }
        (level, numbered)
    }
}

impl Patches {
    /// The patches of a sampler without a head. With [`Detail::Leaves`], where visibility dominates noise,
    /// small lights get a fraction of samples of their own (`patches/small_lights.rs`).
    pub fn alone(tail: &Hierarchical, detail: Detail) -> Self {
        Self::divided(tail, detail, detail == Detail::Leaves)
    }

    /// Divides the light of a quad-tree tail; all patches are drawn in proportion to their masses.
    pub fn new(tail: &Hierarchical, detail: Detail) -> Self {
        Self::divided(tail, detail, false)
    }

    fn divided(tail: &Hierarchical, detail: Detail, by_quarters: bool) -> Self {
        let map = MomentMap::new(tail.grid());
        let choice = Choice::new(&map, tail);
        let of_map = choice.divide(map.root(), CLUSTERS);
        let is_small = |cluster: &usize| by_quarters && small_lights::is_small(&map, of_map[*cluster]);
        let (small, rest): (Vec<usize>, Vec<usize>) = (0..of_map.len()).partition(is_small);
        // Without other clusters there is nothing to divide samples between.
        let small_lights = if rest.is_empty() { 0 } else { small.len() };
        let numbers = [small, rest].concat();
        let clusters: Vec<Node> = numbers.iter().map(|&cluster| of_map[cluster]).collect();
        let numbered: Vec<(usize, Node)> = clusters.iter().copied().enumerate().collect();
        let mut forest = Forest::default();
        let (small, rest) = clusters.split_at(small_lights);
        let (root, rest) = (forest.plant_beside(map.root(), small, rest), forest.plant(map.root(), &[]));
        let by_cosine = |node| choice.divide(node, PARTS);
        let (leaves, numbered) = Level::new((&map, tail), &numbered, &mut forest, by_cosine);
        let by_spread = |node| choice.divide_by_spread(node, PARTS);
        let (twigs, numbered) = Level::new((&map, tail), &numbered, &mut forest, by_spread);
        let twig_of: HashMap<Node, u16> = numbered.into_iter().map(|(number, node)| (node, number as u16)).collect();
        Self {
            narrow: detail.narrow(),
            brightness: clusters.iter().map(|&cluster| map.moments(cluster).brightness() as f32).collect(),
            clusters: clusters.par_iter().map(|&cluster| Patch::new(&map, cluster)).collect(),
            leaves,
            twigs,
            forest,
            small: small_lights,
            numbers,
            root,
            rest,
            lookup: Lookup::new(map.root(), &twig_of),
        }
    }
}

impl Patches {
    /// Computes the state of shading points, [`COLUMNS`] lanes for each strip.
    fn prepare<W: Weighting>(&self, weighting: &W, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        let mut columns = arena.columns::<{ LOBES + 1 }>(at.strips());
        let [a, b, c, d, weights] = columns.get_mut();
        at.lobes([a, b, c, d], arena);
        weighting.indices(at, weights);
        for (strip, state) in state.chunks_exact_mut(COLUMNS).enumerate() {
            for (to, from) in state.iter_mut().zip(columns.get()) {
                *to = from[strip];
            }
        }
        draw::prepare(self, weighting, at, state);
    }
}

/// Samples directions by the patches of a light. It covers the whole integrand, but glossy lobes can be
/// narrower than patches: combine it with BRDF sampling, in which its mixture weight depends on the lobe.
#[derive(Clone, Debug)]
pub struct PatchSampler {
    light: EnvironmentLight,
    patches: Arc<Patches>,
    head: Option<Arc<Head>>,
}

impl PatchSampler {
    /// The sampler of a light.
    ///
    /// # Errors
    /// The tail is not a quad-tree, which makes rectangles of the map rectangles of Y.
    pub fn new(light: EnvironmentLight, detail: Detail) -> Result<Self> {
        let patches = Arc::new(Patches::alone(quad_tree(&light)?, detail));
        Ok(Self { light, patches, head: None })
    }

    /// The sampler of a light with a head before the patches, which samples their residual. A mixture weight
    /// that the head has learned is a factor of the odds of patches.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_head(light: EnvironmentLight, detail: Detail, head: Head) -> Result<Self> {
        let patches = Arc::new(Patches::new(quad_tree(&light)?, detail));
        Ok(Self { light, patches, head: Some(Arc::new(head)) })
    }

    /// The same sampler with the masses of patches multiplied by weights.
    pub fn weighted<'a, W: Weighting>(&'a self, weighting: &'a W) -> WeightedPatches<'a, W> {
        WeightedPatches { light: &self.light, patches: &self.patches, head: self.head.as_deref(), weighting }
    }

    /// Returns the number of each cluster in the order of the map, which that of [`Self::division`] is.
    pub(crate) fn cluster_numbers(&self) -> &[usize] {
        &self.patches.numbers
    }

    /// The patches that weights refer to, in the order of the map, with their fractions of the light; 0 for
    /// missing patches.
    pub fn division(&self) -> Division {
        let mut energies = vec![0.0; PATCHES];
        for (block, number) in self.patches.leaves.blocks.iter().zip(&self.patches.numbers) {
            energies[number * PARTS..][..PARTS].copy_from_slice(&block[0]);
        }
        Division::new(energies)
    }

    /// Returns the patch of [`Self::division`] of each direction.
    pub fn patches_of(&self, wi: &[Vec3A]) -> Vec<u16> {
        wi.iter().map(|&wi| self.patch_at(latlong::square(wi))).collect()
    }

    /// Returns the patch of [`Self::division`] of a point of X.
    pub fn patch_at(&self, x: Vec2) -> u16 {
        let (column, row, _) = self.light.tail().light().cell(x);
        let leaf = self.patches.lookup.patch(column as u32, row as u32) as usize / PARTS;
        (self.patches.numbers[leaf / PARTS] * PARTS + leaf % PARTS) as u16
    }
}

/// Returns the tail if it is a quad-tree, in which a rectangle of the map is a rectangle of Y.
fn quad_tree(light: &EnvironmentLight) -> Result<&Hierarchical> {
    match &**light.tail() {
        Tail::Hierarchical(tail) => Ok(tail),
        _ => Err(Error::argument("patches", "need the hierarchical tail")),
    }
}

/// A [`PatchSampler`] with weights.
#[derive(Clone, Copy, Debug)]
pub struct WeightedPatches<'a, W> {
    light: &'a EnvironmentLight,
    patches: &'a Patches,
    head: Option<&'a Head>,
    weighting: &'a W,
}

impl<W: Weighting> Sampler for WeightedPatches<'_, W> {
    fn columns(&self) -> usize {
        COLUMNS + self.head.map_or(0, IntermediateDensity::columns)
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        let (state, of_head) = state.split_at_mut(COLUMNS * at.strips());
        if let Some(head) = self.head {
            head.prepare(at, of_head, arena);
        }
        self.patches.prepare(self.weighting, at, state, arena);
    }

    fn sample(&self, at: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], out: Draws<'_>, arena: &Arena) {
        let (state, of_head) = state.split_at(COLUMNS * at.strips());
        let (patches, weighting) = (self.patches, self.weighting);
        let mut y = arena.columns::<2>(at.strips());
        if let Some(head) = self.head {
            let mut through = arena.columns::<3>(at.strips());
            let [z_u, z_v, q] = through.get_mut();
            head.sample(at, of_head, u, [&mut *z_u, &mut *z_v], q, arena);
            draw::sample(patches, weighting, at, state, [z_u, z_v], y.get_mut(), out.pdf);
            multiply(out.pdf, q);
        } else {
            draw::sample(patches, weighting, at, state, u, y.get_mut(), out.pdf);
        }
        self.light.directions(y.get(), out, arena);
    }

    fn pdf(&self, at: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        let (state, of_head) = state.split_at(COLUMNS * at.strips());
        let (patches, weighting, grid) = (self.patches, self.weighting, self.light.tail().light());
        let mut columns = arena.columns::<7>(at.strips());
        let [x_u, x_v, y_u, y_v, z_u, z_v, q] = columns.get_mut();
        latlong::squares(wi, [&mut *x_u, &mut *x_v]);
        if let Some(head) = self.head {
            self.light.tail().inverse_columns([x_u, x_v], [&mut *y_u, &mut *y_v], out);
            draw::invert(patches, weighting, grid, at, state, [x_u, x_v], [y_u, y_v], [&mut *z_u, &mut *z_v], q);
            latlong::to_solid_angle(x_v, out);
            multiply(out, q);
            head.density(at, of_head, [z_u, z_v], q, arena);
        } else {
            draw::density(patches, weighting, grid, at, state, [x_u, x_v], q);
            self.light.pdf_at([x_u, x_v], out);
        }
        multiply(out, q);
    }

    fn mixture_weight(&self, at: &Rows<'_>, out: &mut [Lanes], arena: &Arena) {
        let Some(head) = self.head else {
            return prepared(self, at, arena, |state| self.mixture_weight_of_state(at, state, out, arena));
        };
        let mut lobes = arena.columns::<LOBES>(at.strips());
        at.lobes(lobes.get_mut(), arena);
        draw::mixture_weights_by_width(lobes.get(), out);
        if head.has_mixture_weight() {
            for mixture_weight in out.as_flattened_mut() {
                *mixture_weight = logit_of_mixture_weight(*mixture_weight);
            }
            head.mixture_weight_after(at, out, arena);
        }
    }

    /// With a head, the mixture weight comes from the head instead.
    fn has_mixture_weight_in_state(&self) -> bool {
        self.head.is_none()
    }

    fn mixture_weight_of_state(&self, _at: &Rows<'_>, state: &[Lanes], out: &mut [Lanes], _arena: &Arena) {
        for (state, out) in state.chunks_exact(COLUMNS).zip(out) {
            *out = state[MIXTURE_WEIGHT];
        }
    }

    fn coverage(&self) -> Coverage {
        self.light.coverage()
    }
}

/// Multiplies densities by others.
fn multiply(by: &mut [Lanes], others: &[Lanes]) {
    for (density, other) in by.as_flattened_mut().iter_mut().zip(others.as_flattened()) {
        *density *= other;
    }
}

impl Sampler for PatchSampler {
    fn columns(&self) -> usize {
        self.weighted(&Unoccluded).columns()
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        self.weighted(&Unoccluded).prepare(at, state, arena);
    }

    fn sample(&self, at: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], out: Draws<'_>, arena: &Arena) {
        self.weighted(&Unoccluded).sample(at, state, u, out, arena);
    }

    fn pdf(&self, at: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        self.weighted(&Unoccluded).pdf(at, state, wi, out, arena);
    }

    fn mixture_weight(&self, at: &Rows<'_>, out: &mut [Lanes], arena: &Arena) {
        self.weighted(&Unoccluded).mixture_weight(at, out, arena);
    }

    fn has_mixture_weight_in_state(&self) -> bool {
        self.weighted(&Unoccluded).has_mixture_weight_in_state()
    }

    fn mixture_weight_of_state(&self, at: &Rows<'_>, state: &[Lanes], out: &mut [Lanes], arena: &Arena) {
        self.weighted(&Unoccluded).mixture_weight_of_state(at, state, out, arena);
    }

    fn coverage(&self) -> Coverage {
        self.weighted(&Unoccluded).coverage()
    }
}
