//! When an estimator that learns is given what it has observed.

use crate::{points::PointSet, visibility::Grouping};

/// Samples of a stage from which is learned, at most: more would teach little.
const OBSERVED: u32 = 16;

/// The stages of a rendering. Of a sequence of points in each pixel there are three, of which the last has at least three quarters of the planned samples; the
/// first two teach. Independent points teach for as long as they are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stages {
    points: PointSet,
    /// The largest power of two of which there are as many samples.
    planned: u32,
}

/// One of the stages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stage {
    /// Its number.
    pub number: u32,
    /// Its first sample.
    pub first: u32,
    /// The first sample after it, if that is known.
    pub end: Option<u32>,
    /// Whether the one after it is the last.
    pub is_before_last: bool,
}

impl Stages {
    /// The stages of about so many samples per pixel.
    pub fn new(points: PointSet, samples: u32) -> Self {
        Self { points, planned: 1 << samples.max(1).ilog2() }
    }

    /// Who may learn from whom. Where a sequence is shared by a block of pixels, groups would know nothing of each other's places: there, every stage
    /// begins with a fresh sequence ([`Self::point`]).
    pub fn grouping(&self) -> Grouping {
        match self.points {
            PointSet::Sobol => Grouping::Four,
            PointSet::ZSobol { .. } | PointSet::Independent => Grouping::One,
        }
    }

    /// The stage that a sample is in.
    pub fn of(&self, sample: u32) -> Stage {
        let ends: Vec<u32> = match self.points {
            PointSet::Sobol => [16, 4].into_iter().map(|parts| self.planned / parts).filter(|&end| end > 0).collect(),
            PointSet::ZSobol { .. } => Some(self.planned / 8).into_iter().filter(|&end| end > 0).collect(),
            PointSet::Independent => (0..16).map(|k| 1 << (2 * k)).collect(),
        };
        let number = ends.partition_point(|&end| end <= sample);
        let first = if number == 0 { 0 } else { ends[number - 1] };
        Stage { number: number as u32, first, end: ends.get(number).copied(), is_before_last: number + 1 == ends.len() }
    }

    /// The point of its sequence that a sample of a stage takes.
    pub fn point(&self, stage: &Stage, sample: u32) -> u32 {
        match self.points {
            PointSet::ZSobol { log2_samples } => (stage.number << log2_samples) + sample - stage.first,
            PointSet::Sobol | PointSet::Independent => sample,
        }
    }
}

impl Stage {
    /// Whether to learn from a sample.
    pub fn observes(&self, sample: u32) -> bool {
        self.end.is_some_and(|end| (sample - self.first).is_multiple_of((end - self.first).div_ceil(OBSERVED)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_stage_has_most_samples_and_every_point_is_taken_once() {
        for points in [PointSet::Sobol, PointSet::zsobol(64), PointSet::Independent] {
            for samples in [1, 3, 4, 16, 64, 100, 1000] {
                let stages = Stages::new(points, samples);
                let last = stages.of(samples - 1);
                assert!(points == PointSet::Independent || 4 * last.first <= samples, "{points} {samples}: {last:?}");
                let mut taken: Vec<u32> = (0..samples).map(|k| stages.point(&stages.of(k), k)).collect();
                taken.dedup();
                assert_eq!(taken.len(), samples as usize, "{points} {samples}");
                let first = stages.of(0);
                assert_eq!((first.number, first.first), (0, 0));
                assert!(first.end.is_none_or(|end| (0..end).any(|k| first.observes(k))));
            }
        }
    }

    #[test]
    fn stages_follow_each_other() {
        let stages = Stages::new(PointSet::Sobol, 64);
        let of = |sample| {
            let stage = stages.of(sample);
            (stage.number, stage.first, stage.end, stage.is_before_last)
        };
        assert_eq!((of(0), of(3)), ((0, 0, Some(4), false), (0, 0, Some(4), false)));
        assert_eq!((of(4), of(15)), ((1, 4, Some(16), true), (1, 4, Some(16), true)));
        assert_eq!((of(16), of(9999)), ((2, 16, None, false), (2, 16, None, false)));
    }
}
