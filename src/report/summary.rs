//! The runs of a comparison grouped by sampler and budget, with means and confidence intervals.

use std::cmp::Ordering;

use anyhow::{Result, ensure};
use headtail_render::statistics::{MeanInterval, Moments, RatioInterval, TTest};

use super::kind::Look;
use headtail_eval::Measurement;

/// The default baseline.
const BASELINE: &str = "mis";

/// A comparison grouped by sampler and budget.
pub struct Summary {
    /// Samplers by name, in the order of the rows.
    pub samplers: Vec<String>,
    /// Colours and markers, in the same order.
    looks: Vec<Look>,
    /// Budgets of samples in ascending order, then budgets of time, then others in order of appearance.
    pub budgets: Vec<Budget>,
    /// One per sampler and budget with runs; by budget, then by sampler.
    pub groups: Vec<Group>,
    /// The sampler that ratios refer to: one-sample MIS if present, else the first.
    pub baseline: String,
}

/// The budget of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Budget {
    /// As in the rows, `16spp` or `2s`.
    pub name: String,
    /// Its unit.
    pub kind: BudgetKind,
    amount: f64,
}

/// The unit of a budget.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub enum BudgetKind {
    /// Samples per pixel.
    Samples,
    /// Seconds.
    Time,
    /// Something else.
    Other,
}

impl Budget {
    fn parse(name: &str) -> Self {
        let amount = |unit| name.strip_suffix(unit).and_then(|amount| amount.trim().parse::<f64>().ok());
        let (kind, amount) = match (amount("spp"), amount("s")) {
            (Some(amount), _) => (BudgetKind::Samples, amount),
            (None, Some(amount)) => (BudgetKind::Time, amount),
            (None, None) => (BudgetKind::Other, 0.0),
        };
        Self { name: name.to_owned(), kind, amount }
    }

    /// Describes the budget in words.
    pub fn words(&self) -> String {
        let plural = if self.amount == 1.0 { "" } else { "s" };
        match self.kind {
            BudgetKind::Samples => format!("{} sample{plural} per pixel", self.amount),
            BudgetKind::Time => format!("{} second{plural}", self.amount),
            BudgetKind::Other => self.name.clone(),
        }
    }
}

/// The runs of one sampler at one budget.
pub struct Group {
    /// The sampler.
    pub sampler: String,
    /// The name of the budget.
    pub budget: String,
    /// The row of means.
    pub mean: Measurement,
    /// The number of runs.
    pub runs: usize,
    /// Rendering time in seconds.
    pub seconds: MeanInterval,
    /// MSE.
    pub mse: MeanInterval,
    /// Relative MSE.
    pub relmse: MeanInterval,
    /// Relative MSE without the worst pixels.
    pub relmse_trimmed: MeanInterval,
    /// MSE x time.
    pub ttuv: MeanInterval,
    /// Mean luminance.
    pub mean_luminance: MeanInterval,
    /// The individual runs.
    rows: Vec<Measurement>,
}

/// A measure by which samplers are compared; lower is better.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Measure {
    /// MSE.
    Mse,
    /// Relative MSE.
    RelMse,
    /// Relative MSE without the worst pixels.
    RelMseTrimmed,
    /// MSE x time.
    Ttuv,
    /// Rendering time.
    Time,
}

impl Measure {
    /// Returns the value of a run.
    fn of(self, row: &Measurement) -> f64 {
        match self {
            Self::Mse => row.mse,
            Self::RelMse => row.relmse,
            Self::RelMseTrimmed => row.relmse_trimmed,
            Self::Ttuv => row.ttuv,
            Self::Time => row.seconds,
        }
    }
}

