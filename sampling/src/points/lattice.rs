//! Rank-1 lattices (Korobov 1959; Keller 2004, "Stratification by rank-1 lattices") of a known number of points, moved by a
//! random shift per pixel (Cranley and Patterson 1976), which makes each point uniform.
//!
//! Direction `j` of the `m` of sample `i` of `n` is point `b = i' + j n` of the lattice
//! `(b / (n m), g b / (n m)) mod 1`, where `i' = a i mod n`. So the directions of one sample are a lattice of `m` points,
//! those of all samples one of `n m`, and a sample's first number falls once into each interval of length `1 / m`.
//! Sample 0 is the same for all `n`: a renderer can time it before it chooses `n`.

use std::cell::Cell;

/// Number of purposes whose orders of samples are chosen together: camera, and the two techniques of a light estimate.
pub(super) const PURPOSES: usize = 3;
/// Largest number of generators, and of orders, that are compared.
const COMPARED: u64 = 512;
/// The golden ratio minus 1. Of all numbers, its multiples modulo 1 are the most even; it is where generators are looked for,
/// and the order of samples, so that the first of them are spread out as well.
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// The lattices of a number of samples.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattice {
    samples: u32,
    /// The orders of samples for each purpose: `a`.
    orders: [u32; PURPOSES],
}

impl Lattice {
    /// The lattices of a number of samples; 0 counts as 1.
    pub(super) fn new(samples: u32) -> Self {
        let samples = samples.max(1);
        let n = u64::from(samples);
        // The camera's two numbers, in units of its order; the first numbers of other purposes follow.
        let mut chosen = vec![1, generator(n, 1)];
        let mut orders = [1; PURPOSES];
        for order in &mut orders[1..] {
            let merit =
                |a: u64| chosen.iter().map(|&other| evenness(quotient(a, other, n), n)).fold(f64::INFINITY, f64::min);
            *order = best((1..n).step_by(n.div_ceil(COMPARED).max(1) as usize), merit);
            chosen.push(*order);
        }
        let common = best(near(n, GOLDEN), |a| evenness(a, n));
        Self { samples, orders: orders.map(|order| (order * common % n) as u32) }
    }

    /// Number of samples.
    pub(super) fn samples(&self) -> u32 {
        self.samples
    }

    /// Returns the first three numbers of direction `index` of `of` of a sample, before the shift, as fractions of 2^32.
    /// Purposes beyond [`PURPOSES`] have an order that depends on them alone.
    pub(super) fn numbers(&self, sample: u32, purpose: u32, (index, of): (u32, u32)) -> [u32; 3] {
        let (n, m) = (u64::from(self.samples), u64::from(of));
        let order = match self.orders.get(purpose as usize) {
            Some(&order) => u64::from(order),
            None => coprime_from(u64::from(purpose.wrapping_mul(0x9e37_79b9)) % n, n),
        };
        let own = order * u64::from(sample % self.samples) % n;
        let point = own + u64::from(index) * n;
        let third = coprime_from((n as f64 * GOLDEN * GOLDEN) as u64, n) * own % n;
        let product = (u128::from(generator(n, m)) * u128::from(point) % u128::from(n * m)) as u64;
        [(point, n * m), (product, n * m), (third, n)]
            .map(|(part, whole)| ((u128::from(part) << 32) / u128::from(whole)) as u32)
    }
}

/// Returns the generator `g` of the lattice of `n m` points: `g` modulo `m` is that of `m` points, for any `n`.
fn generator(n: u64, m: u64) -> u64 {
    thread_local! {
        /// The latest ones, as `n`, `m` and the generator.
        static KNOWN: Cell<[(u64, u64, u64); 4]> = const { Cell::new([(0, 0, 0); 4]) };
    }
    KNOWN.with(|known| {
        let mut latest = known.get();
        if let Some(&(.., found)) = latest.iter().find(|&&(samples, of, _)| (samples, of) == (n, m)) {
            return found;
        }
        let found = search(n, m);
        latest.rotate_right(1);
        latest[0] = (n, m, found);
        known.set(latest);
        found
    })
}

fn search(n: u64, m: u64) -> u64 {
    let own = best(near(m, GOLDEN), |g| evenness(g, m));
    let whole = n * m;
    // In steps of m, so that the directions of one sample stay those of `own`.
    best(near(n, GOLDEN).map(|t| own % m + m * t), |g| evenness(g, whole))
}

/// Returns up to [`COMPARED`] numbers below `n` around `fraction` of it.
fn near(n: u64, fraction: f64) -> impl Iterator<Item = u64> {
    let middle = (n as f64 * fraction) as u64;
    let first = middle.saturating_sub(COMPARED / 2).min(n.saturating_sub(COMPARED));
    first..(first + COMPARED).min(n).max(first + 1)
}

