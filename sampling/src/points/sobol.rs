//! Sobol's sequence (1967) with the direction numbers of Joe and Kuo (2008, "Constructing Sobol sequences with better two-dimensional
//! projections").
//!
//! Numbers are stored with their bits reversed, the first binary digit in bit 0, as [`super::owen`] requires.

use crate::simd::LANES;

/// Number of dimensions of the sequence.
pub(super) const DIMENSIONS: usize = 4;

/// The primitive polynomial of each dimension after the first, from Joe and Kuo's table `new-joe-kuo-6`:
/// degree, inner coefficients, and as many initial direction numbers as the degree.
const POLYNOMIALS: [(usize, u32, [u32; 3]); DIMENSIONS - 1] = [(1, 0, [1, 0, 0]), (2, 1, [1, 3, 0]), (3, 1, [1, 3, 1])];

/// Columns of the generator matrices, `[dimension][binary digit of the index]`, reversed.
pub(super) const COLUMNS: [[u32; 32]; DIMENSIONS] = columns();

const fn columns() -> [[u32; 32]; DIMENSIONS] {
    let mut all = [[0; 32]; DIMENSIONS];
    let mut digit = 0;
    while digit < 32 {
        // The first dimension is van der Corput's: the index itself, reversed.
        all[0][digit] = 1 << digit;
        digit += 1;
    }
    let mut dimension = 1;
    while dimension < DIMENSIONS {
        all[dimension] = columns_of(POLYNOMIALS[dimension - 1]);
        dimension += 1;
    }
    all
}

/// Evaluates the recurrence of Joe and Kuo's equation 2, for direction numbers as binary fractions
/// `v_k = m_k / 2^k`.
const fn columns_of((degree, coefficients, initial): (usize, u32, [u32; 3])) -> [u32; 32] {
    let mut v = [0_u32; 32];
    let mut k = 0;
    while k < 32 {
        if k < degree {
            v[k] = initial[k] << (31 - k);
        } else {
            v[k] = v[k - degree] ^ (v[k - degree] >> degree);
            let mut i = 1;
            while i < degree {
                if coefficients >> (degree - 1 - i) & 1 == 1 {
                    v[k] ^= v[k - i];
                }
                i += 1;
            }
        }
        k += 1;
    }
    k = 0;
    while k < 32 {
        v[k] = v[k].reverse_bits();
        k += 1;
    }
    v
}

/// Returns a dimension of point `index`, reversed.
pub(super) fn reversed(index: u32, dimension: usize) -> u32 {
    let mut sum = 0;
    for (digit, column) in COLUMNS[dimension].iter().enumerate() {
        sum ^= column & (index >> digit & 1).wrapping_neg();
    }
    sum
}

/// Returns a dimension of the point of each lane, reversed; indices have at most `digits` binary digits.
#[inline(always)]
pub(super) fn reversed_lanes(indices: [u32; LANES], digits: u32, dimension: usize) -> [u32; LANES] {
    match dimension {
        0 => indices,
        1 => pascal(indices),
        _ => {
            let mut sums = [0; LANES];
            for (digit, column) in COLUMNS[dimension].iter().enumerate().take(digits as usize) {
                for lane in 0..LANES {
                    sums[lane] ^= column & (indices[lane] >> digit & 1).wrapping_neg();
                }
            }
            sums
        }
    }
}

/// Computes the second dimension, whose matrix is Pascal's triangle modulo 2: a product of five sparse ones.
#[inline(always)]
fn pascal(mut indices: [u32; LANES]) -> [u32; LANES] {
    const STEPS: [(u32, u32); 5] =
        [(1, 0xaaaa_aaaa), (2, 0xcccc_cccc), (4, 0xf0f0_f0f0), (8, 0xff00_ff00), (16, 0xffff_0000)];
    for (shift, mask) in STEPS {
        for lane in 0..LANES {
            indices[lane] ^= (indices[lane] & mask) >> shift;
        }
    }
    indices
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of `scipy.stats.qmc.Sobol(4, scramble=False, bits=32)` times 2^32. SciPy orders the points by
    /// Gray code: its row `n` is point `n ^ (n >> 1)`.
    #[test]
    fn points_match_scipy() {
        let rows: [(u32, [u32; DIMENSIONS]); 6] = [
            (0, [0; 4]),
            (1, [2_147_483_648; 4]),
            (2, [3_221_225_472, 1_073_741_824, 1_073_741_824, 1_073_741_824]),
            (5, [3_758_096_384, 3_758_096_384, 536_870_912, 1_610_612_736]),
            (19, [1_476_395_008, 3_087_007_744, 3_087_007_744, 1_744_830_464]),
            (1_000_003, [1_187_450_880, 2_413_424_640, 334_991_360, 1_796_354_048]),
        ];
        for (row, expected) in rows {
            let found = std::array::from_fn(|k| reversed(row ^ (row >> 1), k).reverse_bits());
            assert_eq!(found, expected, "row {row}");
        }
    }

    #[test]
    fn lanes_match_single_points() {
        let mut index = 1_u32;
        for digits in 1..=32 {
            index = index.wrapping_mul(0x2c1b_3c6d).wrapping_add(0x297a_2d39);
            let indices = std::array::from_fn(|lane| (index ^ ((lane as u32) << (digits / 2))) >> (32 - digits));
            for dimension in 0..DIMENSIONS {
                let expected = indices.map(|index| reversed(index, dimension));
                assert_eq!(reversed_lanes(indices, digits, dimension), expected, "{digits} digits, {dimension}");
            }
        }
    }
}
