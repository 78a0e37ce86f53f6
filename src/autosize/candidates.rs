//! Samplers that could be chosen, from cheap to dear.

use headtail_render::scene::MaterialSpec;
use headtail_train::Material;

/// How a sampler comes about.
#[derive(Clone, Debug, PartialEq)]
pub enum Recipe {
    /// By its SPEC alone.
    Plain(&'static str),
    /// A table of the product for diffuse surfaces: normals, cells.
    Direct((usize, usize), (usize, usize)),
    /// A head: settings of its run, and for how many steps it is trained.
    Head(&'static HeadShape, usize),
    /// The table of such a head.
    Baked(&'static HeadShape, usize),
}

/// A head's name and what its run sets.
#[derive(Debug, PartialEq)]
pub struct HeadShape {
    /// A short name.
    pub name: &'static str,
    /// Settings over the fast preset, in TOML.
    pub settings: &'static str,
    /// The shape that this one varies in one thing, with about its time per sample; it is tried where that one gets on.
    pub varies: Option<&'static str>,
    /// Whether its tail is fitted first.
    pub is_flow: bool,
}

impl HeadShape {
    const fn base(name: &'static str, settings: &'static str) -> Self {
        Self { name, settings, varies: None, is_flow: false }
    }

    const fn varied(name: &'static str, settings: &'static str) -> Self {
        Self { name, settings, varies: Some("head 8x64"), is_flow: false }
    }
}

/// Something to be measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// What it is called.
    pub name: String,
    /// How it comes about.
    pub recipe: Recipe,
}

/// Heads that are tried, from cheap to dear: sizes and modes, then encoders, tails, without learned share, with compact emitters.
pub static HEADS: [HeadShape; 11] = [
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
    HeadShape::varied("head 8x64 alone", "head.bins = 8\nhead.hidden = 64\nhead.selection = false"),
    HeadShape::varied("head 8x64 compact emitters", "head.bins = 8\nhead.hidden = 64\ncompact_emitters = true"),
    HeadShape {
        is_flow: true,
        ..HeadShape::varied("head 8x64 flow", "head.bins = 8\nhead.hidden = 64\ntail = 'flow'")
    },
    HeadShape {
        is_flow: true,
        ..HeadShape::varied(
            "head 8x64 flow alone",
            "head.bins = 8\nhead.hidden = 64\ntail = 'flow'\nhead.selection = false",
        )
    },
];

/// Steps that a head is trained for, from cheap to dear.
pub const STEPS: [usize; 3] = [250, 1000, 4000];

/// Samplers that need no file, on every surface.
const PLAIN: [&str; 17] = [
    "cosine",
    "emitter",
    "mis",
    "mis2",
    "mis-comp",
    "ris:4",
    "ris:8",
    "patches",
    "patches:fine",
    "patches+vis",
    "patches:fine+vis",
    "mis2:patches",
    "ris:4:patches",
    "split:4:mis",
    "split:4:mis-comp",
    "split:4:patches",
    "split:4:patches+vis",
];

/// Tables of several sizes.
const TABLES: [((usize, usize), (usize, usize)); 4] =
    [((8, 16), (8, 8)), ((16, 32), (16, 16)), ((16, 32), (32, 32)), ((32, 64), (32, 32))];

/// Everything that is ready at once, from cheap to dear.
pub fn plain() -> Vec<Candidate> {
    PLAIN.iter().map(|spec| Candidate { name: (*spec).to_owned(), recipe: Recipe::Plain(spec) }).collect()
}

/// Tables for diffuse surfaces, from cheap to dear.
pub fn tables() -> Vec<Candidate> {
    let table = |&(normals, cells): &((usize, usize), (usize, usize))| Candidate {
        name: format!("direct {}x{} of {}x{}", normals.0, normals.1, cells.0, cells.1),
        recipe: Recipe::Direct(normals, cells),
    };
    TABLES.iter().map(table).collect()
}

/// A head, trained for so many steps.
pub fn head(shape: &'static HeadShape, steps: usize) -> Candidate {
    Candidate { name: format!("{}, {steps} steps", shape.name), recipe: Recipe::Head(shape, steps) }
}

/// The table of a trained head.
pub fn baked(shape: &'static HeadShape, steps: usize) -> Candidate {
    Candidate { name: format!("bake of {}, {steps} steps", shape.name), recipe: Recipe::Baked(shape, steps) }
}

/// What heads are trained for.
#[derive(Clone, Copy, Debug)]
pub struct HeadMaterial(pub Material);

impl HeadMaterial {
    /// For a scene of one analytic material, that one; for others, diffuse or a range of widths.
    pub fn of(material: Option<&MaterialSpec>, diffuse: bool) -> Self {
        Self(match material {
            Some(MaterialSpec::Ggx { alpha, .. }) => Material::Ggx { low: alpha.low, high: alpha.high },
            Some(MaterialSpec::Lambert { .. }) => Material::Lambert,
            None if diffuse => Material::Lambert,
            None | Some(MaterialSpec::Measured { .. } | MaterialSpec::Neural(_)) => {
                Material::Ggx { low: 0.1, high: 0.8 }
            }
        })
    }
}
