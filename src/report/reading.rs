//! Sentences that are generated from the measurements.

use headtail_render::statistics::{RatioInterval, sidak};

use super::chart::comparisons;
use super::number::{amount, ends, escape, html, times};
use super::summary::{BudgetKind, Group, Measure, Summary};

/// Means with a larger p-value are not distinguished.
const SIGNIFICANCE: f64 = 0.05;

/// Deviations of the mean luminance are reported below this p-value...
const LUMINANCE_SIGNIFICANCE: f64 = 0.001;

/// ... if they are at least this fraction of it: the reference has noise, too.
const LUMINANCE_DEVIATION: f64 = 0.001;

/// Returns sentences as HTML, the most important first.
pub fn sentences(summary: &Summary, reference_luminance: f64) -> Vec<String> {
    let mut sentences = Vec::new();
    for (_, budget, measure) in comparisons(summary) {
        sentences.extend(winner(summary, &budget, measure));
    }
    sentences.extend(outliers(summary));
    sentences.extend(rays(summary));
    sentences.extend(luminance(summary, reference_luminance));
    sentences.extend(broken(summary));
    sentences
}

/// The best sampler at a budget, its lead, and whether that is significant.
fn winner(summary: &Summary, budget: &str, measure: Measure) -> Option<String> {
    let ranking = summary.ranking(budget, measure);
    let (best, runner_up) = (*ranking.first()?, *ranking.get(1)?);
    let words = &summary.budgets.iter().find(|known| known.name == budget)?.words();
    let (at, what) = match measure {
        Measure::Ttuv => (format!("Per unit of time (MSE \u{d7} time at {budget})"), "MSE \u{d7} time"),
        _ if budget.ends_with("spp") => (format!("At equal samples, {words},"), "MSE"),
        _ => (format!("In equal time, {words},"), "MSE"),
    };
    let value = best.measure(measure).mean;
    let over = |other: &Group| match best.ratio(other, measure) {
        Some(ratio) => lead(&ratio),
        None => format!("{}\u{a0}times", times(other.measure(measure).mean / value)),
    };
    let mut sentence = format!("{} {} has the lowest {what}, {}", escape(&at), name(best), html(value));
    let baseline = summary.group(&summary.baseline, budget).filter(|group| group.measure(measure).mean.is_finite());
    match baseline {
        Some(baseline) if baseline.sampler == best.sampler => {
            sentence += &format!(": {} lower than the next, {}", over(runner_up), name(runner_up));
        }
        Some(baseline) => {
            sentence += &format!(": {} lower than {}", over(baseline), escape(&summary.baseline_words()));
            if runner_up.sampler != baseline.sampler {
                sentence += &format!(", and {} lower than the next, {}", over(runner_up), name(runner_up));
            }
        }
        None => sentence += &format!(": {} lower than the next, {}", over(runner_up), name(runner_up)),
    }
    Some(sentence + &confidence(best, runner_up, measure) + ".")
}

/// Describes a ratio in words: "3.4 times (3.1 to 3.7)", or "7 %" for ratios below 1.15.
fn lead(ratio: &RatioInterval) -> String {
    if ratio.ratio < 1.15 {
        return format!("{}\u{a0}%", times(100.0 * (1.0 - 1.0 / ratio.ratio)));
    }
    match ends(ratio) {
        ends if ends.is_empty() => format!("{} times", times(ratio.ratio)),
        ends => format!("{} times ({ends})", times(ratio.ratio)),
    }
}

/// Whether the best two differ significantly, as a clause.
fn confidence(best: &Group, next: &Group, measure: Measure) -> String {
    match best.p_value(next, measure) {
        None => "; a single run cannot say how much of this is luck".to_owned(),
        Some(p) if p > SIGNIFICANCE => {
            format!(
                "; with {} runs the two cannot be told apart (p\u{a0}=\u{a0}{})",
                best.runs.min(next.runs),
                times(p)
            )
        }
        Some(p) if p < 0.001 => String::from(" (p\u{a0}&lt;\u{a0}0.001)"),
        Some(p) => format!(" (p\u{a0}=\u{a0}{p:.3})"),
    }
}