impl Group {
    fn of(runs: &[&Measurement]) -> Option<Self> {
        let first = *runs.first()?;
        let column = |value: fn(&Measurement) -> f64| runs.iter().map(|row| value(row)).collect::<Vec<_>>();
        let mean = |value| Moments::of(&column(value)).map_or(f64::NAN, |moments| moments.mean);
        let row = Measurement {
            spp: mean(|row| row.spp),
            rays_per_sample: mean(|row| row.rays_per_sample),
            seconds: mean(|row| row.seconds),
            mse: mean(|row| row.mse),
            relmse: mean(|row| row.relmse),
            relmse_trimmed: mean(|row| row.relmse_trimmed),
            ttuv: mean(|row| row.ttuv),
            mean_luminance: mean(|row| row.mean_luminance),
            max_weight: runs.iter().map(|row| row.max_weight).fold(f64::NEG_INFINITY, f64::max),
            ..first.clone()
        };
        Some(Self {
            sampler: first.sampler.clone(),
            budget: first.budget.clone(),
            mean: row,
            runs: runs.len(),
            seconds: MeanInterval::of(&column(|row| row.seconds))?,
            mse: MeanInterval::of(&column(|row| row.mse))?,
            relmse: MeanInterval::of(&column(|row| row.relmse))?,
            relmse_trimmed: MeanInterval::of(&column(|row| row.relmse_trimmed))?,
            ttuv: MeanInterval::of(&column(|row| row.ttuv))?,
            mean_luminance: MeanInterval::of(&column(|row| row.mean_luminance))?,
            rows: runs.iter().map(|row| (*row).clone()).collect(),
        })
    }

    /// Returns the mean and interval of a measure.
    pub fn measure(&self, measure: Measure) -> &MeanInterval {
        match measure {
            Measure::Mse => &self.mse,
            Measure::RelMse => &self.relmse,
            Measure::RelMseTrimmed => &self.relmse_trimmed,
            Measure::Ttuv => &self.ttuv,
            Measure::Time => &self.seconds,
        }
    }

    /// Returns values of a measure over the common runs of this group and `other`: `[this, other]`, by run.
    ///
    /// Runs of one number use one seed, so camera rays and some of the noise are the same.
    fn paired(&self, other: &Self, measure: Measure) -> [Vec<f64>; 2] {
        let pairs = self.rows.iter().filter_map(|row| {
            let partner = other.rows.iter().find(|partner| partner.run == row.run)?;
            Some((measure.of(row), measure.of(partner)))
        });
        let (own, others) = pairs.unzip();
        [own, others]
    }

    /// Returns the p-value of the paired t-test for equal means of a measure; `None` for fewer than two
    /// common runs.
    pub fn p_value(&self, other: &Self, measure: Measure) -> Option<f64> {
        let [own, others] = self.paired(other, measure);
        let differences: Vec<f64> = own.iter().zip(&others).map(|(a, b)| a - b).collect();
        let scale = Moments::of(&own)?.mean.abs().max(Moments::of(&others)?.mean.abs());
        (differences.len() > 1).then_some(TTest::paired(&Moments::of(&differences)?, scale).p_value)
    }

    /// Returns the p-value of the test for a mean luminance of `expected`; `None` for a single run.
    pub fn luminance_p_value(&self, expected: f64) -> Option<f64> {
        let differences: Vec<f64> = self.rows.iter().map(|row| row.mean_luminance - expected).collect();
        (differences.len() > 1).then_some(TTest::paired(&Moments::of(&differences)?, expected.abs()).p_value)
    }

    /// Returns the mean of `other` divided by this mean over their common runs; above 1 is better. `None`
    /// without common runs, or if the ratio is not positive and finite.
    pub fn ratio(&self, other: &Self, measure: Measure) -> Option<RatioInterval> {
        let [own, others] = self.paired(other, measure);
        RatioInterval::paired(&others, &own)
    }
}

impl Summary {
    /// Groups the runs.
    pub fn of(rows: &[Measurement]) -> Result<Self> {
        let runs: Vec<&Measurement> = rows.iter().collect();
        ensure!(!runs.is_empty(), "rows: there are no runs to report");
        let samplers = in_order(runs.iter().map(|row| row.sampler.as_str()));
        let names = in_order(runs.iter().map(|row| row.budget.as_str()));
        let mut budgets: Vec<Budget> = names.iter().map(|name| Budget::parse(name)).collect();
        budgets.sort_by(|a, b| {
            let kinds = a.kind.partial_cmp(&b.kind).unwrap_or(Ordering::Equal);
            kinds.then(a.amount.total_cmp(&b.amount))
        });
        let mut groups = Vec::new();
        for budget in &budgets {
            for sampler in &samplers {
                let of_group = |row: &&&Measurement| row.sampler == *sampler && row.budget == budget.name;
                groups.extend(Group::of(&runs.iter().filter(of_group).copied().collect::<Vec<_>>()));
            }
        }
        let baseline = samplers.iter().find(|sampler| *sampler == BASELINE).unwrap_or(&samplers[0]).clone();
        let looks = Look::of_all(samplers.iter().map(String::as_str));
        Ok(Self { looks, samplers, budgets, groups, baseline })
    }

