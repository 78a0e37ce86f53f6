//! Sobol's sequence (1967) with the direction numbers of Joe and Kuo (2008, "Constructing Sobol sequences with better two-dimensional
//! projections").
//!
//! Numbers are stored with their bits reversed, the first binary digit in bit 0, as [`super::owen`] requires.

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
}
