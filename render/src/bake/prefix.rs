//! Inversion of a tabulated distribution given by its running sums.

/// The largest share of a cell: positions inside stay below 1.
const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// Finds the cell in which a non-decreasing list of inclusive running sums (not empty, last one positive) reaches the share
/// `u` of its total; `(cell, position inside in [0, 1))`.
///
/// Small lists are counted rather than bisected: no branch to predict, and the loop runs in SIMD lanes.
pub fn search_prefix(sums: &[f32], u: f32) -> (usize, f32) {
    let last = sums.len() - 1;
    let target = u * sums[last];
    let cell = if sums.len() <= 64 {
        sums[..last].iter().map(|&sum| u32::from(sum <= target)).sum::<u32>() as usize
    } else {
        sums[..last].partition_point(|&sum| sum <= target)
    };
    let before = if cell == 0 { 0.0 } else { sums[cell - 1] };
    let size = sums[cell] - before;
    let inside = if size > 0.0 { ((target - before) / size).clamp(0.0, BELOW_ONE) } else { 0.0 };
    (cell, inside)
}

/// Inclusive running sums of equal length (not 0) with weights: the running sums of a mixture, blended only where they are
/// looked at.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlendedSums<'a> {
    pub(super) lines: [&'a [f32]; 4],
    pub(super) weights: [f32; 4],
}

/// Sums that are searched together; a longer list is first searched by the last sums of its blocks.
const BLOCK: usize = 8;

impl BlendedSums<'_> {
    /// The blended sum up to and including a cell.
    #[inline]
    pub(super) fn at(&self, cell: usize) -> f32 {
        let [a, b, c, d] = self.lines;
        let [wa, wb, wc, wd] = self.weights;
        (wa * a[cell] + wb * b[cell]) + (wc * c[cell] + wd * d[cell])
    }

    /// The blended mass of a cell: differences first, so that nothing of a small cell is lost beside a large sum.
    #[inline]
    pub(super) fn mass(&self, cell: usize) -> f32 {
        let own = |line: &[f32]| if cell == 0 { line[0] } else { line[cell] - line[cell - 1] };
        let [a, b, c, d] = self.lines;
        let [wa, wb, wc, wd] = self.weights;
        (wa * own(a) + wb * own(b)) + (wc * own(c) + wd * own(d))
    }

    /// As [`search_prefix`], over the mixture.
    #[inline]
    pub(super) fn search(&self, u: f32) -> (usize, f32) {
        let length = self.lines[0].len();
        let target = u * self.at(length - 1);
        let blocks = length.div_ceil(BLOCK);
        let block =
            (0..blocks - 1).map(|block| usize::from(self.at(block * BLOCK + BLOCK - 1) <= target)).sum::<usize>();
        let first = block * BLOCK;
        let count = BLOCK.min(length - first);
        let mut sums = [f32::INFINITY; BLOCK];
        for (k, sum) in sums[..count].iter_mut().enumerate() {
            *sum = self.at(first + k);
        }
        let inner = sums[..count - 1].iter().map(|&sum| usize::from(sum <= target)).sum::<usize>();
        let cell = first + inner;
        let before = match (inner, first) {
            (0, 0) => 0.0,
            (0, _) => self.at(first - 1),
            _ => sums[inner - 1],
        };
        let size = sums[inner] - before;
        let inside = if size > 0.0 { ((target - before) / size).clamp(0.0, BELOW_ONE) } else { 0.0 };
        (cell, inside)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blended_search_is_the_search_of_the_blend() {
        for length in [1, 2, 7, 8, 9, 16, 31, 32, 64] {
            let line = |seed: usize| -> Vec<f32> {
                let masses = (0..length).map(|k| ((k * 7 + seed * 5) % 11) as f32 + 0.1);
                masses
                    .scan(0.0, |sum, mass| {
                        *sum += mass;
                        Some(*sum)
                    })
                    .collect()
            };
            let lines = [line(1), line(2), line(3), line(4)];
            let blended = BlendedSums { lines: lines.each_ref().map(Vec::as_slice), weights: [0.1, 0.2, 0.3, 0.4] };
            let whole: Vec<f32> = (0..length).map(|cell| blended.at(cell)).collect();
            for k in 0..1000 {
                let u = k as f32 / 1000.0;
                assert_eq!(blended.search(u), search_prefix(&whole, u), "{length} {u}");
            }
        }
    }

    #[test]
    fn cells_are_hit_in_proportion_and_empty_cells_never() {
        let sums = [0.0, 1.0, 1.0, 4.0];
        for k in 0..1000 {
            let u = k as f32 / 1000.0;
            let (cell, inside) = search_prefix(&sums, u);
            assert_eq!(cell, if u < 0.25 { 1 } else { 3 });
            let expected = if cell == 1 { 4.0 * u } else { (4.0 * u - 1.0) / 3.0 };
            assert!((inside - expected).abs() < 1e-6);
        }
    }

    #[test]
    fn counting_and_bisecting_agree() {
        let long: Vec<f32> = (0..200)
            .map(|k| ((k * k) % 7 * k) as f32)
            .scan(0.0, |s, x| {
                *s += x;
                Some(*s)
            })
            .collect();
        for k in 0..500 {
            let u = k as f32 / 500.0;
            let counted = long[..199].iter().filter(|&&sum| sum <= u * long[199]).count();
            assert_eq!(search_prefix(&long, u).0, counted);
        }
    }
}
