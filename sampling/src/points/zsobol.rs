//! Sobol points along a curve through the pixels (Ahmed and Wonka 2020, "Screen-Space Blue-Noise Diffusion of Monte Carlo Sampling Error
//! via Hierarchical Ordering of Pixels").
//!
//! The pixels of a block are numbered along Morton's curve, with the four quarters of every square in a
//! random order; the samples of a pixel are consecutive. The samples of every square of `2^k` by `2^k` pixels
//! are therefore a run of one sequence, which a net covers evenly.
//!
//! Each block has its own scrambling. Blocks are wider than any filter, and indices need at most 32 bits.

use crate::simd::LANES;

/// Levels of squares in a block: 64 pixels along a side.
const LEVELS: u32 = 6;

/// Layout of the indices of a pixel's points.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plan {
    /// Levels of squares in a block.
    levels: u32,
    /// Binary digits of a pixel's own part of the index.
    digits: u32,
}

impl Plan {
    /// The layout for `2^digits` points in a pixel's set, at most `2^32`.
    pub fn new(digits: u32) -> Self {
        Self { levels: LEVELS.min((32 - digits) / 2), digits }
    }

    /// Returns the block of a pixel, from its place on Morton's curve.
    #[inline(always)]
    pub fn block(self, key: u32) -> u32 {
        key >> (2 * self.levels)
    }

    /// Returns the number of binary digits of an index.
    #[inline(always)]
    pub fn index_digits(self) -> u32 {
        2 * self.levels + self.digits
    }

    /// Returns the indices, in the sequences of the pixels' blocks, of point `point` of each pixel's set.
    /// `seed` is that of the orders.
    #[inline(always)]
    pub fn indices(self, keys: [u32; LANES], point: u32, seed: u32) -> [u32; LANES] {
        let mut indices = [0; LANES];
        for level in (0..self.levels).rev() {
            let (shift, seed) = (2 * level, hash(seed.wrapping_add(level)));
            for lane in 0..LANES {
                let order = hash((keys[lane] >> (shift + 2)) ^ seed);
                indices[lane] = indices[lane] << 2 | permuted(keys[lane] >> shift & 3, order);
            }
        }
        if self.digits == 0 {
            return indices;
        }
        let unused = 32 - self.digits;
        let point = super::owen::before_seed((point << unused).reverse_bits());
        for lane in 0..LANES {
            let own = super::owen::with_seed(point, hash(keys[lane] ^ seed)).reverse_bits() >> unused;
            indices[lane] = (u64::from(indices[lane]) << self.digits) as u32 | own;
        }
        indices
    }
}

/// Applies one of the 24 permutations of 0 to 3 to a digit. On vectors of two bits, they are the affine maps.
#[inline(always)]
fn permuted(digit: u32, random: u32) -> u32 {
    // Images of 1 and 2 under each of the 6 linear maps: 1 2, 1 3, 2 1, 2 3, 3 1, 3 2.
    const IMAGES: u32 = 0b1011_0111_1110_0110_1101_1001;
    let images = IMAGES >> (4 * (((random & 0xffff) * 6) >> 16));
    (images & 3 & (digit & 1).wrapping_neg()) ^ (images >> 2 & 3 & (digit >> 1).wrapping_neg()) ^ (random >> 30)
}

/// Permutes 32-bit numbers so that every bit depends on all bits (Wellons 2018, `lowbias32`).
#[inline(always)]
fn hash(mut x: u32) -> u32 {
    x = (x ^ x >> 16).wrapping_mul(0x7feb_352d);
    x = (x ^ x >> 15).wrapping_mul(0x846c_a68b);
    x ^ x >> 16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_orders_of_four_squares_are_equally_frequent() {
        let mut counts = std::collections::HashMap::new();
        for k in 0..48_000 {
            *counts.entry([0, 1, 2, 3].map(|digit| permuted(digit, hash(k)))).or_insert(0) += 1;
        }
        assert!(counts.keys().all(|order| (0..4).all(|digit| order.contains(&digit))));
        let statistic: f64 = counts.values().map(|&count| (f64::from(count) - 2000.0).powi(2) / 2000.0).sum();
        // 23 degrees of freedom: mean 23, standard deviation 6.8; the bound is 5 of them.
        assert!(counts.len() == 24 && statistic < 57.0, "{} orders, {statistic}", counts.len());
    }

    #[test]
    fn each_square_of_a_block_is_a_run_of_unique_indices() {
        for (digits, log2_side) in [(0, 3), (1, 3), (2, 2), (3, 2)] {
            let (plan, side) = (Plan::new(digits), 1_u32 << log2_side);
            let mut all = Vec::new();
            for key in 0..side * side {
                let indices: Vec<u32> = (0..1 << digits).map(|point| plan.indices([key; LANES], point, 5)[0]).collect();
                assert!(
                    indices.iter().all(|index| index >> digits == indices[0] >> digits),
                    "a pixel's points are a run"
                );
                all.extend(indices);
            }
            // The square is one of many in its block: its run starts at a multiple of its length.
            let (length, first) = (all.len() as u32, *all.iter().min().unwrap());
            all.sort_unstable();
            assert!(first % length == 0 && all.iter().zip(first..).all(|(&index, expected)| index == expected));
        }
        let all = Plan::new(32);
        assert_eq!((all.levels, all.block(77)), (0, 77));
    }
}
