//! Candidate samplers, in order of increasing cost.

use headtail_render::{
    scene::MaterialSpec,
    spec::{Combiner, SamplerSpec, Visibility},
};

/// How a sampler is prepared.
#[derive(Clone, Debug, PartialEq)]
pub enum Recipe {
    /// No preparation: a SPEC.
    Plain(&'static str),
    /// A table of the product for diffuse surfaces; grids of normals and cells.
    Direct((usize, usize), (usize, usize)),
    /// A head: settings of its run, and number of training steps.
    Head(&'static HeadShape, usize),
    /// The table of such a head.
    Baked(&'static HeadShape, usize),
    /// Another SPEC that uses the file of another candidate.
    Form(SamplerSpec, Box<Recipe>),
}

impl Recipe {
    /// Returns the recipe that must be prepared first.
    pub fn base(&self) -> Option<Self> {
        match self {
            Self::Baked(shape, steps) => Some(Self::Head(shape, *steps)),
            Self::Form(_, base) => Some((**base).clone()),
            Self::Plain(_) | Self::Direct(..) | Self::Head(..) => None,
        }
    }

    /// Whether the sampler is a head or its table.
    pub fn is_of_head(&self) -> bool {
        matches!(self, Self::Head(..) | Self::Baked(..))
    }

    /// Whether there is preparation whose result a file holds.
    pub fn is_prepared(&self) -> bool {
        !matches!(self, Self::Plain(_))
    }
}

/// Name and settings of a head.
#[derive(Debug, PartialEq)]
pub struct HeadShape {
    /// Short name.
    pub name: &'static str,
    /// Settings over the fast preset, in TOML.
    pub settings: &'static str,
    /// The shape of which this one is a variant, with about the same time per sample; it is tried if that one
    /// advances.
    pub varies: Option<&'static str>,
    /// Whether its tail is a flow, which is fitted first.
    pub is_flow: bool,
    /// Whether it is trained over patches of sky, which are exact on diffuse surfaces.
    pub over_patches: bool,
}

impl HeadShape {
    const fn base(name: &'static str, settings: &'static str) -> Self {
        Self { name, settings, varies: None, is_flow: false, over_patches: false }
    }

    const fn varied(name: &'static str, settings: &'static str) -> Self {
        Self { varies: Some("head 8x64"), ..Self::base(name, settings) }
    }
}

/// A sampler to be measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Name.
    pub name: String,
    /// Preparation.
    pub recipe: Recipe,
}

/// Heads in order of increasing cost: one over patches, sizes and modes over the tail, then encoders, tails,
/// and one without a learned mixture weight.
pub static HEADS: [HeadShape; 11] = [
    HeadShape { over_patches: true, ..HeadShape::base("head+patches 4x16", "preset = 'over-patches'") },
    HeadShape::base("head 4x16", "head.bins = 4\nhead.hidden = 16"),
    HeadShape::base("head 4x32 autoregressive", "head.bins = 4\nhead.hidden = 32\nhead.mode = 'autoregressive'"),
    HeadShape::base("head 8x64", "head.bins = 8\nhead.hidden = 64"),
    HeadShape::base("head 8x64 autoregressive", "head.bins = 8\nhead.hidden = 64\nhead.mode = 'autoregressive'"),
    HeadShape::varied(
        "head 8x64 encoder 16",
        "head.bins = 8\nhead.hidden = 64\nhead.encoder = { hidden = 16, output = 16 }",
    ),
    HeadShape::varied(
        "head 8x64 encoder 64",
        "head.bins = 8\nhead.hidden = 64\nhead.encoder = { hidden = 64, output = 64 }",
    ),
    HeadShape::varied("head 8x64 row-column", "head.bins = 8\nhead.hidden = 64\ntail = 'row-column'"),
    HeadShape::varied("head 8x64 alone", "head.bins = 8\nhead.hidden = 64\nhead.share = false"),
    HeadShape {
        is_flow: true,
        ..HeadShape::varied("head 8x64 flow", "head.bins = 8\nhead.hidden = 64\ntail = 'flow'")
    },
    HeadShape {
        is_flow: true,
        ..HeadShape::varied(
            "head 8x64 flow alone",
            "head.bins = 8\nhead.hidden = 64\ntail = 'flow'\nhead.share = false",
        )
    },
];

/// Numbers of training steps, in increasing order.
pub const STEPS: [usize; 3] = [250, 1000, 4000];

/// Samplers without a file, for all surfaces.
const PLAIN: [&str; 19] = [
    "cosine",
    "emitter",
    "mis",
    "mis2",
    "mis-comp",
    "mis2-comp",
    "ris:4",
    "ris:8",
    "ris:4:mis-comp",
    "patches",
    "patches:fine",
    "patches+vis",
    "patches:fine+vis",
    "mis2:patches",
    "ris:4:patches",
    "split:4:mis-comp",
    "split:4:mis2-comp",
    "split:4:patches",
    "split:4:patches+vis",
];

/// Sizes of tables.
const TABLES: [((usize, usize), (usize, usize)); 4] =
    [((8, 16), (8, 8)), ((16, 32), (16, 16)), ((16, 32), (32, 32)), ((32, 64), (32, 32))];

/// Returns the samplers that need no preparation, in order of increasing cost.
pub fn plain() -> Vec<Candidate> {
    PLAIN.iter().map(|spec| Candidate { name: (*spec).to_owned(), recipe: Recipe::Plain(spec) }).collect()
}

/// Returns tables for diffuse surfaces, in order of increasing cost.
pub fn tables() -> Vec<Candidate> {
    let table = |&(normals, cells): &((usize, usize), (usize, usize))| Candidate {
        name: format!("direct {}x{} of {}x{}", normals.0, normals.1, cells.0, cells.1),
        recipe: Recipe::Direct(normals, cells),
    };
    TABLES.iter().map(table).collect()
}

/// Returns a head, trained for `steps` steps.
pub fn head(shape: &'static HeadShape, steps: usize) -> Candidate {
    Candidate { name: format!("{}, {steps} steps", shape.name), recipe: Recipe::Head(shape, steps) }
}

/// The table of a trained head.
pub fn baked(shape: &'static HeadShape, steps: usize) -> Candidate {
    Candidate { name: format!("bake of {}, {steps} steps", shape.name), recipe: Recipe::Baked(shape, steps) }
}

/// Returns other samplers that use the file of a candidate: with several directions, with visibility where
/// the source supports it, and with both. Empty for candidates without a file, and for these samplers
/// themselves.
pub fn forms(name: &str, recipe: &Recipe, spec: &SamplerSpec) -> Vec<Candidate> {
    if !spec.has_pdf() || spec.path().is_none() {
        return Vec::new();
    }
    let split = |spec: SamplerSpec| spec.combined(Combiner::Split(DIRECTIONS));
    let with_visibility = |spec: SamplerSpec| spec.with_visibility(Visibility::Learned);
    let forms = [
        ("split:4", split(spec.clone())),
        ("+vis", with_visibility(spec.clone())),
        ("split:4 +vis", with_visibility(spec.clone()).and_then(split)),
    ];
    let candidate = |(form, spec): (&str, headtail_render::Result<SamplerSpec>)| {
        Some(Candidate { name: format!("{form}, {name}"), recipe: Recipe::Form(spec.ok()?, Box::new(recipe.clone())) })
    };
    forms.into_iter().filter_map(candidate).collect()
}

/// Directions per surface point of samplers with several; more do not pay.
const DIRECTIONS: u32 = 4;

/// Whether a sampler draws one direction per surface point.
pub fn draws_one(spec: &SamplerSpec) -> bool {
    !matches!(spec.combiner(), Combiner::Split(2..))
}

/// Material that heads are trained for.
#[derive(Clone, Debug)]
pub struct HeadMaterial(pub MaterialSpec);

impl HeadMaterial {
    /// Returns the material of a scene with one analytic or measured material; for others, diffuse or a range
    /// of widths.
    pub fn of(material: Option<&MaterialSpec>, diffuse: bool) -> Self {
        Self(match material {
            Some(MaterialSpec::Ggx { alpha, .. }) => MaterialSpec::ggx(alpha.low, alpha.high),
            Some(MaterialSpec::Lambert { .. }) => MaterialSpec::LAMBERT,
            Some(measured @ MaterialSpec::Measured { .. }) => measured.clone(),
            None if diffuse => MaterialSpec::LAMBERT,
            None | Some(MaterialSpec::Neural(_)) => MaterialSpec::ggx(0.1, 0.8),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_candidate_names_are_specs() {
        for Candidate { name, .. } in plain() {
            assert_eq!(name.parse::<SamplerSpec>().unwrap().to_string(), name);
        }
    }

    #[test]
    fn forms_use_the_file_of_their_base() {
        let texts = |text: &str| -> Vec<String> {
            let recipe = Recipe::Direct((8, 16), (8, 8));
            let forms = forms("table", &recipe, &text.parse().unwrap());
            let text = |form: Candidate| {
                assert_eq!(form.recipe.base().as_ref(), Some(&recipe));
                let Recipe::Form(spec, _) = form.recipe else { panic!("{}", form.name) };
                // The text names the same sampler.
                assert_eq!(spec.to_string().parse::<SamplerSpec>().unwrap(), spec);
                spec.to_string()
            };
            forms.into_iter().map(text).collect()
        };
        assert_eq!(texts("direct:a"), ["split:4:direct:a"]);
        let over = ["split:4:head+patches:a", "head+patches+vis:a", "split:4:head+patches+vis:a"];
        assert_eq!(texts("head+patches:a"), over);
        assert_eq!(texts("head+mis:a"), ["split:4:head+mis:a"]);
        assert!(texts("patches").is_empty() && texts("split:4:direct:a").is_empty());
        for (text, one) in [("mis", true), ("ris:4", true), ("patches+vis", true), ("split:4:mis", false)] {
            assert_eq!(draws_one(&text.parse().unwrap()), one, "{text}");
        }
        assert!(!draws_one(&"split:4:patches+vis".parse().unwrap()));
    }

    #[test]
    fn heads_are_trained_for_the_material_that_is_seen() {
        let of = |text: &str| HeadMaterial::of(Some(&text.parse().unwrap()), true).0.to_string();
        assert_eq!(of("ggx:alpha=0.2,f0=0.5"), "ggx:alpha=0.2");
        assert_eq!(of("lambert:albedo=0.5"), "lambert");
        assert_eq!(HeadMaterial::of(None, false).0.to_string(), "ggx:alpha=0.1..0.8");
    }
}