    /// Names the baseline in words.
    pub fn baseline_words(&self) -> String {
        if self.baseline == BASELINE { "one-sample MIS".to_owned() } else { self.baseline.clone() }
    }

    /// Returns the colour and marker of a sampler.
    pub fn look(&self, sampler: &str) -> Look {
        self.looks[self.samplers.iter().position(|known| known == sampler).unwrap_or(0)]
    }

    /// Returns the group of a sampler at a budget.
    pub fn group(&self, sampler: &str, budget: &str) -> Option<&Group> {
        self.groups.iter().find(|group| group.sampler == sampler && group.budget == budget)
    }

    /// Returns the groups at a budget, in the order of the samplers.
    pub fn at(&self, budget: &str) -> impl Iterator<Item = &Group> {
        self.groups.iter().filter(move |group| group.budget == budget)
    }

    /// Returns the largest budget of a kind with runs.
    pub fn largest(&self, kind: BudgetKind) -> Option<&Budget> {
        self.budgets.iter().rfind(|budget| budget.kind == kind)
    }

    /// Returns the budget whose images are shown first: the largest of samples, else the last.
    pub fn shown_first(&self) -> &Budget {
        let last = self.budgets.last().expect("a summary has runs, so it has a budget");
        self.largest(BudgetKind::Samples).unwrap_or(last)
    }

    /// Returns the baseline's measure divided by the group's at the same budget, over their common runs.
    pub fn ratio(&self, group: &Group, measure: Measure) -> Option<RatioInterval> {
        group.ratio(self.group(&self.baseline, &group.budget)?, measure)
    }

    /// Returns the groups at a budget with a finite measure, best first.
    pub fn ranking(&self, budget: &str, measure: Measure) -> Vec<&Group> {
        let mut groups: Vec<&Group> = self.at(budget).filter(|group| group.measure(measure).mean.is_finite()).collect();
        groups.sort_by(|a, b| a.measure(measure).mean.total_cmp(&b.measure(measure).mean));
        groups
    }
}

/// Returns the distinct names in order of appearance.
pub(super) fn in_order<'a>(names: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut distinct: Vec<String> = Vec::new();
    for name in names {
        if !distinct.iter().any(|known| known == name) {
            distinct.push(name.to_owned());
        }
    }
    distinct
}

#[cfg(test)]
mod tests {
    use super::super::synthetic;
    use super::*;

    #[test]
    fn budgets_are_ordered_by_kind_and_amount() {
        let names = ["2s", "16spp", "0.5s", "4spp", "odd", "128spp"];
        let rows: Vec<Measurement> = names.iter().map(|name| synthetic::row("mis", name, 0)).collect();
        let summary = Summary::of(&rows).unwrap();
        let ordered: Vec<&str> = summary.budgets.iter().map(|budget| budget.name.as_str()).collect();
        assert_eq!(ordered, ["4spp", "16spp", "128spp", "0.5s", "2s", "odd"]);
        assert_eq!(summary.shown_first().name, "128spp");
        assert_eq!(summary.largest(BudgetKind::Time).unwrap().words(), "2 seconds");
        assert_eq!(Budget::parse("1spp").words(), "1 sample per pixel");
    }

