//! Trees of patches: the square is cut in proportion to masses and in the order in which the map is divided,
//! so that neighbours stay neighbours.

use crate::{
    discrete::{BELOW_ONE, remap},
    simd::{LANES, Lanes},
    tail::Node,
};

/// A node of a tree over at most 128 patches, packed into one number as the descent loads one per lane: bits
/// 0 to 6 are the place of the first patch of its second half, bit 7 is set if it cuts columns, bits 8 to 15
/// and 16 to 23 are its halves, bit 24 is set for a single patch.
#[derive(Clone, Copy, Debug)]
struct Split(u32);

const CUTS_COLUMNS: u32 = 1 << 7;
const IS_SINGLE: u32 = 1 << 24;

impl Split {
    fn new(halves_columns: bool, middle: usize, halves: [usize; 2]) -> Self {
        Self(
            middle as u32
                | if halves_columns { CUTS_COLUMNS } else { 0 }
                | (halves[0] as u32) << 8
                | (halves[1] as u32) << 16,
        )
    }

    /// A patch at a place; both halves are itself.
    fn single(place: usize, own: usize) -> Self {
        Self(place as u32 | (own as u32) << 8 | (own as u32) << 16 | IS_SINGLE)
    }
}

/// Binary trees over patches, stored one after the other; the patches of each are in tree order.
#[derive(Clone, Debug, Default)]
pub struct Forest(Vec<Split>);

/// Rectangles of the square of uniform points, as the descent cuts them, one per lane.
#[derive(Clone, Copy)]
pub struct Cuts {
    pub left: Lanes,
    pub right: Lanes,
    pub top: Lanes,
    pub bottom: Lanes,
}

impl Cuts {
    /// The whole square.
    pub const SQUARE: Self = Self { left: [0.0; LANES], right: [1.0; LANES], top: [0.0; LANES], bottom: [1.0; LANES] };

    /// Maps places inside the rectangles to points of the square, below 1.
    #[inline(always)]
    pub fn outside(&self, [u, v]: &[Lanes; 2]) -> [Lanes; 2] {
        let mut points = [[0.0; LANES]; 2];
        for k in 0..LANES {
            let (across, down) = (self.right[k] - self.left[k], self.bottom[k] - self.top[k]);
            points[0][k] = below_one(self.left[k] + across * u[k]);
            points[1][k] = below_one(self.top[k] + down * v[k]);
        }
        points
    }

    /// Maps points of the square to places inside the rectangles.
    #[inline(always)]
    pub fn inside(&self, u: &Lanes, v: &Lanes) -> [Lanes; 2] {
        let mut inside = [[0.0; LANES]; 2];
        for k in 0..LANES {
            inside[0][k] = remap(u[k], self.left[k], self.right[k]);
            inside[1][k] = remap(v[k], self.top[k], self.bottom[k]);
        }
        inside
    }
}

/// The targets of lanes that descend a tree.
pub trait Aim {
    /// Returns all bits set for a lane that descends into the first half of a node, whose second half begins
    /// at the place `middle`: it is cut at `cut`, along columns where that mask is set.
    fn is_first(&self, lane: usize, columns: u32, cut: f32, middle: u32) -> u32;
}

/// The patches that contain points `u`, `v` of the square.
pub struct Points(pub [Lanes; 2]);

impl Aim for Points {
    #[inline(always)]
    fn is_first(&self, lane: usize, columns: u32, cut: f32, _middle: u32) -> u32 {
        u32::from(select(columns, self.0[0][lane], self.0[1][lane]) < cut).wrapping_neg()
    }
}

/// The patches at given places.
pub struct Places(pub [u32; LANES]);

impl Aim for Places {
    #[inline(always)]
    fn is_first(&self, lane: usize, _columns: u32, _cut: f32, middle: u32) -> u32 {
        u32::from(self.0[lane] < middle).wrapping_neg()
    }
}

/// The patches that were found, one per lane.
pub struct Found {
    /// Places in the order of the tree.
    pub place: [u32; LANES],
    /// Masses.
    pub mass: Lanes,
}

impl Forest {
    /// All splits as they are stored.
    pub fn splits(&self) -> Vec<u32> {
        self.0.iter().map(|split| split.0).collect()
    }

    /// Adds the tree over `patches` (at most 128), which tile a part of `start` in tree order, and returns
    /// its root. Halves without a patch are left out.
    pub fn plant(&mut self, start: Node, patches: &[Node]) -> u32 {
        let base = self.0.len();
        self.add(start, patches, 0, base);
        base as u32
    }

    /// Adds a tree over two groups of patches: the first gets the left part of the square, the second the
    /// rest.
    pub fn plant_beside(&mut self, start: Node, first: &[Node], second: &[Node]) -> u32 {
        if first.is_empty() || second.is_empty() {
            return self.plant(start, if first.is_empty() { second } else { first });
        }
        let base = self.0.len();
        // Replaced when its halves exist.
        self.0.push(Split::single(0, 0));
        let halves = [self.add(start, first, 0, base), self.add(start, second, first.len(), base)];
        self.0[base] = Split::new(true, first.len(), halves);
        base as u32
    }

