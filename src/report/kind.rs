//! One colour and one marker per kind of sampler, on every page.

use std::fmt::Write;

use headtail_render::spec::{Combiner, Companion, FileKind, SamplerSpec, Source, Visibility};

/// Kinds of samplers that are distinguished by colour and marker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// One-sample MIS, the baseline.
    Mis,
    /// Two-sample MIS.
    TwoSampleMis,
    /// MIS with a compensated emitter sampler.
    CompensatedMis,
    /// BRDF sampling.
    Brdf,
    /// Emitter sampling.
    Emitter,
    /// Resampling of emitter and BRDF samples.
    Ris,
    /// Resampling of samples of the product.
    RisOfProduct,
    /// The product in closed form.
    Patches,
    /// The product in closed form with trained visibility.
    PatchesWithVisibility,
    /// The light through the portals of a room.
    Portals,
    /// The product as a table.
    Direct,
    /// A trained head alone.
    Head,
    /// A trained head in a mixture with BRDF sampling.
    HeadWithMis,
    /// A trained head over the product in closed form.
    HeadOverPatches,
    /// A trained head over the product in closed form with trained visibility.
    HeadOverPatchesWithVisibility,
    /// A trained head as a table.
    Baked,
    /// A published sampler trained for a material.
    Rival,
    /// A published sampler mixed with emitter sampling.
    RivalWithEmitter,
    /// The exact product.
    Oracle,
    /// The choice of `auto`.
    Auto,
    /// Not a sampler of the program.
    Other,
}

/// Colour (`--s0` to `--s9` in the style sheet) and marker (see [`outline`]) of each kind.
const LOOKS: [(Kind, usize, usize); 21] = [
    (Kind::Mis, 0, 0),
    (Kind::TwoSampleMis, 8, 1),
    (Kind::CompensatedMis, 8, 3),
    (Kind::Brdf, 3, 2),
    (Kind::Emitter, 5, 4),
    (Kind::Ris, 4, 3),
    (Kind::RisOfProduct, 4, 5),
    (Kind::Patches, 2, 1),
    (Kind::PatchesWithVisibility, 6, 6),
    (Kind::Portals, 7, 2),
    (Kind::Direct, 7, 5),
    (Kind::Head, 1, 4),
    (Kind::HeadWithMis, 1, 7),
    (Kind::HeadOverPatches, 1, 1),
    (Kind::HeadOverPatchesWithVisibility, 1, 6),
    (Kind::Baked, 9, 8),
    (Kind::Rival, 5, 8),
    (Kind::RivalWithEmitter, 5, 5),
    (Kind::Oracle, 0, 9),
    (Kind::Auto, 6, 2),
    (Kind::Other, 8, 0),
];

impl Kind {
    /// The kind of a SPEC, with or without its file, or of a label in a figure.
    pub fn of(name: &str) -> Self {
        let name = name.strip_prefix("best: ").or(name.strip_prefix("cheap: ")).unwrap_or(name);
        let spec = name.parse().or_else(|_| format!("{name}:FILE").parse());
        spec.map_or_else(|_| Self::of_label(name), |spec| Self::of_spec(&spec))
    }

    /// The kind of a SPEC.
    fn of_spec(spec: &SamplerSpec) -> Self {
        let (source, companion) = (spec.source(), spec.companion());
        let is_product = matches!(source, Source::Patches(_) | Source::File(..));
        let has_visibility = *spec.visibility() != Visibility::None;
        match (spec.combiner(), source, companion) {
            (_, Source::Portals(_), _) => Self::Portals,
            (Combiner::TwoSampleMis(_), ..) => Self::TwoSampleMis,
            (Combiner::Ris(_), ..) if is_product => Self::RisOfProduct,
            (Combiner::Ris(_), ..) => Self::Ris,
            (_, Source::Auto, _) => Self::Auto,
            (_, Source::Brdf | Source::Cosine, _) => Self::Brdf,
            (_, Source::Emitter, Companion::Brdf) => Self::Mis,
            (_, Source::Emitter, _) => Self::Emitter,
            (_, Source::Compensated, _) => Self::CompensatedMis,
            (_, Source::Oracle, _) => Self::Oracle,
            (_, Source::Patches(_), _) if has_visibility => Self::PatchesWithVisibility,
            (_, Source::Patches(_), _) => Self::Patches,
            (_, Source::File(FileKind::Head, _), Companion::Brdf) => Self::HeadWithMis,
            (_, Source::File(FileKind::Head, _), _) => Self::Head,
            (_, Source::File(FileKind::HeadOverPatches, _), _) if has_visibility => Self::HeadOverPatchesWithVisibility,
            (_, Source::File(FileKind::HeadOverPatches, _), _) => Self::HeadOverPatches,
            (_, Source::File(FileKind::Baked, _), _) => Self::Baked,
            (_, Source::File(FileKind::Direct, _), _) => Self::Direct,
            (_, Source::Rival(..), Companion::Emitter) => Self::RivalWithEmitter,
            (_, Source::Rival(..), _) => Self::Rival,
        }
    }

