//! Percentile intervals by resampling (Efron and Tibshirani 1993, chapter 13).

use headtail_render::random::{Purpose, Stream};

/// A value with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// Value for all data.
    pub value: f64,
    /// 2.5th percentile over resampled data.
    pub low: f64,
    /// 97.5th percentile.
    pub high: f64,
}

/// Number of resamples.
const RESAMPLES: u64 = 1000;

/// Returns the interval of `statistic`, which draws indices from its argument: the first call must use the
/// data unchanged (`None`), the others resample them. Resamples without a value are excluded. Equal data give
/// equal intervals.
pub fn bootstrap(statistic: impl Fn(Option<&mut Stream>) -> Option<f64>) -> Option<Interval> {
    let value = statistic(None)?;
    let resample = |k| statistic(Some(&mut Stream::new(k, Purpose::Test, 0)));
    let mut values: Vec<f64> = (0..RESAMPLES).filter_map(resample).filter(|value| value.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    let percentile = |p: f64| {
        let at = p * (values.len() - 1) as f64;
        let (below, part) = (at.floor() as usize, at.fract());
        values[below] + part * (values[(below + 1).min(values.len() - 1)] - values[below])
    };
    (!values.is_empty()).then(|| Interval { value, low: percentile(0.025), high: percentile(0.975) })
}

/// Returns a random index below `count`.
pub fn index(random: &mut Stream, count: usize) -> usize {
    ((f64::from(random.uniform()) * count as f64) as usize).min(count - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_of_means_hold_the_true_mean() {
        let mut random = Stream::new(7, Purpose::Test, 1);
        let trials = 300;
        let hits = (0..trials)
            .filter(|_| {
                let data: Vec<f64> = (0..40).map(|_| (0..12).map(|_| f64::from(random.uniform())).sum()).collect();
                let mean = |resampling: Option<&mut Stream>| {
                    let sum: f64 = match resampling {
                        None => data.iter().sum(),
                        Some(random) => (0..40).map(|_| data[index(random, 40)]).sum(),
                    };
                    Some(sum / 40.0)
                };
                let interval = bootstrap(mean).unwrap();
                (interval.low..=interval.high).contains(&6.0)
            })
            .count();
        // Percentile intervals of 40 values cover about 93.5 %; the tolerance is four binomial standard
        // deviations of 1.4 %.
        let covered = hits as f64 / f64::from(trials);
        assert!((covered - 0.935).abs() < 0.06, "{covered}");
    }

    #[test]
    fn constant_data_give_an_interval_of_zero_width() {
        let interval = bootstrap(|_| Some(3.0)).unwrap();
        assert_eq!((interval.value, interval.low, interval.high), (3.0, 3.0, 3.0));
        assert_eq!(bootstrap(|_| None), None);
    }
}