/// Reports if another measure than MSE has another winner, i.e. if a few pixels decide.
fn outliers(summary: &Summary) -> Option<String> {
    let budget = &summary.shown_first().name;
    let best = |measure| summary.ranking(budget, measure).first().map(|group| group.sampler.as_str());
    let by_mse = best(Measure::Mse)?;
    let others = [
        (Measure::RelMse, "relative MSE"),
        (Measure::RelMseTrimmed, "relative MSE without the worst 0.1\u{a0}% of pixels"),
    ];
    let different: Vec<String> = others
        .into_iter()
        .filter_map(|(measure, words)| best(measure).filter(|&name| name != by_mse).map(|name| (words, name)))
        .map(|(words, sampler)| format!("by {words} it is {}", bold(sampler)))
        .collect();
    if different.is_empty() {
        return None;
    }
    Some(format!("MSE is decided by the brightest pixels: {} (at {}).", different.join(", and "), escape(budget)))
}

/// Reports if samplers trace different numbers of rays per sample.
fn rays(summary: &Summary) -> Option<String> {
    let groups: Vec<&Group> = summary.at(&summary.largest(BudgetKind::Samples)?.name).collect();
    let by_rays = |a: &&&Group, b: &&&Group| a.mean.rays_per_sample.total_cmp(&b.mean.rays_per_sample);
    let (least, most) = (groups.iter().min_by(by_rays)?, groups.iter().max_by(by_rays)?);
    if most.mean.rays_per_sample <= 1.02 * least.mean.rays_per_sample {
        return None;
    }
    Some(format!(
        "Equal samples are not equal work: {} traces {} rays per sample, {} only {}.",
        name(most),
        amount(most.mean.rays_per_sample),
        name(least),
        amount(least.mean.rays_per_sample)
    ))
}

/// Reports whether any sampler's mean luminance deviates from the reference, i.e. looks biased.
fn luminance(summary: &Summary, reference: f64) -> Option<String> {
    let groups: Vec<&Group> = summary.at(&summary.shown_first().name).collect();
    if !(reference.is_finite() && reference > 0.0) || groups.iter().any(|group| group.runs < 2) {
        return None;
    }
    let threshold = sidak(LUMINANCE_SIGNIFICANCE, groups.len());
    let deviation = |group: &Group| group.mean_luminance.mean / reference - 1.0;
    let deviating: Vec<String> = groups
        .iter()
        .filter(|group| deviation(group).abs() > LUMINANCE_DEVIATION)
        .filter(|group| group.luminance_p_value(reference).is_some_and(|p| p < threshold))
        .map(|group| {
            let direction = if deviation(group) > 0.0 { "above" } else { "below" };
            format!("that of {} is {}\u{a0}% {direction} it", name(group), times(100.0 * deviation(group).abs()))
        })
        .collect();
    Some(if deviating.is_empty() {
        "All samplers agree with the reference on the mean luminance, so nothing here suggests a bias.".to_owned()
    } else {
        let which = deviating.join(", and ");
        format!(
            "The mean luminance differs from the reference by more than noise: {which}. This looks like a <b>bias</b>."
        )
    })
}

/// Names samplers whose images have non-finite pixels.
fn broken(summary: &Summary) -> Option<String> {
    let mut names: Vec<&str> =
        summary.groups.iter().filter(|group| !group.mse.mean.is_finite()).map(|group| group.sampler.as_str()).collect();
    names.dedup();
    names.sort_unstable();
    names.dedup();
    if names.is_empty() {
        return None;
    }
    let names: Vec<String> = names.iter().map(|name| bold(name)).collect();
    Some(format!("Images of {} have pixels that are infinite or not a number; they are not ranked.", names.join(", ")))
}

fn name(group: &Group) -> String {
    bold(&group.sampler)
}

fn bold(name: &str) -> String {
    format!("<b>{}</b>", escape(name))
}

#[cfg(test)]
mod tests {
    use super::super::synthetic;
    use super::*;
    use headtail_eval::Measurement;

    /// Three runs per sampler with MSEs 2 % apart around the given one; the order of the noise differs by
    /// sampler.
    fn rows(budget: &str, samplers: &[(&str, f64)]) -> Vec<Measurement> {
        let run = |(index, sampler): (u32, &str), mse: f64, run: u32| Measurement {
            mse: mse * (1.0 + 0.02 * f64::from((run + index) % 3)),
            relmse: mse,
            relmse_trimmed: mse,
            ttuv: mse,
            mean_luminance: 1.0 + 1e-5 * f64::from(run),
            ..synthetic::row(sampler, budget, run)
        };
        let numbered = samplers.iter().zip(0..);
        numbered.flat_map(|(&(sampler, mse), index)| (0..3).map(move |i| run((index, sampler), mse, i))).collect()
    }

