//! The Morton curve through the cells of a square: interleaved bits of both coordinates.

/// Spreads the 16 low bits, with a zero above each.
#[inline(always)]
pub fn spread(bits: u32) -> u32 {
    let bits = (bits | (bits << 8)) & 0x00ff_00ff;
    let bits = (bits | (bits << 4)) & 0x0f0f_0f0f;
    let bits = (bits | (bits << 2)) & 0x3333_3333;
    (bits | (bits << 1)) & 0x5555_5555
}

/// Gathers every other bit, from the lowest on: the inverse of [`spread`].
#[inline(always)]
pub fn gather(bits: u32) -> u32 {
    let bits = bits & 0x5555_5555;
    let bits = (bits | (bits >> 1)) & 0x3333_3333;
    let bits = (bits | (bits >> 2)) & 0x0f0f_0f0f;
    let bits = (bits | (bits >> 4)) & 0x00ff_00ff;
    (bits | (bits >> 8)) & 0x0000_ffff
}

/// The index of a cell on the curve.
#[inline(always)]
pub fn morton(x: u16, y: u16) -> u32 {
    spread(u32::from(x)) | spread(u32::from(y)) << 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_interleave_the_bits_of_both_coordinates() {
        assert_eq!(morton(0b101, 0b011), 0b01_10_11);
        assert_eq!((morton(u16::MAX, 0), morton(0, u16::MAX)), (0x5555_5555, 0xaaaa_aaaa));
    }
}
