//! All forms of SPECs, for help, errors and documentation.

use std::fmt::Write;

use super::source::NAMED;
pub use super::source::Purpose;

/// A form of SPECs.
#[derive(Clone, Copy, Debug)]
pub struct Form {
    /// The form as it is written, with placeholders FILE, N, M and SOURCE.
    pub form: &'static str,
    /// Description in a clause.
    pub what: &'static str,
    /// Its purpose.
    pub purpose: Purpose,
}

const fn form(purpose: Purpose, form: &'static str, what: &'static str) -> Form {
    Form { form, what, purpose }
}

/// The forms that are not in [`NAMED`].
const COMPOUND: [Form; 18] = [
    form(Purpose::Use, "split:N:SOURCE", "the mean of N directions from another form, as in split:4:patches+vis"),
    form(Purpose::Use, "patches+vis", "patches with visibility that is learned before the picture"),
    form(Purpose::Use, "patches+vis:FILE", "with visibility from a file of bake --visibility"),
    form(Purpose::Use, "patches:fine+vis", "patches:fine with learned visibility"),
    form(Purpose::Use, "direct:FILE", "light x cosine, tabulated over normals by bake --direct"),
    form(
        Purpose::Use,
        "mis2:portals",
        "the light through the portals of a room, found before the picture, and BRDF sampling in two-sample MIS; \
         portals+mis in one-sample MIS",
    ),
    form(Purpose::Use, "mis2:portals:FILE", "through the portals of a file of inspect --portals"),
    form(Purpose::Paper, "head+mis:FILE", "a trained head and the map's tail beside BRDF sampling (fit)"),
    form(Purpose::Paper, "head:FILE", "head and tail alone"),
    form(Purpose::Paper, "head+patches:FILE", "a trained head before patches (fit --over patches)"),
    form(Purpose::Paper, "head+patches+vis:FILE", "the same with learned visibility"),
    form(Purpose::Paper, "baked:FILE", "a head, tabulated over normals (bake --from)"),
    form(Purpose::Baseline, "mis2", "emitter and BRDF sampling in two-sample MIS with the power heuristic"),
    form(Purpose::Baseline, "mis2-comp", "mis2 with MIS compensation"),
    form(Purpose::Baseline, "ris:M", "resampling of M candidates, half of each"),
    form(
        Purpose::Study,
        "ris:M:SOURCE",
        "resampling of candidates of another form and BRDF sampling, as in ris:4:direct:FILE",
    ),
    form(
        Purpose::Study,
        "neusample:FILE",
        "NeuSample for one material (fit-rival); neusample+emitter beside emitter sampling",
    ),
    form(Purpose::Study, "reparam:FILE", "the reparameterised sampler; reparam+emitter beside emitter sampling"),
];

/// Returns every form; tests parse each.
pub fn forms() -> impl Iterator<Item = Form> {
    NAMED.iter().map(|named| form(named.what.1, named.name, named.what.0)).chain(COMPOUND)
}

/// Returns the forms with one of `purposes`, one per line, for help.
pub fn list(purposes: &[Purpose]) -> String {
    let shown = || forms().filter(|form| purposes.contains(&form.purpose));
    let width = shown().map(|form| form.form.len()).max().unwrap_or(0);
    shown().fold(String::new(), |mut text, form| {
        // Writing to a string does not fail.
        let _ = writeln!(text, "  {:width$}  {}", form.form, form.what);
        text
    })
}

/// Returns the error for a text that matches no form.
pub(super) fn is_none() -> String {
    let names: Vec<&str> = forms().map(|form| form.form).collect();
    format!("is not one of {}", names.join(", "))
}
