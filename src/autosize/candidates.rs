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
}

/// Something to be measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// What it is called.
    pub name: String,
    /// How it comes about.
    pub recipe: Recipe,
}

/// Heads that are tried, the likeliest first: sizes, modes, tails, with and without learned share, with compact emitters.
static HEADS: [HeadShape; 7] = [
    HeadShape { name: "head 8x64", settings: "head.bins = 8\nhead.hidden = 64" },
    HeadShape { name: "head 4x16", settings: "head.bins = 4\nhead.hidden = 16" },
    HeadShape {
        name: "head 4x32 autoregressive",
        settings: "head.bins = 4\nhead.hidden = 32\nhead.mode = 'autoregressive'",
    },
    HeadShape {
        name: "head 8x64 autoregressive",
        settings: "head.bins = 8\nhead.hidden = 64\nhead.mode = 'autoregressive'",
    },
    HeadShape { name: "head 8x64 row-column", settings: "head.bins = 8\nhead.hidden = 64\ntail = 'row-column'" },
    HeadShape { name: "head 8x64 alone", settings: "head.bins = 8\nhead.hidden = 64\nhead.selection = false" },
    HeadShape {
        name: "head 8x64 compact emitters",
        settings: "head.bins = 8\nhead.hidden = 64\ncompact_emitters = true",
    },
];

/// Steps that a head is trained for, from cheap to dear.
pub const STEPS: [usize; 3] = [250, 1000, 4000];

/// Samplers that need no file, on every surface.
const PLAIN: [&str; 10] =
    ["cosine", "mis", "mis2", "mis-comp", "ris:4", "ris:8", "patches", "patches:fine", "patches+vis", "ris:4:patches"];

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

/// The heads, trained for so many steps.
pub fn heads(steps: usize) -> Vec<Candidate> {
    let head = |shape: &'static HeadShape| Candidate {
        name: format!("{}, {steps} steps", shape.name),
        recipe: Recipe::Head(shape, steps),
    };
    HEADS.iter().map(head).collect()
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
