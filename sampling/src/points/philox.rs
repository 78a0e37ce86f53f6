//! Philox4x32 (Salmon et al. 2011, "Parallel Random Numbers: As Easy as 1, 2, 3"): four random words for each counter and key.

/// Rounds of the generator: 7 pass all tests of the authors (their table 2).
const ROUNDS: usize = 7;

/// Computes the words of `N` counters under one key.
#[inline(always)]
pub(super) fn philox<const N: usize>(mut counter: [[u32; N]; 4], key: u64) -> [[u32; N]; 4] {
    let (mut low, mut high) = (key as u32, (key >> 32) as u32);
    for _ in 0..ROUNDS {
        let mut next = [[0; N]; 4];
        for lane in 0..N {
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

    /// The known answers of the authors' library for Philox4x32-7.
    #[test]
    fn words_match_the_published_generator() {
        assert_eq!(philox([[0]; 4], 0), [[0x5f6f_b709], [0x0d89_3f64], [0x4f12_1f81], [0x4f73_0a48]]);
    }
}
