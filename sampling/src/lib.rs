//! Importance sampling of environment light: samplers, estimators and their files, for embedding in a
//! renderer.
//!
//! Samplers map uniform points to directions with a density close to light x BRDF x cosine, as columns of
//! SIMD lanes. This crate has neither scenes nor rays: the renderer that embeds it traces visibility.
//!
//! ```
//! use std::sync::Arc;
//!
//! use glam::{Vec3, Vec3A};
//! use headtail_sampling::{
//!     Arena, Contributions, Environment, Lambert, PointSet, Points, Result, SamplerSpec, ShadingPoint, Tile,
//! };
//!
//! fn render(is_visible: impl Fn(Vec3A, Vec3A) -> bool) -> Result<Vec3A> {
//!     let map = Arc::new(Environment::open("sunset")?); // or a file
//!     let estimator = "split:4:patches".parse::<SamplerSpec>()?.build(&map)?;
//!     let (n, surface) = (Vec3A::Y, Lambert { albedo: Vec3::splat(0.5) }.into());
//!     let hit = ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo: n, surface };
//!     let tile = Tile::of(&[hit; 64]); // hits of 64 pixels, here all the same
//!     let (mut found, mut sum, arena) = (Contributions::default(), Vec3A::ZERO, Arena::default());
//!     for sample in 0..16 {
//!         found.clear();
//!         estimator.propose(&tile.rows(), &Points::new(PointSet::Sobol, 0).at_sample(sample), &mut found, &arena);
//!         for ((&row, &wi), &radiance) in found.places().iter().zip(found.wi()).zip(found.radiance()) {
//!             if is_visible(tile.point(row.into()).p, wi) {
//!                 sum += radiance;
//!             }
//!         }
//!     }
//!     Ok(sum / (16.0 * 64.0))
//! }
//!
//! let (open, east) = (render(|_, _| true)?, render(|_, wi| wi.x > 0.0)?);
//! assert!(east.x > 0.0 && east.x < open.x);
//! # Ok::<(), headtail_sampling::Error>(())
//! ```
//!
//! What a renderer needs is at the root. Modules are public for the other crates of this project, and may
//! change with any version:
//!
//! | file | concept |
//! | --- | --- |
//! | `environment/`, `image/` | environment maps; reading their files |
//! | `tail/` | tail warps t: Y -> X |
//! | `spline/`, `head/`, `export/` | splines; inference of heads; the exported file |
//! | `bake/` | densities over Y tabulated over normals |
//! | `patches/` | product sampling in closed form |
//! | `visibility/` | visibility learned from shadow rays, and the resulting weights |
//! | `brdf/` | BRDFs and BRDF sampling |
//! | `sampler/`, `estimator/` | samplers with a pdf; estimators over them |
//! | `spec/` | samplers by name |
//! | `rival/` | samplers from the literature, for comparison |
//! | `points/`, `random.rs` | sample points of renderings; random streams of training and tests |
//! | `tile.rs`, `batch.rs`, `one_point.rs` | shading points as columns, as flat lists, and single points |
//! | `columns.rs`, `simd.rs` | columns of samples and their arena; functions over SIMD lanes |
//! | `linear.rs`, `discrete.rs`, `float16.rs` | affine layers; inversion of running sums; half precision |
//! | `latlong.rs`, `frame.rs` | directions and X; the frame around a normal |
//! | `color.rs`, `morton.rs` | luminance and the tone curve; the Morton curve |
//! | `flat.rs` | samplers as named arrays, for other devices |
//! | `portals/` | portals of rooms, and the light that comes through them |
//! | `file.rs`, `tensor_file.rs`, `path_text.rs` | files; safetensors; paths within text |
//! | `memory.rs`, `large.rs` | memory limits; large tables |
//! | `remark.rs`, `timings.rs` | notes about files; time by stage |
//! | `parallel.rs` | loops over threads |
#[doc(hidden)]
pub mod bake;
pub mod batch;
#[doc(hidden)]
pub mod brdf;
#[doc(hidden)]
pub mod color;
#[doc(hidden)]
pub mod columns;
#[doc(hidden)]
pub mod discrete;
#[doc(hidden)]
pub mod environment;
#[doc(hidden)]
pub mod error;
#[doc(hidden)]
pub mod estimator;
#[doc(hidden)]
pub mod export;
#[doc(hidden)]
pub mod file;
#[doc(hidden)]
pub mod flat;
pub(crate) mod float16;
#[doc(hidden)]
pub mod frame;
#[doc(hidden)]
pub mod head;
#[doc(hidden)]
pub mod image;
#[doc(hidden)]
pub mod large;
#[doc(hidden)]
pub mod latlong;
pub(crate) mod linear;
#[doc(hidden)]
pub mod memory;
#[doc(hidden)]
pub mod morton;
#[doc(hidden)]
pub mod one_point;
mod parallel;
#[doc(hidden)]
pub mod patches;
#[doc(hidden)]
pub mod path_text;
#[doc(hidden)]
pub mod points;
#[doc(hidden)]
pub mod portals;
#[doc(hidden)]
pub mod random;
#[doc(hidden)]
pub mod remark;
#[doc(hidden)]
pub mod rival;
#[doc(hidden)]
pub mod sampler;
#[doc(hidden)]
pub mod simd;
#[doc(hidden)]
pub mod spec;
#[doc(hidden)]
pub mod spline;
#[doc(hidden)]
pub mod tail;
#[doc(hidden)]
pub mod tensor_file;
#[doc(hidden)]
pub mod tile;
#[doc(hidden)]
pub mod timings;
#[doc(hidden)]
pub mod visibility;

pub use brdf::{
    Brdf, BrdfTable, Ggx, Kernel, Lambert, LobeMixture, Lobes, MAX_PARAMETERS, MetallicRoughness, NeuralTexture,
    OfKernel, Surface, Surfaces,
};
pub use color::luminance;
pub use columns::{Arena, Columns};
pub use environment::{BUILT_IN_NAMES, Environment, MapSpec, built_in};
pub use error::{Error, Result};
pub use estimator::{
    Contributions, Estimator, LearnedVisibility, LearningSession, Ris, SingleSample, Split, TwoSampleMis, ViewGeometry,
};
pub use export::{ExportedSampler, Intermediate, flat_exported, flat_patches, flat_portals};
pub use flat::{FlatArray, FlatNumbers};
pub use frame::Frame;
pub use head::Head;
pub use image::{Image, MapLayout};
pub use one_point::OnePoint;
pub use patches::{Detail, PatchSampler};
pub use points::{Dimension, PointSet, Points};
pub use portals::{Portal, PortalSampler};
pub use remark::Remark;
pub use sampler::{
    AtPoint, BrdfSampler, Coverage, Covering, Direction, Draws, EmitterSampler, EnvironmentLight, IntermediateDensity,
    OneSampleMis, ProductSampler, Sampler, prepared,
};
pub use simd::{LANES, Lanes};
pub use spec::{BuildContext, Combiner, Companion, SamplerSpec, SceneContext, Source, Visibility};
pub use tail::{Tail, TailKind, TailWarp};
pub use tile::{MAX_POINTS, Rows, ShadingPoint, Tile};
pub use visibility::{CacheSize, PrecomputedVisibility, SceneVisibility};
