//! The command line of `autosize`.

use std::path::PathBuf;

use clap::Args;
use headtail_render::scene::MaterialSpec;

use crate::given::given;

/// Find the smallest sampler that is good enough for a scene under a map.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail autosize --env room.hdr --scene temple --out out/room
  headtail autosize --env sky.exr --scene spot.glb --ground --material ggx:alpha=0.2 --prepare-seconds 60 --render-seconds 600 --out out/sky

Candidates, in the order of their cost, are BRDF sampling, MIS in its forms, resampling, patches, tables of several sizes, trained heads of several sizes, one of them over patches; \
the best are also tried with several directions per point or learned visibility. Each is measured until it is decided. Errors are those after --render-seconds, preparation included. \
A head is trained only if a perfect head with its sampling time would win. DIR/autosize.html shows the choice; \
DIR/winner and DIR/cheapest name the samplers as --sampler takes them, with their files beside them.")]
pub struct Arguments {
    /// Built-in environment (overcast, window, studio, sunset) or map.
    /// Maps are Radiance .hdr or OpenEXR files.
    #[arg(long, value_name = "NAME|FILE", value_parser = given::<String>())]
    pub(super) env: String,
    /// Built-in scene or glTF 2.0 file.
    #[arg(long, value_name = "NAME|FILE", value_parser = given::<String>())]
    pub(super) scene: String,
    /// Give every surface one material, as `render` does.
    /// Default: the scene's materials.
    #[arg(long, value_name = "SPEC", value_parser = given::<MaterialSpec>())]
    pub(super) material: Option<MaterialSpec>,
    /// Put a grey diffuse plane under the scene.
    #[arg(long)]
    pub(super) ground: bool,
    /// Width of the trial pictures in pixels.
    #[arg(long, default_value_t = 96, value_parser = clap::value_parser!(u32).range(8..=4096))]
    pub(super) width: u32,
    /// Height of the trial pictures in pixels.
    #[arg(long, default_value_t = 72, value_parser = clap::value_parser!(u32).range(8..=4096))]
    pub(super) height: u32,
    /// Maximum time to prepare a sampler.
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0)]
    pub(super) prepare_seconds: f64,
    /// Time for preparation and rendering together.
    /// The error after this time counts.
    #[arg(long, value_name = "SECONDS", default_value_t = 60.0)]
    pub(super) render_seconds: f64,
    /// Measure every candidate to the end and drop none.
    /// Shows the cost of the usual shortcuts.
    #[arg(long)]
    pub(super) exhaustive: bool,
    /// Print the figures of all candidates as an array of JSON objects.
    /// The best comes first.
    #[arg(long)]
    pub(super) json: bool,
    /// Folder for the results.
    #[arg(long, value_name = "DIR")]
    pub(super) out: PathBuf,
}
