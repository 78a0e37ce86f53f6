//! All forms of SPECs, for help, mistakes and documentation.

use std::fmt::Write;

/// What a form is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// To render with.
    Use,
    /// The method of Litalien et al. 2024.
    Paper,
    /// What other renderers do.
    Baseline,
    /// To learn from.
    Study,
}

/// A form of SPECs.
#[derive(Clone, Copy, Debug)]
pub struct Form {
    /// As it is written, with FILE, N, M and SOURCE where others stand.
    pub form: &'static str,
    /// What it is, in a clause.
    pub what: &'static str,
    /// What it is for.
    pub purpose: Purpose,
}

const fn form(purpose: Purpose, form: &'static str, what: &'static str) -> Form {
    Form { form, what, purpose }
}

/// Every form; tests parse each.
pub const FORMS: [Form; 25] = [
    form(Purpose::Use, "auto", "chosen for the view by a short pilot rendering"),
    form(Purpose::Use, "split:N:SOURCE", "the mean of N directions from another form, as in split:4:patches+vis"),
    form(Purpose::Use, "patches", "the product of light, BRDF and cosine in closed form"),
    form(Purpose::Use, "patches+vis", "patches with visibility that is learned before the picture"),
    form(Purpose::Use, "patches+vis:FILE", "with visibility from a file of bake --visibility"),
    form(Purpose::Use, "patches:fine", "patches on a finer division of the map"),
    form(Purpose::Use, "patches:fine+vis", "the same with learned visibility"),
    form(Purpose::Use, "direct:FILE", "light x cosine, tabulated over normals by bake --direct"),
    form(Purpose::Paper, "head+mis:FILE", "a trained head and the map's tail beside BRDF sampling (fit)"),
    form(Purpose::Paper, "head:FILE", "head and tail alone"),
    form(Purpose::Paper, "head+patches:FILE", "a trained head before patches (fit --over patches)"),
    form(Purpose::Paper, "head+patches+vis:FILE", "the same with learned visibility"),
    form(Purpose::Paper, "baked:FILE", "a head, tabulated over normals (bake --from)"),
    form(Purpose::Baseline, "mis", "emitter and BRDF sampling in one-sample MIS"),
    form(Purpose::Baseline, "mis2", "both in two-sample MIS with the power heuristic"),
    form(Purpose::Baseline, "mis-comp", "mis with MIS compensation"),
    form(Purpose::Baseline, "brdf", "BRDF sampling; also called cosine"),
    form(Purpose::Baseline, "emitter", "emitter sampling"),
    form(Purpose::Baseline, "ris:M", "resampling of M candidates, half of each"),
    form(
        Purpose::Study,
        "ris:M:SOURCE",
        "resampling of candidates of another form and BRDF sampling, as in ris:4:direct:FILE",
    ),
    form(Purpose::Study, "direct+mis:FILE", "a table beside BRDF sampling"),
    form(
        Purpose::Study,
        "neusample:FILE",
        "NeuSample for one material (fit-rival); neusample+emitter beside emitter sampling",
    ),
    form(Purpose::Study, "reparam:FILE", "the reparameterised sampler; reparam+emitter beside emitter sampling"),
    form(Purpose::Study, "oracle", "a fine table of light x BRDF x cosine at every point; slow, and no bound"),
    form(Purpose::Study, "oracle+mis", "the same beside BRDF sampling"),
];

/// The forms of some purposes in lines, for help.
pub fn list(purposes: &[Purpose]) -> String {
    let shown = || FORMS.iter().filter(|form| purposes.contains(&form.purpose));
    let width = shown().map(|form| form.form.len()).max().unwrap_or(0);
    shown().fold(String::new(), |mut text, form| {
        // Writing to a string does not fail.
        let _ = writeln!(text, "  {:width$}  {}", form.form, form.what);
        text
    })
}

/// What is said of a text that has none of the forms.
pub(super) fn is_none() -> String {
    let names: Vec<&str> = FORMS.iter().map(|form| form.form).collect();
    format!("is not one of {}", names.join(", "))
}
