//! The points of the unit square (and cube) that a rendering consumes, fixed for each pixel, sample and
//! dimension.
//!
//! A number is a function of (points, seed, pixel, sample, dimension), so that results do not depend on
//! threads, tiles or passes.
//!
//! | file | concept |
//! | --- | --- |
//! | `mod.rs` | the map of dimensions |
//! | `set.rs` | the kinds of points |
//! | `sobol.rs`, `owen.rs` | Sobol's sequence, Owen scrambling |
//! | `lattice.rs` | rank-1 lattices of a known number of samples |
//! | `philox.rs` | independent numbers, and the seeds of all others |

mod lattice;
mod owen;
mod philox;
mod set;
mod sobol;

pub use set::PointSet;

use crate::{
    columns::vectorized,
    simd::{LANES, Lanes},
    tile::Rows,
};
use lattice::Lattice;
use philox::philox;

/// The purpose of a group of up to four numbers: the map of all dimensions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dimension {
    /// Direction `k` of a light estimate: 0, and 1 for two-sample MIS.
    Light(u32),
    /// The direction of a candidate of RIS, with one sequence per technique. The third number of the first
    /// candidate draws the survivor.
    Candidate {
        /// The technique, 0 or 1.
        technique: u32,
        /// Index among the technique's candidates.
        index: u32,
        /// Number of the technique's candidates.
        of: u32,
    },
    /// The position in the pixel that a camera ray goes through.
    Camera,
    /// The direction in which a path continues, and a third number for Russian roulette.
    Path,
}

/// Largest number of candidates of a technique.
pub const MAX_CANDIDATES: u32 = 4096;

/// Number of sequences per bounce of a path.
const PER_BOUNCE: u32 = 1 << 16;

/// The first sequence of a bounce, which is used without a shuffle: light and camera are stratified together.
const PRIMARY: u32 = 0;

/// The source of the numbers of a group.
#[derive(Clone, Copy, Debug)]
struct Address {
    /// The sequence, which has its own scrambling.
    sequence: u32,
    /// The first of its dimensions.
    column: usize,
    /// The point: number `index` of the `of` that each sample takes from the sequence.
    index: u32,
    of: u32,
}

impl Dimension {
    /// The direction of draw `index` of `of` from a technique, 0 or 1.
    pub fn of_several(technique: u32, index: u32, of: u32) -> Self {
        if of == 1 { Self::Light(technique) } else { Self::Candidate { technique, index, of } }
    }

    fn address(self, bounce: u32) -> Address {
        if let Self::Candidate { index, of, .. } = self {
            assert!(index < of && of <= MAX_CANDIDATES, "candidate {index} of {of}");
        }
        let (sequence, column) = match self {
            Self::Light(0) => (PRIMARY, 0),
            // Camera rays lead to the first surface only.
            Self::Camera => (PRIMARY, 2),
            Self::Path => (1, 0),
            Self::Candidate { technique, .. } => (2 + technique, 0),
            Self::Light(direction) => (4 + direction, 0),
        };
        let (index, of) = if let Self::Candidate { index, of, .. } = self { (index, of) } else { (0, 1) };
        Address { sequence: bounce * PER_BOUNCE + sequence, column, index, of }
    }
}

/// What all pixels share of a group of numbers. A pixel of key `k` takes the words that Philox4x32-7 gives for the
/// counter `[k, counter]` under the seed, from `first_word` on and cyclically. Each is added to its number, or is the
/// seed that scrambles it; the upper 24 bits of the result are a fraction of 2^24.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommonNumbers {
    /// Numbers before the shift, as fractions of 2^32, or before they are scrambled.
    pub numbers: [u32; 4],
    /// The rest of the counter.
    pub counter: [u32; 3],
    /// The first number's word, 0 or 2.
    pub first_word: usize,
    /// Whether numbers are scrambled: see `owen.rs`.
    pub are_scrambled: bool,
}

/// The numbers of one sample of each pixel, at one bounce of its path.
#[derive(Clone, Copy, Debug)]
pub struct Points {
    set: PointSet,
    seed: u64,
    sample: u32,
    bounce: u32,
    lattice: Lattice,
}

impl Points {
    /// The numbers of the first sample of every pixel, at the first surface. Different seeds give independent
    /// numbers.
    pub fn new(set: PointSet, seed: u64) -> Self {
        let samples = if let PointSet::Lattice { samples } = set { samples } else { 1 };
        Self { set, seed, sample: 0, bounce: 0, lattice: Lattice::new(samples) }
    }

    /// The kind of points.
    pub fn set(&self) -> PointSet {
        self.set
    }

    /// Returns the points for a rendering of a number of samples, unless they name another one.
    #[must_use]
    pub fn planned(self, samples: u32) -> Self {
        if self.set == PointSet::LATTICE { Self::new(PointSet::Lattice { samples }, self.seed) } else { self }
    }

