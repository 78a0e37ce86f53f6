//! The section on how a comparison was measured.

use headtail_render::statistics::{PIXELS_PER_DEGREE, RELATIVE_EPSILON, TRIMMED_FRACTION};
use maud::{Markup, html};

use super::super::comparison::Comparison;
use super::super::gallery::Gallery;
use super::super::number::times;
use super::super::picture;
use super::super::summary::in_order;

/// Describes the sampler `oracle`. With shadows, another density has the least variance.
const ORACLE: &str = "The exact product of light, BRDF and cosine, without visibility, tabulated at every shading point. Where \
                      shadows matter, other samplers can have less error.";

const RUNS: &str = "Runs of a sampler differ only in their seed. Images are those of the first run; all other numbers are means \
                    over the runs, with the 95\u{a0}% interval of Student\u{2019}s t distribution.";

const PAIRS: &str = "Run k of every sampler has the same seed, hence at equal samples the same camera rays, so samplers are compared run by run: p-values \
                     are of the paired t-test on the differences of n common runs (n \u{2212} 1 degrees of freedom). A ratio is that \
                     of the means over the common runs; its 95\u{a0}% interval is of its logarithm, by the delta method for paired runs.";

/// The section.
pub fn section(comparison: &Comparison, gallery: &Gallery) -> Markup {
    // Without the numbers of samples of lattices, which are in the table.
    let points = in_order(comparison.rows.iter().map(|row| row.points.split(':').next().unwrap_or_default()));
    let has_oracle = comparison.rows.iter().any(|row| row.sampler == "oracle");
    let line = |term: &str, text: Markup| html! { div { dt { (term) } dd { (text) } } };
    html! {
        section {
            h2 { "How it was measured" }
            dl.method {
                (line("Machine", html! { (comparison.machine) }))
                (line("Reference", html! { (comparison.reference_note) }))
                (line("Points", html! { (points.join(", ")) }))
                (line("Runs", html! { (RUNS) }))
                (line("Pairs", html! { (PAIRS) }))
                (line("MSE", html! {
                    "Mean over " (pixels(comparison)) ", and over channels of (x \u{2212} r)" sup { "2" }
                    ", r the reference, in linear Rec.709."
                }))
                (line("relMSE", html! {
                    "Mean of (x \u{2212} r)" sup { "2" } " / (r" sup { "2" } " + " (RELATIVE_EPSILON) "); \u{201c}trimmed\u{201d} leaves out the worst "
                    (100.0 * TRIMMED_FRACTION) "\u{a0}% of pixels, and \u{201c}fireflies\u{201d} is the fraction of the error in these."
                }))
                (line("FLIP", html! {
                    "Mean of LDR-FLIP (Andersson et al. 2020) over " (pixels(comparison)) " of the first run's picture as it is shown here, for an observer who sees "
                    (PIXELS_PER_DEGREE) " pixels per degree: 0 looks the same, 1 as different as can be. HDR-FLIP (Andersson et al. 2021) is the largest "
                    "over the exposures from the one that shows the reference\u{2019}s brightest pixel to the one that shows its median."
                }))
                (line("Time", time(comparison, &points)))
                (line("Images", images(comparison, gallery)))
                @if has_oracle { (line("Oracle", html! { (ORACLE) })) }
            }
        }
    }
}

fn pixels(comparison: &Comparison) -> String {
    let measured = comparison.measured.iter().filter(|measured| **measured).count() as f64;
    if comparison.measured.is_empty() {
        return "all pixels".to_owned();
    }
    format!("the measured pixels, {}\u{a0}% of the image", times(100.0 * measured / comparison.measured.len() as f64))
}

fn time(comparison: &Comparison, points: &[String]) -> Markup {
    let independent = points.iter().all(|points| points == "independent");
    let timed = comparison.rows.iter().any(|row| row.budget.ends_with('s'));
    html! {
        "Rendering only. TTUV is MSE \u{d7} time: its ratio is the ratio of the times to the same error"
        @if !independent {
            " only where MSE falls inversely with time; with these points it falls faster, in favour of the slower sampler"
        }
        "."
        @if timed { " At a budget of time, a sampler takes the samples that fit into it." }
    }
}

fn images(comparison: &Comparison, gallery: &Gallery) -> Markup {
    let side = comparison.width.div_ceil(picture::ERROR_MAP_WIDTH).max(1);
    let sign = if gallery.exposure < 0.0 { "\u{2212}" } else { "+" };
    html! {
        "Exposure " (sign) (gallery.exposure.abs())
        " stops for all, extended Reinhard tone curve, sRGB; the slider's exposure comes on top of it. Error maps: relative squared error"
        @if side > 1 { ", averaged over " (side) " \u{d7} " (side) " pixels" }
        ", logarithmic, one scale for all samplers at a budget; cyan is not a number"
        @if !comparison.measured.is_empty() { ", grey is not measured" }
        ". The page holds linear values to about half a per cent"
        @if !gallery.all_radiance {
            ", at the budget that is shown first; at others, exposures and differences are of the 8-bit pictures"
        }
        "."
    }
}