    /// The kind of a label that is not a SPEC, by its first word.
    fn of_label(label: &str) -> Self {
        match label.split([',', ' ']).next().unwrap_or(label) {
            "head" if label.contains("MIS") || label.contains("share") => Self::HeadWithMis,
            "head" => Self::Head,
            "share" | "default" => Self::HeadWithMis,
            "bake" | "baked" => Self::Baked,
            "direct" => Self::Direct,
            "neusample" if label.contains("emitter") => Self::RivalWithEmitter,
            "neusample" | "reparam" => Self::Rival,
            _ => Self::Other,
        }
    }
}

/// How a sampler is drawn among others. Samplers of one kind have the same colour and marker and differ in
/// dashes and fill.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Look {
    kind: Kind,
    /// Index among the samplers of its kind.
    variant: usize,
}

impl Look {
    /// Number of dashes and fills before they repeat.
    const VARIANTS: usize = 4;

    /// Returns the looks of samplers that are shown together, in their order.
    pub fn of_all<'a>(names: impl Iterator<Item = &'a str>) -> Vec<Self> {
        let mut looks: Vec<Self> = Vec::new();
        for name in names {
            let kind = Kind::of(name);
            let variant = looks.iter().filter(|look| look.kind == kind).count();
            looks.push(Self { kind, variant });
        }
        looks
    }

    fn row(self) -> (Kind, usize, usize) {
        LOOKS.into_iter().find(|(kind, ..)| *kind == self.kind).unwrap_or(LOOKS[LOOKS.len() - 1])
    }

    /// Returns the CSS classes for colour and dashes.
    pub fn class(self) -> String {
        format!("series s{} v{}", self.row().1, self.variant % Self::VARIANTS)
    }

    /// Returns the marker at a position, as SVG.
    pub fn marker(self, x: f64, y: f64) -> String {
        // Unknown samplers have no shape of their own, so shapes vary instead.
        let shape = if self.kind == Kind::Other { self.variant } else { self.row().2 };
        let mut svg = format!("<path class=\"marker\" d=\"{}\"/>", outline(shape, x, y));
        if self.variant % Self::VARIANTS >= 2 {
            let _ = write!(svg, "<circle class=\"dot\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"1.7\"/>");
        }
        svg
    }

    /// Returns the marker as an icon for use beside a name.
    pub fn swatch(self) -> String {
        let (class, marker) = (self.class(), self.marker(7.0, 7.0));
        format!("<svg class=\"swatch {class}\" viewBox=\"0 0 14 14\" aria-hidden=\"true\">{marker}</svg>")
    }
}

