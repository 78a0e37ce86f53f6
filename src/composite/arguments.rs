//! The command line of `composite`.

use std::path::PathBuf;

use clap::Args;
use headtail_render::{
    composite::MaskForm,
    scene::{MaterialSpec, UpAxis},
    spec::SamplerSpec,
};

use crate::{
    arguments::{MapArguments, Triple},
    given::{given, one_of},
    light::LightArguments,
};

const UP_AXES: [(UpAxis, &str, &str); 2] = [(UpAxis::Y, "y", "+Y"), (UpAxis::Z, "z", "+Z, as in Blender")];

/// Put a virtual object into a photograph.
/// Renders the object, the shadow that it casts and the light that it reflects onto its surroundings in one
/// pass.
#[derive(Args, Clone)]
#[command(after_help = "Examples:
  headtail view --env room.hdr --out out/room.exr
  headtail composite --photo out/room.exr --camera out/room.fspy --env room.hdr --scene spot.glb --material lambert --out out/composite
  headtail composite --photo desk.jpg --camera desk.fspy --env desk.hdr --env-rotate 40 --scene cup.glb --size 0.12 --move 0.1,0,-0.2 --preview --out out/cup
  headtail composite --photo wall.png --look-from 0,1.6,4 --look-at 0,1,0 --fov 40 --env room.hdr --scene room.glb --catcher Walls --out out/wall

DIR holds composite.png, composite.exr, layers.exr (layers object with alpha, shadow, light, photograph, for Nuke, Blender or Natron: \
object + (1 - object.A) (photograph x shadow + light)), mask.png, and composite.html with before and after under a slider. \
Ctrl-C writes the picture so far.")]
pub struct Arguments {
    /// Photograph. Default: the one in the .fspy file.
    /// OpenEXR or Radiance in the map's units, or PNG or JPEG.
    #[arg(long, value_name = "FILE", required_unless_present = "camera")]
    pub photo: Option<PathBuf>,
    /// Camera of the photograph, an fSpy project.
    #[arg(long, value_name = "FILE.fspy", conflicts_with = "look_from", required_unless_present = "look_from")]
    pub camera: Option<PathBuf>,
    /// The axis of the fSpy project that points up.
    #[arg(long, value_name = "AXIS", default_value = "z", requires = "camera", value_parser = one_of(&UP_AXES))]
    pub up: UpAxis,
    /// Camera position in metres, instead of a project.
    #[arg(long, value_name = "X,Y,Z", requires = "look_at", allow_hyphen_values = true)]
    pub look_from: Option<Triple>,
    /// The point that the camera looks at.
    #[arg(long, value_name = "X,Y,Z", requires = "look_from", allow_hyphen_values = true)]
    pub look_at: Option<Triple>,
    /// Vertical field of view in degrees, with --look-from.
    #[arg(long, value_name = "DEGREES", default_value_t = 40.0, conflicts_with = "camera")]
    pub fov: f32,
    /// Light: a built-in environment or a .hdr or .exr map.
    /// Built-in: overcast, window, studio, sunset.
    #[arg(long, value_name = "NAME|FILE", value_parser = given::<String>())]
    pub env: String,
    #[command(flatten)]
    pub map: MapArguments,
    #[command(flatten)]
    pub light: LightArguments,
    /// Object: a built-in scene or a glTF 2.0 file (.glb, .gltf).
    #[arg(long, value_name = "NAME|FILE", value_parser = given::<String>())]
    pub scene: String,
    /// Give the object one material.
    /// lambert[:albedo=A], ggx:alpha=A or ggx:alpha=LOW..HIGH.
    #[arg(long, value_name = "SPEC", value_parser = given::<MaterialSpec>())]
    pub material: Option<MaterialSpec>,
    /// Position of the centre of the object's underside, Y up.
    #[arg(long = "move", value_name = "X,Y,Z", default_value = "0,0,0", allow_hyphen_values = true)]
    pub place: Triple,
    /// Scale the object by a factor.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub scale: f32,
    /// Scale the object to this length of its longest edge.
    /// In the unit of the camera.
    #[arg(long, value_name = "LENGTH", conflicts_with = "scale")]
    pub size: Option<f32>,
    /// Turn the object around the vertical axis.
    /// Counter-clockwise from above.
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, allow_hyphen_values = true)]
    pub turn: f32,
    /// Shadow catcher: plane, or the name of a mesh of the scene.
    #[arg(long, value_name = "plane|MESH", default_value = "plane")]
    pub catcher: String,
    /// Point on the plane.
    #[arg(long, value_name = "X,Y,Z", default_value = "0,0,0", allow_hyphen_values = true)]
    pub plane_at: Triple,
    /// Normal of the plane.
    #[arg(long, value_name = "X,Y,Z", default_value = "0,1,0", allow_hyphen_values = true)]
    pub plane_normal: Triple,
    /// Sampler of directions, as in render. Here, auto is patches.
    #[arg(long, value_name = "SPEC", default_value = "auto", value_parser = given::<SamplerSpec>())]
    pub sampler: SamplerSpec,
    /// Estimator of the mask: control-variate, weights, ratio or paper.
    /// control-variate: unbiased, except where a --catcher shadows itself; weights: the same, noisier; ratio:
    /// bias of the order of 1 / spp; paper: the mean visibility, correct if the sampler is the exact product.
    #[arg(long, value_name = "FORM", default_value = "control-variate")]
    pub mask: MaskForm,
    /// Use one luminance mask for all channels.
    /// Shadows under a blue sky and a warm sun are coloured.
    #[arg(long)]
    pub grey_mask: bool,
    /// Maximum number of surfaces on a light path.
    /// From 2 on, the object reflects light onto the catcher, and reflects the catcher.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub depth: u32,
    /// Samples per pixel. Default: 64; 8 with --preview.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    pub spp: Option<u32>,
    /// Width of the composite in pixels.
    /// Default: that of the photograph; 1/4 of it with --preview.
    #[arg(long, value_parser = clap::value_parser!(u32).range(8..=16384))]
    pub width: Option<u32>,
    /// Factor from the photograph's values to the map's units.
    /// It applies before --env-scale. Default: 1 for OpenEXR and Radiance; for PNG and JPEG, the factor that
    /// gives them the brightness of the map in the same view.
    #[arg(long, value_name = "FACTOR")]
    pub gain: Option<f32>,
    /// Composite quickly: 1/4 of the width and few samples.
    #[arg(long)]
    pub preview: bool,
    /// Seed of the samples.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Print what was composited as a JSON object.
    #[arg(long)]
    pub json: bool,
    /// Threads to render with. Default: all cores.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Folder for the results.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}