/// Returns the candidate of greatest merit, the first of equals.
fn best(candidates: impl Iterator<Item = u64>, merit: impl Fn(u64) -> f64) -> u64 {
    let mut best = (1, f64::NEG_INFINITY);
    for candidate in candidates {
        let own = merit(candidate);
        if own > best.1 {
            best = (candidate, own);
        }
    }
    best.0
}

/// Zaremba's figure of merit (1966) of the lattice `(b / n, g b / n)`, which bounds its discrepancy: the least
/// `q |q g / n - p|` over convergents `p / q`; 0 unless `g` and `n` are coprime.
fn evenness(g: u64, n: u64) -> f64 {
    let (mut high, mut low) = (n, g % n.max(1));
    // Denominators of the convergents of g / n.
    let (mut before, mut denominator) = (0_u64, 1_u64);
    let mut least = f64::INFINITY;
    while low > 0 {
        // The remainders of Euclid's algorithm are the distances n |q g / n - p|.
        least = least.min(denominator as f64 * low as f64 / n as f64);
        let quotient = high / low;
        (high, low) = (low, high % low);
        (before, denominator) = (denominator, quotient * denominator + before);
    }
    if high == 1 { least.min(1.0) } else { 0.0 }
}

/// Returns `a / b` modulo `n`; 0 if there is none.
fn quotient(a: u64, b: u64, n: u64) -> u64 {
    // Extended Euclid for the inverse of b.
    let (mut old, mut rest) = (i128::from(n), i128::from(b % n.max(1)));
    let (mut x_old, mut x) = (0_i128, 1_i128);
    while rest > 0 {
        let steps = old / rest;
        (old, rest) = (rest, old - steps * rest);
        (x_old, x) = (x, x_old - steps * x);
    }
    if old == 1 { (i128::from(a) * x_old).rem_euclid(i128::from(n)) as u64 } else { 0 }
}

/// Returns the first number from `from` on that is coprime to `n`.
fn coprime_from(from: u64, n: u64) -> u64 {
    (from.max(1)..).find(|&number| is_coprime(number, n)).unwrap_or(1)
}

fn is_coprime(mut a: u64, mut b: u64) -> bool {
    while b > 0 {
        (a, b) = (b, a % b);
    }
    a == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_of_all_samples_are_a_lattice_and_those_of_one_are_stratified() {
        for (n, m) in [(1, 1), (1, 4), (9, 1), (16, 4), (22, 4), (22, 6), (13, 64)] {
            let lattice = Lattice::new(n);
            for purpose in [0, 1, 2, 7, 70_000] {
                let numbers = |k: u32| lattice.numbers(k / m, purpose, (k % m, m));
                // Number `k` of `count` equal parts of 1, which fractions of 2^32 are rounded down from.
                let part = |number: u32, count: u32| (((u64::from(number) + 1) * u64::from(count)) >> 32) as u32;
                for dimension in 0..2 {
                    let mut all: Vec<u32> = (0..n * m).map(|k| part(numbers(k)[dimension], n * m)).collect();
                    all.sort_unstable();
                    assert_eq!(all, (0..n * m).collect::<Vec<_>>(), "{n} x {m}, purpose {purpose}");
                    for sample in 0..n {
                        let mut own: Vec<u32> = (0..m).map(|k| numbers(sample * m + k)[dimension]).collect();
                        own.sort_unstable();
                        let steps = own.windows(2).map(|pair| f64::from(pair[1] - pair[0]) * f64::from(m));
                        assert!(steps.into_iter().all(|step| (step / 4_294_967_296.0 - 1.0).abs() < 1e-6), "{n} x {m}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_first_sample_is_the_same_for_any_number_of_samples() {
        for m in [1, 2, 4, 6, 8, 64] {
            for index in 0..m {
                let first = |n| Lattice::new(n).numbers(0, 1, (index, m));
                for n in [2, 7, 22, 64, 1000] {
                    assert_eq!(first(n), first(1), "{n}, {index} of {m}");
                }
            }
        }
    }

    #[test]
    fn later_samples_and_large_numbers_repeat_or_round_without_overflow() {
        let lattice = Lattice::new(22);
        assert_eq!(lattice.numbers(23, 1, (1, 4)), lattice.numbers(1, 1, (1, 4)));
        Lattice::new(u32::MAX).numbers(u32::MAX - 1, 1, (4095, 4096));
    }

    #[test]
    fn evenness_is_the_least_product_over_all_multiples() {
        for n in 2_u64..150 {
            for g in (1..n).filter(|&g| is_coprime(g, n)) {
                let product = |q: u64| (q * (q * g % n).min(n - q * g % n)) as f64 / n as f64;
                let expected = (1..n).map(product).fold(f64::INFINITY, f64::min);
                assert!((evenness(g, n) - expected).abs() < 1e-12, "{g} of {n}");
            }
        }
        assert_eq!((evenness(4, 6), quotient(1, 3, 7), quotient(5, 3, 7), quotient(1, 3, 6)), (0.0, 5, 4, 0));
    }
}