    fn read(rows: &[Measurement]) -> String {
        sentences(&Summary::of(rows).unwrap(), 1.0).join(" ")
    }

    #[test]
    fn the_best_is_named_with_its_lead_over_the_baseline_and_the_next() {
        let mut all = rows("16spp", &[("mis", 8.0), ("ris", 2.0), ("head", 1.0)]);
        all.extend(rows("2s", &[("mis", 8.0), ("ris", 1.0), ("head", 4.0)]));
        let text = read(&all);
        assert!(text.contains("At equal samples, 16 samples per pixel, <b>head</b> has the lowest MSE, 1.02: 8.0 times (7.4 to 8.7) lower than one-sample MIS, and 2.0 times (1.8 to 2.2) lower than the next, <b>ris</b> (p\u{a0}&lt;\u{a0}0.001)."), "{text}");
        assert!(text.contains("In equal time, 2 seconds, <b>ris</b> has the lowest MSE"), "{text}");
    }

    #[test]
    fn leads_within_noise_are_reported_as_such() {
        let text = read(&rows("16spp", &[("mis", 8.0), ("ris", 1.005), ("head", 1.0)]));
        assert!(
            text.contains("and 0.50\u{a0}% lower than the next, <b>ris</b>; with 3 runs the two cannot be told apart"),
            "{text}"
        );
        let single: Vec<Measurement> =
            rows("16spp", &[("mis", 8.0), ("head", 1.0)]).into_iter().filter(|row| row.run == 0).collect();
        assert!(read(&single).contains("a single run cannot say"));
    }

    #[test]
    fn mse_times_time_replaces_a_missing_time_budget() {
        let mut all = rows("16spp", &[("mis", 8.0), ("head", 1.0)]);
        all.iter_mut().filter(|row| row.sampler == "head").for_each(|row| row.ttuv = 100.0);
        let text = read(&all);
        assert!(text.contains("Per unit of time (MSE \u{d7} time at 16spp) <b>mis</b> has the lowest"), "{text}");
    }

    #[test]
    fn overrun_time_budgets_are_not_called_equal_time() {
        let mut all = rows("2s", &[("mis", 8.0), ("head", 1.0)]);
        all.iter_mut().filter(|row| row.sampler == "head").for_each(|row| row.seconds *= 1.1);
        let text = read(&all);
        assert!(text.contains("Per unit of time (MSE \u{d7} time at 2s)") && !text.contains("In equal time"), "{text}");
    }

    #[test]
    fn a_different_winner_by_another_measure_is_reported() {
        let mut all = rows("16spp", &[("mis", 8.0), ("head", 1.0)]);
        assert!(!read(&all).contains("brightest pixels"));
        all.iter_mut().filter(|row| row.sampler == "head").for_each(|row| row.relmse_trimmed = 100.0);
        assert!(read(&all).contains("by relative MSE without the worst 0.1\u{a0}% of pixels it is <b>mis</b>"));
    }

    #[test]
    fn bias_and_agreement_are_reported() {
        let mut all = rows("16spp", &[("mis", 8.0), ("head", 1.0)]);
        assert!(read(&all).contains("All samplers agree"));
        all.iter_mut().filter(|row| row.sampler == "head").for_each(|row| row.mean_luminance *= 0.9);
        let text = read(&all);
        assert!(text.contains("that of <b>head</b> is 10\u{a0}% below it") && text.contains("bias"), "{text}");
    }

    #[test]
    fn extra_rays_and_broken_images_are_reported() {
        let mut all = rows("16spp", &[("mis", 8.0), ("head", 1.0), ("bad<>", f64::NAN)]);
        all.iter_mut().filter(|row| row.sampler == "head").for_each(|row| row.rays_per_sample = 2.0);
        let text = read(&all);
        assert!(text.contains("<b>head</b> traces 2 rays per sample, <b>mis</b> only 1"), "{text}");
        assert!(text.contains("Images of <b>bad&lt;&gt;</b> have pixels"), "{text}");
    }

    #[test]
    fn a_single_sampler_is_not_ranked() {
        assert!(!read(&rows("16spp", &[("mis", 8.0)])).contains("lowest"));
    }
}
