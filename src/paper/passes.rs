//! Compares masks of one pass with masks of two.

use anyhow::Result;
use headtail_render::{
    composite::{Backdrop, Film, Mask, MaskForm},
    spec::SamplerSpec,
};

use super::{
    PaperContext,
    figure::note,
    part::PartOutput,
    shot::{Errors, Shot, Truth},
};
use crate::report::{
    number::{text, times},
    table::Cell,
};

/// Shadow rays per pixel of the catcher.
const RAYS: u32 = 16;
/// Maximum number of runs.
const RUNS: u32 = 4;
/// Samples of the reference relative to `mask_spp` where the catcher shadows itself.
pub const OWN_SHADOW: u32 = 8;
/// The forms that are compared.
const FORMS: [&str; 4] = ["two passes", "one pass, paper", "one pass, ratio", "one pass, control variate"];

/// Adds the errors of masks of one pass and of two, against a converged mask.
pub fn compare(context: &PaperContext, shot: &Shot, backdrop: &Backdrop<'_>, output: &mut PartOutput) -> Result<()> {
    let best = SamplerSpec::patches().build(&shot.environment)?;
    let (truth, film) = if shot.stage.is_plane() {
        shot.two_passes(backdrop, &*best, 2 * context.effort.mask_spp, 99)
    } else {
        // Where a mesh blocks most of its own light, the quotient of two passes divides by noise; the ratio
        // of one pass uses the same samples in numerator and denominator.
        let learns = "patches+vis".parse::<SamplerSpec>()?.build(&shot.environment)?;
        let film = shot.film(backdrop, &*learns, shot.settings(OWN_SHADOW * context.effort.mask_spp, 99));
        (Mask::of(&film, MaskForm::Ratio), film)
    };
    context.check()?;
    let truth = Truth::new(truth, &film, &shot.chooses_shadow(context, backdrop, &*best));
    context.check()?;
    output.html += &note(&reference(shot, &truth, &film));
    let mut results: Vec<(String, Errors)> = Vec::new();
    for name in ["mis", "ris:4", "patches", "patches+vis"] {
        let spec: SamplerSpec = name.parse()?;
        let estimator = spec.build(&shot.environment)?;
        let mut sums = [Errors::default(); FORMS.len()];
        let runs = context.effort.runs.min(RUNS);
        for run in 0..runs {
            context.check()?;
            let seed = 10 * u64::from(run) + 1;
            let one = shot.film(backdrop, &*estimator, shot.settings(RAYS, seed));
            let (two, _) = shot.two_passes(backdrop, &*estimator, RAYS / 2, seed + 1);
            let single = [MaskForm::Paper, MaskForm::Ratio, MaskForm::ControlVariate].map(|form| Mask::of(&one, form));
            for (sum, mask) in sums.iter_mut().zip([two].iter().chain(&single)) {
                *sum = sum.plus(Errors::of(mask, &truth, &shot.photograph), 1.0 / f64::from(runs));
            }
        }
        results.extend(FORMS.into_iter().zip(sums).map(|(form, errors)| (format!("{form}, {name}"), errors)));
    }
    let base = results[0].1;
    let lower = |base: f64, own: f64| Cell::number(own).beside(format!("{}\u{d7}", times(base / own)));
    let line = |(name, errors): &(String, Errors)| {
        vec![
            Cell::text(name.as_str()),
            lower(base.mask, errors.mask),
            lower(base.shadow, errors.shadow),
            lower(base.composite, errors.composite),
            Cell::number(errors.bias),
        ]
    };
    let stem = format!("{}-{}", shot.name, shot.environment.name()).replace(|c: char| !c.is_ascii_alphanumeric(), "-");
    output.table(
        &format!("passes-{stem}"),
        &["MSE", "mask", "mask in shadow", "composite", "bias"],
        results.iter().map(line).collect(),
    );
    Ok(())
}

/// Describes the reference: its difference from other masks of the same samples, and the error of a single
/// grey mask.
fn reference(shot: &Shot, truth: &Truth, film: &Film) -> String {
    let apart = |mask: &Mask| Errors::of(mask, truth, &shot.photograph);
    let variate = apart(&Mask::of(film, MaskForm::ControlVariate));
    let against = format!(
        "differs from it by {} in root mean square and by {:+.1e} in the mean of the shadow",
        text(variate.mask.sqrt()),
        variate.bias
    );
    let of = match shot.stage.is_plane() {
        true => format!(
            "the quotient of two passes of {} samples per pixel each. The control variate of the first pass alone {against}.",
            film.spp
        ),
        false => format!(
            "the ratio of one pass of {} samples per pixel by patches+vis. The control variate of the same samples {against}.",
            film.spp
        ),
    };
    format!(
        "Reference: {of} One grey mask for all channels, without noise, has an MSE of {} on the composite\u{2019}s pixels; what noise adds to that of masks per channel is in the table.",
        text(apart(&truth.mask.grey()).composite)
    )
}
