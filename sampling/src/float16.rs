//! Half-precision numbers (IEEE 754 binary16), the texels of neural materials.

/// Bits of the unit of subnormal halves, 2^-24, as a float.
const UNIT: u32 = 0x3380_0000;
/// Bits of the smallest normal half, 2^-14, as a float.
const LEAST_NORMAL: u32 = 0x3880_0000;
/// Difference of the biases of both exponents.
const BIAS: u32 = 127 - 15;
const INFINITY: u32 = 0x7c00;

/// Rounds to the bits of the nearest half, ties to even; to infinity from 65520 on.
pub fn encode(value: f32) -> u16 {
    let magnitude = value.abs().to_bits();
    let sign = (value.to_bits() >> 16) as u16 & 0x8000;
    let rounded = if value.is_nan() {
        INFINITY | 0x200
    } else if magnitude < LEAST_NORMAL {
        // The unit of 0.5 as a float is that of subnormal halves, so that the sum rounds to it.
        (value.abs() + 0.5).to_bits() - 0.5_f32.to_bits()
    } else {
        let odd = magnitude >> 13 & 1;
        (((magnitude + 0xfff + odd) >> 13) - (BIAS << 10)).min(INFINITY)
    };
    sign | rounded as u16
}

/// Returns the number of which `bits` are the bits.
pub fn decode(bits: u16) -> f32 {
    let magnitude = u32::from(bits & 0x7fff);
    let value = match magnitude {
        0..0x400 => magnitude as f32 * f32::from_bits(UNIT),
        0x400..INFINITY => f32::from_bits((magnitude << 13) + (BIAS << 23)),
        _ => f32::from_bits((magnitude << 13) | f32::INFINITY.to_bits()),
    };
    if bits & 0x8000 == 0 { value } else { -value }
}

#[cfg(test)]
mod tests {
    use half::f16;

    use super::*;

    #[test]
    fn all_halves_decode_as_by_the_crate_half() {
        for bits in 0..=u16::MAX {
            let (own, expected) = (decode(bits), f16::from_bits(bits).to_f32());
            assert!(own.to_bits() == expected.to_bits() || own.is_nan() && expected.is_nan(), "{bits:#x}");
            assert!(encode(own) == bits || own.is_nan(), "{bits:#x}");
        }
    }

    #[test]
    fn floats_round_as_by_the_crate_half() {
        // Halves, the middles between them, and their neighbours; then other exponents.
        let middles = (0..=u16::MAX).map(decode).flat_map(|half| (-3..=3).map(move |k| (half, k << 11)));
        let near =
            middles.flat_map(|(half, offset)| (-1..=1).map(move |k| half.to_bits().wrapping_add_signed(offset + k)));
        let others = (0..1_u32 << 20).map(|k| k.wrapping_mul(0x9e37_79b1));
        for bits in near.chain(others) {
            let value = f32::from_bits(bits);
            assert!(encode(value) == f16::from_f32(value).to_bits() || value.is_nan(), "{bits:#x}");
        }
        assert!(decode(encode(f32::NAN)).is_nan());
    }
}
