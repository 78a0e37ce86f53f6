//! Eight numbers side by side: one AVX2 register, or a plain array where there is none.
//!
//! Both forms round alike, so that hits are the same on every processor.

use super::tree::WIDTH;

/// One number per child or triangle.
pub type Lanes = [f32; WIDTH];

/// Operations on eight numbers.
pub trait Eight: Copy {
    /// Eight numbers.
    type Floats: Copy;

    /// The lanes from which numbers are picked.
    type Places: Copy;

    /// Loads numbers from their bits.
    fn load(self, bits: &[u32; WIDTH]) -> Self::Floats;

    /// The bits of the numbers.
    fn store(self, a: Self::Floats) -> [u32; WIDTH];

    /// `a` in all lanes.
    fn splat(self, a: f32) -> Self::Floats;

    /// `a` with the bits of a number set in each lane.
    fn tag(self, a: Self::Floats, number: u32) -> Self::Floats;

    /// `a - b`.
    fn sub(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;

    /// `a + b`.
    fn add(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;

    /// `a * b`.
    fn mul(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;

    /// `a / b`.
    fn div(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;

    /// The smaller of each two; `b` where either is NaN.
    fn min(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;

    /// The greater of each two; `b` where either is NaN.
    fn max(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;

    /// `a` with the signs of `b`; `a` is not negative.
    fn with_signs(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;

    /// `a` without its signs.
    fn abs(self, a: Self::Floats) -> Self::Floats;

    /// The conjunction of two comparisons.
    fn both(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;

    /// `a` where a comparison holds, else `b`.
    fn select(self, comparison: Self::Floats, a: Self::Floats, b: Self::Floats) -> Self::Floats;

    /// Ones in the sign of each lane where `a <= b`, zero elsewhere.
    fn at_most(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;

    /// The signs of the lanes as bits.
    fn signs(self, a: Self::Floats) -> u32;

    /// Unpacks a list of lanes, three bits each, from the lowest bits up.
    fn places(self, list: u32) -> Self::Places;

    /// The lanes of a set, in order, moved to the front.
    fn packed(self, set: u32) -> Self::Places;

    /// The numbers at `places`.
    fn pick(self, a: Self::Floats, places: Self::Places) -> Self::Floats;

    /// The entries of `of` at `places`.
    fn pick_places(self, of: Self::Places, places: Self::Places) -> Self::Places;
}

/// The portable form.
#[derive(Clone, Copy, Debug)]
pub struct Plain;

/// Applies a function to each lane.
#[inline(always)]
fn each(a: Lanes, b: Lanes, function: impl Fn(f32, f32) -> f32) -> Lanes {
    let mut result = [0.0; WIDTH];
    for k in 0..WIDTH {
        result[k] = function(a[k], b[k]);
    }
    result
}

impl Eight for Plain {
    type Floats = Lanes;
    type Places = [u8; WIDTH];

    #[inline(always)]
    fn load(self, bits: &[u32; WIDTH]) -> Lanes {
        bits.map(f32::from_bits)
    }

    #[inline(always)]
    fn store(self, a: Lanes) -> [u32; WIDTH] {
        a.map(f32::to_bits)
    }

    #[inline(always)]
    fn splat(self, a: f32) -> Lanes {
        [a; WIDTH]
    }

    #[inline(always)]
    fn tag(self, a: Lanes, number: u32) -> Lanes {
        a.map(|a| f32::from_bits(a.to_bits() | number))
    }

    #[inline(always)]
    fn sub(self, a: Lanes, b: Lanes) -> Lanes {
        each(a, b, |a, b| a - b)
    }

    #[inline(always)]
    fn add(self, a: Lanes, b: Lanes) -> Lanes {
        each(a, b, |a, b| a + b)
    }

    #[inline(always)]
    fn mul(self, a: Lanes, b: Lanes) -> Lanes {
        each(a, b, |a, b| a * b)
    }

    #[inline(always)]
    fn div(self, a: Lanes, b: Lanes) -> Lanes {
        each(a, b, |a, b| a / b)
    }

    #[inline(always)]
    fn min(self, a: Lanes, b: Lanes) -> Lanes {
        each(a, b, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    fn max(self, a: Lanes, b: Lanes) -> Lanes {
        each(a, b, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    fn with_signs(self, a: Lanes, b: Lanes) -> Lanes {
        each(a, b, f32::copysign)
    }

    #[inline(always)]
    fn abs(self, a: Lanes) -> Lanes {
        a.map(f32::abs)
    }

    #[inline(always)]
    fn both(self, a: Lanes, b: Lanes) -> Lanes {
        each(a, b, |a, b| f32::from_bits(a.to_bits() & b.to_bits()))
    }

    #[inline(always)]
    fn select(self, comparison: Lanes, a: Lanes, b: Lanes) -> Lanes {
        std::array::from_fn(|k| if comparison[k].is_sign_negative() { a[k] } else { b[k] })
    }

    #[inline(always)]
    fn at_most(self, a: Lanes, b: Lanes) -> Lanes {
        each(a, b, |a, b| if a <= b { -1.0 } else { 0.0 })
    }

    #[inline(always)]
    fn signs(self, a: Lanes) -> u32 {
        let mut bits = 0;
        for (k, a) in a.iter().enumerate() {
            bits |= (a.to_bits() >> 31) << k;
        }
        bits
    }

    #[inline(always)]
    fn places(self, list: u32) -> [u8; WIDTH] {
        std::array::from_fn(|k| (list >> (3 * k) & 7) as u8)
    }

    #[inline(always)]
    fn packed(self, set: u32) -> [u8; WIDTH] {
        packed(set).to_le_bytes()
    }

    #[inline(always)]
    fn pick(self, a: Lanes, places: [u8; WIDTH]) -> Lanes {
        places.map(|place| a[place as usize % WIDTH])
    }

    #[inline(always)]
    fn pick_places(self, of: [u8; WIDTH], places: [u8; WIDTH]) -> [u8; WIDTH] {
        places.map(|place| of[place as usize % WIDTH])
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::{__m128i, __m256, __m256i, _CMP_LE_OQ};

    use pulp::{cast, x86::V3};

    use crate::scene::wide::{
        lanes::{Eight, packed},
        tree::WIDTH,
    };

    impl Eight for V3 {
        type Floats = __m256;
        type Places = __m256i;

        #[inline(always)]
        fn load(self, bits: &[u32; WIDTH]) -> __m256 {
            cast(*bits)
        }

        #[inline(always)]
        fn store(self, a: __m256) -> [u32; WIDTH] {
            cast(a)
        }

        #[inline(always)]
        fn splat(self, a: f32) -> __m256 {
            self.avx._mm256_set1_ps(a)
        }

        #[inline(always)]
        fn tag(self, a: __m256, number: u32) -> __m256 {
            self.avx._mm256_or_ps(a, self.splat(f32::from_bits(number)))
        }

        #[inline(always)]
        fn sub(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_sub_ps(a, b)
        }

        #[inline(always)]
        fn add(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_add_ps(a, b)
        }

        #[inline(always)]
        fn mul(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_mul_ps(a, b)
        }

        #[inline(always)]
        fn div(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_div_ps(a, b)
        }

        #[inline(always)]
        fn min(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_min_ps(a, b)
        }

        #[inline(always)]
        fn max(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_max_ps(a, b)
        }

        #[inline(always)]
        fn with_signs(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_or_ps(a, self.avx._mm256_and_ps(b, self.splat(-0.0)))
        }

        #[inline(always)]
        fn abs(self, a: __m256) -> __m256 {
            self.avx._mm256_andnot_ps(self.splat(-0.0), a)
        }

        #[inline(always)]
        fn both(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_and_ps(a, b)
        }

        #[inline(always)]
        fn select(self, comparison: __m256, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_blendv_ps(b, a, comparison)
        }

        #[inline(always)]
        fn at_most(self, a: __m256, b: __m256) -> __m256 {
            self.avx._mm256_cmp_ps::<_CMP_LE_OQ>(a, b)
        }

        #[inline(always)]
        fn signs(self, a: __m256) -> u32 {
            self.avx._mm256_movemask_ps(a) as u32
        }

        #[inline(always)]
        fn places(self, list: u32) -> __m256i {
            // The permutation reads three bits of each place.
            let shifts: __m256i = cast([0_u32, 3, 6, 9, 12, 15, 18, 21]);
            self.avx2._mm256_srlv_epi32(self.avx._mm256_set1_epi32(list as i32), shifts)
        }

        #[inline(always)]
        fn packed(self, set: u32) -> __m256i {
            let places: __m128i = cast([packed(set), 0]);
            self.avx2._mm256_cvtepu8_epi32(places)
        }

        #[inline(always)]
        fn pick(self, a: __m256, places: __m256i) -> __m256 {
            self.avx2._mm256_permutevar8x32_ps(a, places)
        }

        #[inline(always)]
        fn pick_places(self, of: __m256i, places: __m256i) -> __m256i {
            self.avx2._mm256_permutevar8x32_epi32(of, places)
        }
    }
}

/// For each set of lanes, its lanes in order, one per byte.
static PACKED: [u64; 1 << WIDTH] = {
    let mut table = [0; 1 << WIDTH];
    let mut set = 0;
    while set < 1 << WIDTH {
        let (mut lane, mut count) = (0, 0);
        while lane < WIDTH {
            if set >> lane & 1 == 1 {
                table[set] |= (lane as u64) << (8 * count);
                count += 1;
            }
            lane += 1;
        }
        set += 1;
    }
    table
};

/// Returns the lanes of a set in order, one per byte; the remaining bytes are zero.
#[inline(always)]
fn packed(set: u32) -> u64 {
    PACKED[set as usize % (1 << WIDTH)]
}