    /// Adds the tree over `patches`, the first of which has the place `first`. Returns its number relative to
    /// `base`.
    fn add(&mut self, node: Node, patches: &[Node], first: usize, base: usize) -> usize {
        let own = self.0.len() - base;
        if patches.len() <= 1 {
            self.0.push(Split::single(first, own));
            return own;
        }
        let [upper, lower] = node.children();
        let in_lower =
            |patch: &Node| if node.halves_columns() { patch.column >= lower.column } else { patch.row >= lower.row };
        let middle = patches.partition_point(|patch| !in_lower(patch));
        match patches.split_at(middle) {
            ([], patches) => self.add(lower, patches, first, base),
            (patches, []) => self.add(upper, patches, first, base),
            (above, below) => {
                // Replaced when its halves exist.
                self.0.push(Split::single(first, own));
                let halves = [self.add(upper, above, first, base), self.add(lower, below, first + middle, base)];
                self.0[base + own] = Split::new(node.halves_columns(), first + middle, halves);
                own
            }
        }
    }

    /// Descends one tree for each lane, from `roots`, and cuts rectangles in proportion to masses. In lane
    /// `k`, the sum of the masses before the place `p > 0` is `sums[(p - 1) * BY_PLACE + k * BY_LANE]`;
    /// `total` is that of all.
    #[inline(always)]
    pub fn descend<const BY_PLACE: usize, const BY_LANE: usize>(
        &self,
        roots: &[u32; LANES],
        aim: &impl Aim,
        (sums, total): (&[f32], Lanes),
        mut cuts: Cuts,
    ) -> (Found, Cuts) {
        let (mut before, mut after, mut node) = ([0.0; LANES], total, [0_u32; LANES]);
        loop {
            let (mut splits, mut middle, mut all_single) = ([0_u32; LANES], [0.0; LANES], IS_SINGLE);
            for k in 0..LANES {
                splits[k] = self.0[(roots[k] + node[k]) as usize].0;
                // A tree of one patch has no sum before its first place; it is not used.
                let place = ((splits[k] & 0x7f) as usize).max(1);
                middle[k] = sums[(place - 1) * BY_PLACE + k * BY_LANE];
                all_single &= splits[k];
            }
            if all_single != 0 {
                let mut found = Found { place: [0; LANES], mass: [0.0; LANES] };
                for k in 0..LANES {
                    found.place[k] = splits[k] & 0x7f;
                    found.mass[k] = after[k] - before[k];
                }
                return (found, cuts);
            }
            for k in 0..LANES {
                let columns = mask(splits[k] & CUTS_COLUMNS);
                let from = select(columns, cuts.left[k], cuts.top[k]);
                let to = select(columns, cuts.right[k], cuts.bottom[k]);
                let mass = after[k] - before[k];
                let mass = if mass > f32::MIN_POSITIVE { mass } else { f32::MIN_POSITIVE };
                let cut = from + (to - from) * ((middle[k] - before[k]) / mass);
                let is_first = aim.is_first(k, columns, cut, splits[k] & 0x7f);
                // A single patch keeps both sides.
                let is_single = mask(splits[k] & IS_SINGLE);
                let keeps_lower = is_first | is_single;
                let keeps_upper = !is_first | is_single;
                let (lower, upper) = (select(keeps_lower, from, cut), select(keeps_upper, to, cut));
                before[k] = select(keeps_lower, before[k], middle[k]);
                after[k] = select(keeps_upper, after[k], middle[k]);
                cuts.left[k] = select(columns, lower, cuts.left[k]);
                cuts.right[k] = select(columns, upper, cuts.right[k]);
                cuts.top[k] = select(columns, cuts.top[k], lower);
                cuts.bottom[k] = select(columns, cuts.bottom[k], upper);
                let halves = (splits[k] >> 8 & is_first) | (splits[k] >> 16 & !is_first);
                node[k] = halves & 0xff;
            }
        }
    }
}

/// Returns the number, or the largest f32 below 1 if that is smaller.
#[inline(always)]
fn below_one(number: f32) -> f32 {
    if number < BELOW_ONE { number } else { BELOW_ONE }
}

/// Returns all bits set if `bit` is not 0.
#[inline(always)]
fn mask(bit: u32) -> u32 {
    u32::from(bit != 0).wrapping_neg()
}