    #[test]
    fn ratios_refer_to_one_sample_mis_in_any_order() {
        let rows = [("ris", 0, 1.0), ("ris", 1, 3.0), ("mis", 0, 8.0), ("mis", 1, 8.0)]
            .map(|(sampler, run, mse)| Measurement { mse, max_weight: mse, ..synthetic::row(sampler, "16spp", run) });
        let summary = Summary::of(&rows).unwrap();
        assert_eq!(summary.baseline, "mis");
        let ris = summary.group("ris", "16spp").unwrap();
        assert_eq!((ris.mean.mse, ris.mean.max_weight, ris.mean.seed, ris.runs), (2.0, 3.0, rows[0].seed, 2));
        assert_eq!(summary.ratio(ris, Measure::Mse).unwrap().ratio, 4.0);
        assert_eq!(summary.ranking("16spp", Measure::Mse)[0].sampler, "ris");
    }

    #[test]
    fn empty_comparisons_are_rejected() {
        assert!(Summary::of(&[]).is_err());
    }

    /// Four runs with common noise; `ris` has 75 % of the MSE of `mis`.
    fn shared_noise() -> Vec<Measurement> {
        let row = |sampler: &str, run: u32, mse: f64| Measurement { mse, ..synthetic::row(sampler, "16spp", run) };
        let noise = [1.0, 3.0, 2.0, 7.0];
        // Rows may be in any order; pairs match by run number.
        let mut rows: Vec<Measurement> = noise.iter().zip(0_u32..4).map(|(&mse, run)| row("mis", run, mse)).collect();
        rows.extend(
            noise.iter().zip(0_u32..4).rev().map(|(&mse, run)| row("ris", run, 0.75 * mse + 0.01 * f64::from(run))),
        );
        rows
    }

    #[test]
    fn common_noise_cancels_in_paired_tests() {
        let summary = Summary::of(&shared_noise()).unwrap();
        let [mis, ris] = ["mis", "ris"].map(|sampler| summary.group(sampler, "16spp").unwrap());
        // The differences are 0.25, 0.74, 0.48, 1.72: mean 0.7975, standard error 0.3234, t = 2.466, and
        // p = 0.0904 with 3 degrees of freedom. Unpaired, t would be 0.48.
        let p = ris.p_value(mis, Measure::Mse).unwrap();
        assert!((p - 0.0904).abs() < 1e-4, "{p}");
        let (low, high) = summary.ratio(ris, Measure::Mse).unwrap().ends().unwrap();
        // ln(ratio) has standard error 0.00148, times t(0.975, 3) = 3.182.
        assert!((low - 1.3190).abs() < 1e-4 && (high - 1.3314).abs() < 1e-4, "{low} {high}");
    }

    #[test]
    fn only_common_runs_are_compared() {
        let mut rows = shared_noise();
        rows.retain(|row| row.sampler == "mis" || row.run < 2);
        let summary = Summary::of(&rows).unwrap();
        let [mis, ris] = ["mis", "ris"].map(|sampler| summary.group(sampler, "16spp").unwrap());
        assert_eq!((mis.runs, ris.runs), (4, 2));
        assert!((summary.ratio(ris, Measure::Mse).unwrap().ratio - 4.0 / 3.01).abs() < 1e-12);
        rows.retain(|row| row.sampler == "mis" || row.run == 0);
        let summary = Summary::of(&rows).unwrap();
        let [mis, ris] = ["mis", "ris"].map(|sampler| summary.group(sampler, "16spp").unwrap());
        assert!(ris.p_value(mis, Measure::Mse).is_none() && ris.ratio(mis, Measure::Mse).unwrap().ends().is_none());
        rows.retain(|row| row.sampler == "ris" || row.run == 1);
        let summary = Summary::of(&rows).unwrap();
        assert!(summary.ratio(summary.group("ris", "16spp").unwrap(), Measure::Mse).is_none());
    }

    #[test]
    fn nan_is_excluded_from_ratios_and_ranking() {
        let broken = Measurement { mse: f64::NAN, ..synthetic::row("ris", "16spp", 0) };
        let summary = Summary::of(&[synthetic::row("mis", "16spp", 0), broken]).unwrap();
        let ris = summary.group("ris", "16spp").unwrap();
        assert!(summary.ratio(ris, Measure::Mse).is_none());
        assert_eq!(summary.ranking("16spp", Measure::Mse).len(), 1);
    }
}