/// The outline of a marker. Shapes distinguish kinds where colours do not.
fn outline(shape: usize, x: f64, y: f64) -> String {
    let polygon = |points: &[(f64, f64)]| {
        let points: Vec<String> = points.iter().map(|(dx, dy)| format!("{:.1} {:.1}", x + dx, y + dy)).collect();
        format!("M{}Z", points.join("L"))
    };
    let star = |tips: usize, inner: f64| {
        let corner = |k: usize| {
            let angle = std::f64::consts::PI * k as f64 / tips as f64;
            let radius = if k.is_multiple_of(2) { 5.8 } else { 5.8 * inner };
            (radius * angle.sin(), -radius * angle.cos())
        };
        polygon(&(0..2 * tips).map(corner).collect::<Vec<_>>())
    };
    match shape % 10 {
        0 => format!("M{:.1} {y:.1}a4.4 4.4 0 1 0 8.8 0a4.4 4.4 0 1 0 -8.8 0Z", x - 4.4),
        1 => polygon(&[(-4.0, -4.0), (4.0, -4.0), (4.0, 4.0), (-4.0, 4.0)]),
        2 => polygon(&[(0.0, -5.2), (5.0, 3.8), (-5.0, 3.8)]),
        3 => polygon(&[(0.0, -5.8), (5.0, 0.0), (0.0, 5.8), (-5.0, 0.0)]),
        4 => polygon(&[(0.0, 5.2), (5.0, -3.8), (-5.0, -3.8)]),
        5 => polygon(&[
            (-2.0, -5.0),
            (2.0, -5.0),
            (2.0, -2.0),
            (5.0, -2.0),
            (5.0, 2.0),
            (2.0, 2.0),
            (2.0, 5.0),
            (-2.0, 5.0),
            (-2.0, 2.0),
            (-5.0, 2.0),
            (-5.0, -2.0),
            (-2.0, -2.0),
        ]),
        6 => polygon(&[(0.0, -5.4), (5.1, -1.7), (3.2, 4.4), (-3.2, 4.4), (-5.1, -1.7)]),
        7 => star(5, 0.45),
        8 => star(3, 0.95),
        _ => star(4, 0.38),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn specs_and_labels_map_to_kinds() {
        for (name, kind) in [
            ("mis", Kind::Mis),
            ("mis2", Kind::TwoSampleMis),
            ("split:4:mis-comp", Kind::CompensatedMis),
            ("split:2:patches:fine", Kind::Patches),
            ("cosine", Kind::Brdf),
            ("ris:4", Kind::Ris),
            ("ris:4:direct:a/b.safetensors", Kind::RisOfProduct),
            ("patches:fine", Kind::Patches),
            ("patches+vis", Kind::PatchesWithVisibility),
            ("patches:fine+vis", Kind::PatchesWithVisibility),
            ("head+patches:x", Kind::HeadOverPatches),
            ("head+patches+vis:x", Kind::HeadOverPatchesWithVisibility),
            ("mis2:portals:x", Kind::Portals),
            ("auto", Kind::Auto),
            ("oracle+mis", Kind::Oracle),
            ("head+mis", Kind::HeadWithMis),
            ("direct 8x16 of 8x8", Kind::Direct),
            ("bake of head 8x64, 250 steps", Kind::Baked),
            ("ris:4:head+patches:x", Kind::RisOfProduct),
            ("reparam:x", Kind::Rival),
            ("neusample+emitter:x", Kind::RivalWithEmitter),
            ("head+mis:mis.safetensors", Kind::HeadWithMis),
            ("head:out/x", Kind::Head),
            ("head + MIS", Kind::HeadWithMis),
            ("best: baked:x", Kind::Baked),
            ("something", Kind::Other),
        ] {
            assert_eq!(Kind::of(name), kind, "{name}");
        }
    }

    #[test]
    fn kinds_look_different_and_so_do_samplers_of_one_kind() {
        let looks = LOOKS.map(|(_, colour, marker)| (colour, marker));
        assert!((0..looks.len()).all(|k| !looks[..k].contains(&looks[k])));
        let looks = Look::of_all(["ris:2", "mis", "ris:4", "ris:8", "ris:16"].into_iter());
        let drawn: Vec<String> = looks.iter().map(|look| look.class() + &look.marker(0.0, 0.0)).collect();
        assert!((0..drawn.len()).all(|k| !drawn[..k].contains(&drawn[k])), "{drawn:?}");
    }

    #[test]
    fn look_is_independent_of_other_kinds() {
        let alone = Look::of_all(["patches"].into_iter());
        let beside = Look::of_all(["head:x", "mis", "patches"].into_iter());
        assert_eq!(alone[0], beside[2]);
    }
}
