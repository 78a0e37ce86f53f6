//! The patches of a map: clusters, leaves, twigs.

use serde::{Deserialize, Serialize};

use super::{
    choice::Choice,
    lookup::Lookup,
    mass::{Block, Patch},
    moments::MomentMap,
    small_lights,
    tree::Forest,
};
use crate::{
    parallel::*,
    simd::LANES,
    tail::{Hierarchical, Node},
    visibility::CLUSTERS,
};

/// Largest number of leaves of a cluster and of twigs of a leaf: one per lane, as a point evaluates all of
/// them at once.
pub(super) const PARTS: usize = LANES;

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
    pub(super) narrow: f32,
    pub(super) clusters: Vec<Patch>,
    /// The mean density over solid angle of the light of each cluster, see [`super::moments::Moments::brightness`].
    pub(super) brightness: Vec<f32>,
    pub(super) leaves: Level,
    pub(super) twigs: Level,
    pub(super) forest: Forest,
    /// Number of clusters that are small lights; these come first and get a fraction of samples of their own.
    pub(super) small: usize,
    /// The number of each cluster in the order of the map, by which learned visibility is indexed.
    pub(super) numbers: Vec<usize>,
    /// The tree over the clusters.
    pub(super) root: u32,
    /// A tree of one patch, for lanes that do not descend.
    pub(super) rest: u32,
    pub(super) lookup: Lookup,
}

/// The parts of all patches of the level above, [`PARTS`] for each.
#[derive(Clone, Debug, Default)]
pub(super) struct Level {
    pub(super) blocks: Vec<Block>,
    /// The trees over the parts.
    pub(super) roots: Vec<u32>,
    /// The rectangle of each part in Y: left, right, top, bottom; and the reciprocal of its energy.
    pub(super) rectangles: Vec<[f32; 5]>,
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
        let numbered = numbered.into_iter().map(|(number, node)| (node, number as u16)).collect();
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
            lookup: Lookup::new(map.root(), numbered),
        }
    }
}