/// Returns `a` where the mask is set, else `b`. Bitwise, because compilers turn chains of choices into
/// branches.
#[inline(always)]
fn select(mask: u32, a: f32, b: f32) -> f32 {
    f32::from_bits((a.to_bits() & mask) | (b.to_bits() & !mask))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Patches of a square of 8 x 8 cells in the order of the tree, of different sizes.
    fn patches(root: Node) -> Vec<Node> {
        let (mut patches, mut stack) = (Vec::new(), vec![root]);
        while let Some(node) = stack.pop() {
            if node.is_cell() || (node.column * 3 + node.row * 5 + node.width_bits) % 7 == 1 {
                patches.push(node);
            } else {
                let [a, b] = node.children();
                stack.extend([b, a]);
            }
        }
        patches
    }

    #[test]
    fn rectangles_are_proportional_to_masses_and_tile_the_square() {
        let root = Node::root(8, 8);
        let patches = patches(root);
        assert!((8..=64).contains(&patches.len()));
        let mut forest = Forest::default();
        // Another tree comes first: places are relative to their own root.
        forest.plant(root, &patches[..3]);
        let start = forest.plant(root, &patches);
        // One patch has no mass.
        let masses: Vec<f32> =
            (0..patches.len()).map(|k| if k == 4 { 0.0 } else { 1.0 + (k * 7 % 5) as f32 }).collect();
        let mut sums: Vec<f32> = masses
            .iter()
            .scan(0.0, |sum, mass| {
                *sum += mass;
                Some(*sum)
            })
            .collect();
        let total = sums[sums.len() - 1];
        sums.resize(64, total);
        const SIDE: usize = 64;
        let mut areas = vec![0.0_f32; patches.len()];
        let mut drawn = vec![0; patches.len()];
        for k in 0..SIDE * SIDE {
            let u = ((k % SIDE) as f32 + 0.5) / SIDE as f32;
            let v = ((k / SIDE) as f32 + 0.5) / SIDE as f32;
            let (found, cuts) = forest.descend::<1, 0>(
                &[start; LANES],
                &Points([[u; LANES], [v; LANES]]),
                (&sums, [total; LANES]),
                Cuts::SQUARE,
            );
            let place = found.place[3] as usize;
            assert_eq!(found.mass[3], masses[place]);
            assert!(cuts.left[3] <= u && u <= cuts.right[3] && cuts.top[3] <= v && v <= cuts.bottom[3]);
            // The descent to the place equals the descent to the point, bit for bit.
            let aim = Places([place as u32; LANES]);
            let (same, rectangle) =
                forest.descend::<1, 0>(&[start; LANES], &aim, (&sums, [total; LANES]), Cuts::SQUARE);
            assert_eq!((same.place, same.mass), (found.place, found.mass));
            let sides = |cuts: &Cuts| [cuts.left[3], cuts.right[3], cuts.top[3], cuts.bottom[3]];
            assert_eq!(sides(&rectangle), sides(&cuts));
            let back = rectangle.outside(&cuts.inside(&[u; LANES], &[v; LANES]));
            assert!((back[0][3] - u).abs() < 2e-7 && (back[1][3] - v).abs() < 2e-7);
            areas[place] = (cuts.right[3] - cuts.left[3]) * (cuts.bottom[3] - cuts.top[3]);
            drawn[place] += 1;
        }
        for (place, (&area, &mass)) in areas.iter().zip(&masses).enumerate() {
            // A product of at most six quotients in f32.
            assert!((area - mass / total).abs() < 1e-6, "{place}: {area} {}", mass / total);
            // The number of grid points in a rectangle is its area, except along its sides.
            let expected = mass / total * (SIDE * SIDE) as f32;
            assert!(
                (drawn[place] as f32 - expected).abs() <= 2.0 * SIDE as f32,
                "{place}: {} {expected}",
                drawn[place]
            );
            assert!(mass > 0.0 || drawn[place] == 0);
        }
        assert_eq!(drawn.iter().sum::<i32>(), (SIDE * SIDE) as i32);
    }

    #[test]
    fn the_order_of_the_tree_keeps_neighbours_together() {
        // With equal masses of all cells, the square is cut as the map is: places are those of the cells.
        let root = Node::root(8, 8);
        let cells = root.descendants(6);
        let mut forest = Forest::default();
        let start = forest.plant(root, &cells);
        let sums: Vec<f32> = (1..=64).map(|k| k as f32).collect();
        for (place, cell) in cells.iter().enumerate() {
            let (u, v) = ((cell.column as f32 + 0.3) / 8.0, (cell.row as f32 + 0.8) / 8.0);
            let (found, cuts) = forest.descend::<1, 0>(
                &[start; LANES],
                &Points([[u; LANES], [v; LANES]]),
                (&sums, [64.0; LANES]),
                Cuts::SQUARE,
            );
            assert_eq!(found.place, [place as u32; LANES]);
            let inside = cuts.inside(&[u; LANES], &[v; LANES]);
            assert!((inside[0][0] - 0.3).abs() < 1e-5 && (inside[1][0] - 0.8).abs() < 1e-5);
        }
    }
}