    /// The seed.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Returns the numbers for another sample of every pixel.
    #[must_use]
    pub fn at_sample(self, sample: u32) -> Self {
        Self { sample, ..self }
    }

    /// Returns the numbers of the same sample at a later surface of its path; the first is 0.
    #[must_use]
    pub fn at_bounce(self, bounce: u32) -> Self {
        Self { bounce, ..self }
    }

    /// Draws `N` uniform numbers in `[0, 1)` for each row, keyed by the rows' keys: at most 4 for light, 2
    /// for cameras. Keys are places of pixels on Morton's curve.
    ///
    /// # Panics
    /// If a candidate's `index` is not below `of`, or `of` exceeds [`MAX_CANDIDATES`].
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
            // Lanes without a row have an arbitrary key.
            *bits = f32::from_bits(if place < count { key(place) } else { 0 });
        }
        let mut columns = out.into_iter();
        let columns = std::array::from_fn(|_| columns.next());
        of_keys(self.common(dimension), self.seed, columns);
    }

    /// Returns what all pixels share of a group, for renderers on other devices.
    pub fn common(&self, dimension: Dimension) -> CommonNumbers {
        let address = dimension.address(self.bounce);
        match self.set {
            PointSet::Independent => {
                let counter = [self.sample, address.sequence, address.index];
                CommonNumbers { numbers: [0; 4], counter, first_word: address.column, are_scrambled: false }
            }
            PointSet::Sobol => self.common_of_sobol(address),
            PointSet::Lattice { .. } => self.common_of_lattice(address),
        }
    }

    fn common_of_sobol(&self, Address { sequence, column, index, of }: Address) -> CommonNumbers {
        // After 2^32 points of a sequence, another scrambling begins.
        let point = u64::from(self.sample) * u64::from(of) + u64::from(index);
        let (round, mut point) = ((point >> 32) as u32, point as u32);
        if sequence != PRIMARY {
            point = owen::shuffle(point, self.order(sequence, round, SOBOL));
        }
        let number = |place| owen::before_seed(sobol::reversed(point, (column + place) % sobol::DIMENSIONS));
        let counter = [round, sequence, SOBOL];
        CommonNumbers { numbers: std::array::from_fn(number), counter, first_word: column, are_scrambled: true }
    }

    /// Returns numbers of the lattices of a number of samples; later samples come from the same lattices with other
    /// shifts.
    fn common_of_lattice(&self, Address { sequence, column, index, of }: Address) -> CommonNumbers {
        let round = self.sample / self.lattice.samples();
        let purpose = match (sequence, column) {
            (PRIMARY, 2) => 0,
            // Directions of a technique, of which each sample takes one or several.
            (PRIMARY | 2, _) => 1,
            (3 | 5, _) => 2,
            (other, _) => other + lattice::PURPOSES as u32,
        };
        let [first, second, third] = self.lattice.numbers(self.sample, purpose, (index, of));
        let counter = [round, sequence, LATTICE | column as u32];
        CommonNumbers { numbers: [first, second, third, 0], counter, first_word: 0, are_scrambled: false }
    }

    /// Returns a random number for a sequence as a whole.
    fn order(&self, sequence: u32, round: u32, kind: u32) -> u32 {
        philox([[round], [sequence], [0], [kind | ORDER]], self.seed)[0][0]
    }
}

/// Up to four columns to be filled.
type Columns<'a> = [Option<&'a mut [Lanes]>; 4];

// The purpose of words, in the last part of their counter; independent numbers have their candidate there,
// which is below 2^29.
const SOBOL: u32 = 1 << 31;
const LATTICE: u32 = 1 << 30;
const ORDER: u32 = 1 << 29;

vectorized! {
    /// Computes the numbers of each key. The keys are the bits of the first column, which is overwritten.
    fn of_keys['a](_simd, common: CommonNumbers, seed: u64, columns: Columns<'a>) {
        let CommonNumbers { numbers, counter: [second, third, fourth], first_word, are_scrambled } = common;
        let mut columns = columns;
        for strip in 0..columns[0].as_ref().map_or(0, |column| column.len()) {
            let keys = columns[0].as_ref().map_or([0; LANES], |column| column[strip].map(f32::to_bits));
            let words = philox([keys, [second; LANES], [third; LANES], [fourth; LANES]], seed);
            for (place, (column, number)) in columns.iter_mut().flatten().zip(numbers).enumerate() {
                let mut word = words[(first_word + place) & 3];
                if are_scrambled {
                    column[strip] = owen::scramble([number; LANES], word);
                    continue;
                }
                for lane in 0..LANES {
                    word[lane] = word[lane].wrapping_add(number);
                }
                column[strip] = owen::unit(word);
            }
        }
    }
}

#[cfg(test)]
mod tests;
