//! The points of the unit square (and cube) that a rendering consumes: for a pixel, a sample and a dimension always the same.
//!
//! A number is a function of (seed, pixel, sample, dimension), so that results depend neither on threads nor on tiles nor on passes.

use crate::{
    columns::vectorized,
    simd::{LANES, Lanes},
    tile::Rows,
};

/// What a group of up to four numbers is drawn for: the map of all dimensions. Estimators that draw several directions number them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dimension {
    /// The direction of a light estimate; of two-sample MIS and of RIS, direction (candidate) `k`, with a third number by which a
    /// candidate survives.
    Light(u32),
    /// The place in the pixel that a camera ray goes through.
    Camera,
    /// The direction in which a path goes on, and a third number for Russian roulette.
    Path,
}

/// Groups of numbers for one bounce of a path.
const PER_BOUNCE: u32 = 1 << 16;

impl Dimension {
    /// The number of the group at a bounce.
    fn index(self, bounce: u32) -> u32 {
        bounce * PER_BOUNCE
            + match self {
                Self::Light(index) => 2 + index,
                Self::Camera => 0,
                Self::Path => 1,
            }
    }
}

/// The numbers of one sample of each pixel, at one bounce of its path.
#[derive(Clone, Copy, Debug)]
pub struct Points {
    seed: u64,
    sample: u32,
    bounce: u32,
}

impl Points {
    /// The numbers of sample `sample` of every pixel, at the first surface.
    pub fn new(seed: u64, sample: u32) -> Self {
        Self { seed, sample, bounce: 0 }
    }

    /// The same sample at a later surface of its path; the first is 0.
    #[must_use]
    pub fn at_bounce(self, bounce: u32) -> Self {
        Self { bounce, ..self }
    }

    /// `N` (at most 4) uniform numbers in `[0, 1)` for each row, keyed by the rows' keys.
    pub fn draw<const N: usize>(&self, dimension: Dimension, rows: &Rows<'_>, out: [&mut [Lanes]; N]) {
        self.draw_keyed(dimension, rows.len(), |place| rows.key(place), out);
    }

    /// [`Self::draw`] for `count` keys.
    pub fn draw_keyed<const N: usize>(
        &self,
        dimension: Dimension,
        count: usize,
        key: impl Fn(usize) -> u32,
        out: [&mut [Lanes]; N],
    ) {
        const { assert!(0 < N && N <= 4) };
        for (place, bits) in out[0].as_flattened_mut().iter_mut().enumerate() {
            // Lanes without a row have any key.
            *bits = f32::from_bits(if place < count { key(place) } else { 0 });
        }
        let mut columns = out.into_iter();
        let columns = std::array::from_fn(|_| columns.next());
        philox([self.sample, dimension.index(self.bounce)], self.seed, columns);
    }
}

/// Rounds of the generator: seven pass all tests of the authors (Salmon et al. 2011, table 2).
const ROUNDS: usize = 7;

vectorized! {
    /// Philox4x32 (Salmon et al. 2011, "Parallel Random Numbers: As Easy as 1, 2, 3"): four uniform numbers of 24 bits in `[0, 1)` for each
    /// key, for the counter `[key, others[0], others[1], 0]`.
    /// The keys are the bits of the first column, which is overwritten.
    fn philox['a](_simd, others: [u32; 2], seed: u64, columns: [Option<&'a mut [Lanes]>; 4]) {
        let mut columns = columns;
        for strip in 0..columns[0].as_ref().map_or(0, |column| column.len()) {
            let keys = columns[0].as_ref().map_or([0; LANES], |column| column[strip].map(f32::to_bits));
            let counter = philox_rounds([keys, [others[0]; LANES], [others[1]; LANES], [0; LANES]], seed);
            for (column, bits) in columns.iter_mut().flatten().zip(&counter) {
                for lane in 0..LANES {
                    // Signed, as there is no SIMD conversion from unsigned integers; 24 bits are positive.
                    column[strip][lane] = (bits[lane] >> 8) as i32 as f32 * (1.0 / 16_777_216.0);
                }
            }
        }
    }
}

#[inline(always)]
fn philox_rounds(mut counter: [[u32; LANES]; 4], seed: u64) -> [[u32; LANES]; 4] {
    let (mut low, mut high) = (seed as u32, (seed >> 32) as u32);
    for _ in 0..ROUNDS {
        let mut next = [[0; LANES]; 4];
        for lane in 0..LANES {
            let first = 0xd251_1f53_u64 * u64::from(counter[0][lane]);
            let second = 0xcd9e_8d57_u64 * u64::from(counter[2][lane]);
            next[0][lane] = (second >> 32) as u32 ^ counter[1][lane] ^ low;
            next[1][lane] = second as u32;
            next[2][lane] = (first >> 32) as u32 ^ counter[3][lane] ^ high;
            next[3][lane] = first as u32;
        }
        counter = next;
        low = low.wrapping_add(0x9e37_79b9);
        high = high.wrapping_add(0xbb67_ae85);
    }
    counter
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(seed: u64, key: u32, sample: u32, dimension: Dimension, bounce: u32) -> [f32; 4] {
        let mut out = [[[0.0; LANES]; 1]; 4];
        let [a, b, c, d] = &mut out;
        Points::new(seed, sample).at_bounce(bounce).draw_keyed(dimension, 1, |_| key, [a, b, c, d]);
        out.map(|column| column[0][0])
    }

    /// The known answers of the authors' library for Philox4x32-7.
    #[test]
    fn numbers_are_those_of_the_published_generator() {
        let words = philox_rounds([[0; LANES]; 4], 0).map(|lanes| lanes[0]);
        assert_eq!(words, [0x5f6f_b709, 0x0d89_3f64, 0x4f12_1f81, 0x4f73_0a48]);
    }

    #[test]
    fn every_part_of_the_address_counts() {
        let all = [
            numbers(1, 0, 0, Dimension::Camera, 0),
            numbers(2, 0, 0, Dimension::Camera, 0),
            numbers(1 << 40, 0, 0, Dimension::Camera, 0),
            numbers(1, 1, 0, Dimension::Camera, 0),
            numbers(1, 0, 1, Dimension::Camera, 0),
            numbers(1, 0, 0, Dimension::Path, 0),
            numbers(1, 0, 0, Dimension::Light(0), 0),
            numbers(1, 0, 0, Dimension::Light(1), 0),
            numbers(1, 0, 0, Dimension::Camera, 1),
        ];
        for (k, a) in all.iter().enumerate() {
            assert!(all[..k].iter().all(|b| a.iter().zip(b).all(|(a, b)| a != b)));
        }
    }

    #[test]
    fn numbers_are_uniform_and_their_pairs_too() {
        const SIDE: usize = 16;
        let mut counts = [[0.0_f64; SIDE * SIDE]; 3];
        let samples = 200_000;
        for k in 0..samples {
            let n = numbers(7, k % 1000, k / 1000, Dimension::Light(0), 0);
            assert!(n.iter().all(|x| (0.0..1.0).contains(x)));
            for (pair, counts) in counts.iter_mut().enumerate() {
                let [i, j] = [n[pair], n[pair + 1]].map(|x| (x * SIDE as f32) as usize);
                counts[i * SIDE + j] += 1.0;
            }
        }
        let expected = f64::from(samples) / (SIDE * SIDE) as f64;
        for counts in counts {
            let statistic: f64 = counts.iter().map(|count| (count - expected).powi(2) / expected).sum();
            // 255 degrees of freedom: mean 255, standard deviation 22.6; five of them, for three tests.
            assert!((statistic - 255.0).abs() < 113.0, "{statistic}");
        }
    }
}
