//! Owen scrambling (1995): random permutations of binary digits, each chosen by the digits before it. It
//! keeps every digital net a net and makes each point uniform.
//!
//! The permutations are a hash (Laine and Karras 2011, "Stratified Sampling for Stochastic Transparency";
//! Burley 2020, "Practical Hash-Based Owen Scrambling"): only the digits before a digit may change it, which
//! holds for addition and for multiplication by odd numbers, from bit 0 upwards. Numbers are therefore
//! reversed, with the first digit in bit 0. The constants are those of Vegdahl (2021, "Building a Better LK
//! Hash").

use crate::simd::{LANES, Lanes};

/// Computes the part of the hash before the seed: the same for all lanes if the number is.
#[inline(always)]
pub(super) fn before_seed(reversed: u32) -> u32 {
    reversed ^ reversed.wrapping_mul(0x3d20_adea)
}

/// Computes the rest of the hash.
#[inline(always)]
pub(super) fn with_seed(x: u32, seed: u32) -> u32 {
    let x = x.wrapping_add(seed).wrapping_mul((seed >> 16) | 1);
    let x = x ^ x.wrapping_mul(0x0552_6c56);
    x ^ x.wrapping_mul(0x53a2_2864)
}

/// Permutes the binary digits of an index from the first on: any `2^m` indices from a multiple of `2^m` on
/// stay such a block.
#[inline(always)]
pub(super) fn shuffle(index: u32, seed: u32) -> u32 {
    with_seed(before_seed(index.reverse_bits()), seed).reverse_bits()
}

/// Scrambles numbers by a seed for each lane, from [`before_seed`] to uniform numbers of 24 bits in `[0, 1)`.
#[inline(always)]
pub(super) fn scramble(before_seed: [u32; LANES], seeds: [u32; LANES]) -> Lanes {
    let mut bits = [0; LANES];
    for lane in 0..LANES {
        bits[lane] = with_seed(before_seed[lane], seeds[lane]).reverse_bits();
    }
    unit(bits)
}

/// Converts the first 24 binary digits to a number in `[0, 1)`.
#[inline(always)]
pub(super) fn unit(bits: [u32; LANES]) -> Lanes {
    let mut out = [0.0; LANES];
    for lane in 0..LANES {
        // Signed, as there is no SIMD conversion from unsigned integers; 24 bits are positive.
        out[lane] = (bits[lane] >> 8) as i32 as f32 * (1.0 / 16_777_216.0);
    }
    out
}
