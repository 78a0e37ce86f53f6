//! headtail's samplers as shaders: WGSL, written once per concept, and translated by `naga`.
//!
//! A shader reads two storage buffers, `headtail_floats` (by fours) and `headtail_integers`: the concatenated arrays of
//! a sampler. Their offsets are constants of the shader, and in the layout.
//!
//! | file in `wgsl/` | concept |
//! | --- | --- |
//! | `square.wgsl` | directions and points of X, shared functions |
//! | `prepared.wgsl` | what callers call: samplers at a shading point |
//! | `hierarchical.wgsl`, `row_column.wgsl`, `flow.wgsl` | tails |
//! | `cells.wgsl` | the cells of a map |
//! | `brdf.wgsl` | diffuse and microfacet surfaces |
//! | `fitted.wgsl`, `measured.wgsl`, `neural.wgsl` | networks of measured and neural materials |
//! | `patches.wgsl`, `unoccluded.wgsl`, `table.wgsl` | patches and their weights; tables |
//! | `network.wgsl`, `rational_quadratic.wgsl`, `spline.wgsl`, `head.wgsl` | heads |
//! | `tail_alone.wgsl`, `portals.wgsl`, `patches_alone.wgsl`, `head_over_tail.wgsl`, `head_over_patches.wgsl` | complete samplers |
//! | `example.wgsl` | a compute shader as an example |
//! | `train/` | gradients of heads, see [`training`] |

#[cfg(feature = "gpu")]
pub mod gpu;
mod network;
pub mod training;

use std::fmt::Write;

use headtail_sampling::{
    Error, Result,
    flat::{FlatArray, FlatNumbers},
};
use naga::{
    ShaderStage,
    back::{glsl, hlsl, msl, spv},
    valid::{Capabilities, ModuleInfo, ValidationFlags, Validator},
};

/// A target language.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// The WebGPU shading language, in which the shaders are written.
    Wgsl,
    /// GLSL for OpenGL 4.3, as a compute shader.
    Glsl,
    /// HLSL for Direct3D, shader model 5.1.
    Hlsl,
    /// Metal shading language 2.0.
    Msl,
    /// SPIR-V 1.3 for Vulkan.
    Spirv,
}

impl Target {
    /// All targets.
    pub const ALL: [Self; 5] = [Self::Wgsl, Self::Glsl, Self::Hlsl, Self::Msl, Self::Spirv];

    /// Returns the name, and the extension of files.
    pub const fn name_and_extension(self) -> (&'static str, &'static str) {
        match self {
            Self::Wgsl => ("wgsl", "wgsl"),
            Self::Glsl => ("glsl", "comp"),
            Self::Hlsl => ("hlsl", "hlsl"),
            Self::Msl => ("msl", "metal"),
            Self::Spirv => ("spirv", "spv"),
        }
    }
}

/// A sampler as a shader with its data.
#[derive(Clone, Debug)]
pub struct Shader {
    /// The WGSL source.
    pub source: String,
    /// The content of `headtail_floats`.
    pub floats: Vec<f32>,
    /// The content of `headtail_integers`.
    pub integers: Vec<u32>,
    /// JSON: for each array its buffer, its offset (in elements), and its shape.
    pub layout: String,
}

/// Functions of diffuse and microfacet surfaces, over those of [`Shader::functions`].
pub const BRDF: &str = include_str!("../wgsl/brdf.wgsl");
/// Functions of measured and neural materials, over those of [`BRDF`] and a function `headtail_number` that reads their numbers,
/// [`FlatBrdf`](headtail_sampling::brdf::FlatBrdf).
pub const FITTED: [&str; 3] =
    [include_str!("../wgsl/fitted.wgsl"), include_str!("../wgsl/measured.wgsl"), include_str!("../wgsl/neural.wgsl")];
/// Weights of patches without visibility.
pub const UNOCCLUDED: &str = include_str!("../wgsl/unoccluded.wgsl");
const SQUARE: &str = include_str!("../wgsl/square.wgsl");
const PREPARED: &str = include_str!("../wgsl/prepared.wgsl");
const TAIL_ALONE: &str = include_str!("../wgsl/tail_alone.wgsl");
const CELLS: &str = include_str!("../wgsl/cells.wgsl");
const HIERARCHICAL: &str = include_str!("../wgsl/hierarchical.wgsl");
const ROW_COLUMN: &str = include_str!("../wgsl/row_column.wgsl");
const FLOW: &str = include_str!("../wgsl/flow.wgsl");
const PATCHES: &str = include_str!("../wgsl/patches.wgsl");
const PATCHES_ALONE: &str = include_str!("../wgsl/patches_alone.wgsl");
const PORTALS: &str = include_str!("../wgsl/portals.wgsl");
const TABLE: &str = include_str!("../wgsl/table.wgsl");
const NETWORK: &str = include_str!("../wgsl/network.wgsl");
const RATIONAL_QUADRATIC: &str = include_str!("../wgsl/rational_quadratic.wgsl");
const SPLINE: &str = include_str!("../wgsl/spline.wgsl");
const HEAD: &str = include_str!("../wgsl/head.wgsl");
const HEAD_OVER_TAIL: &str = include_str!("../wgsl/head_over_tail.wgsl");
const HEAD_OVER_PATCHES: &str = include_str!("../wgsl/head_over_patches.wgsl");
const EXAMPLE: &str = include_str!("../wgsl/example.wgsl");

impl Shader {
    /// Builds the shader of a sampler's arrays (see [`headtail_sampling::export::flat_patches`],
    /// [`headtail_sampling::export::flat_exported`], [`headtail_sampling::export::flat_portals`] and, for emitter sampling,
    /// [`headtail_sampling::tail::Tail::flat`]), with an example of use.
    ///
    /// # Errors
    /// If the arrays are not those of a sampler, or hold more numbers than a device can address.
    pub fn new(arrays: &[FlatArray]) -> Result<Self> {
        if arrays.is_empty() {
            return Err(missing("tail.nodes"));
        }
        let mut shader = Self::functions(arrays, UNOCCLUDED)?;
        shader.append(&[EXAMPLE]);
        Ok(shader)
    }

    /// Returns [`Self::new`] without the example. No arrays give the functions that all samplers share. `weights` is the WGSL
    /// of the weights of patches: [`UNOCCLUDED`], or the same functions over learned visibility.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn functions(arrays: &[FlatArray], weights: &str) -> Result<Self> {
        let tiled = network::tiled(arrays)?;
        let others = arrays.iter().filter(|array| tiled.iter().all(|own| own.name != array.name));
        let mut shader = Self::of_arrays(others.chain(&tiled))?;
        if arrays.is_empty() {
            shader.append(&[SQUARE]);
            return Ok(shader);
        }
        let mut constant = |name: &str, value| shader.define(&format!("HEADTAIL_{}", name.to_uppercase()), value);
        let tail = tail_concepts(arrays, &mut constant)?;
        let concepts = density_concepts(arrays, &mut constant)?;
        shader.append(&[&[SQUARE, PREPARED, weights][..], &tail, &concepts].concat());
        Ok(shader)
    }

    /// Builds a shader of training that draws targets through a tail, and through patches where the arrays have them;
    /// `sizes` are the constants of `targets.wgsl`. Its entry point is `place_strata`. With an array `light.cells`, the
    /// density of the light over X at the centres of a table's cells (multiples of 256 rows and columns), they are
    /// `tabulate`, `sum_rows` and `place_tabulated`.
    ///
    /// # Errors
    /// If the arrays are not those of a tail, or hold more numbers than a device can address.
    pub fn of_targets(arrays: &[FlatArray], sizes: [usize; training::TARGET_SIZES.len()], alpha: f32) -> Result<Self> {
        let mut shader = Self::of_arrays(arrays)?;
        let mut constant = |name: &str, value| shader.define(&format!("HEADTAIL_{}", name.to_uppercase()), value);
        let tail = tail_concepts(arrays, &mut constant)?;
        let mut points = training::STRATA;
        if let Ok(table) = shape_of(arrays, "light.cells") {
            points = training::TABULATED;
            shader.define("TABLE_ROWS", table[0]);
            shader.define("TABLE_COLUMNS", table[1]);
        }
        for (name, value) in training::TARGET_SIZES.into_iter().zip(sizes) {
            shader.define(name, value);
        }
        // Writing to a string cannot fail.
        let _ = writeln!(shader.source, "const ALPHA: f32 = {alpha:?};");
        let square = if shape_of(arrays, "patches.clusters").is_ok() {
            &[PREPARED, UNOCCLUDED, PATCHES, PATCHES_ALONE, training::IN_PATCHES][..]
        } else if let Ok(nodes) = shape_of(arrays, "light.nodes") {
            shader.define("HEADTAIL_WIDTH", nodes[1]);
            shader.define("HEADTAIL_ROWS", nodes[0] - 1);
            &[CELLS, training::INEXACT_TAIL, training::IN_TAIL][..]
        } else {
            &[training::EXACT_TAIL, training::IN_TAIL]
        };
        let surface = match shape_of(arrays, "material.numbers") {
            Ok(_) => [&FITTED[..], &[training::FITTED_SURFACE]].concat(),
            Err(_) => vec![training::ANALYTIC_SURFACE],
        };
        shader.append(&[&[SQUARE][..], &tail, square, &[BRDF], &surface, &training::TARGETS, &[points]].concat());
        Ok(shader)
    }

    /// Returns the bindings of the arrays and the constants of their places, without functions.
    fn of_arrays<'a>(arrays: impl IntoIterator<Item = &'a FlatArray>) -> Result<Self> {
        let (floats, integers, mut layout) = (Vec::new(), Vec::new(), serde_json::Map::new());
        let source = "@group(0) @binding(0) var<storage, read> headtail_floats: array<vec4<f32>>;\n\
                      @group(0) @binding(1) var<storage, read> headtail_integers: array<u32>;\n\n";
        let mut shader = Self { source: source.into(), floats, integers, layout: String::new() };
        for FlatArray { name, shape, numbers } in arrays {
            let (buffer, start) = match numbers {
                FlatNumbers::Floats(numbers) => ("headtail_floats", append(&mut shader.floats, numbers)),
                FlatNumbers::Integers(numbers) => ("headtail_integers", append(&mut shader.integers, numbers)),
            };
            shader.define(&format!("HEADTAIL_{}", name.to_uppercase().replace('.', "_")), start);
            layout.insert((*name).into(), serde_json::json!({ "buffer": buffer, "start": start, "shape": shape }));
        }
        if shader.floats.len().max(shader.integers.len()) > u32::MAX as usize / 4 {
            return Err(Error::argument("sampler", "holds more numbers than a device can address"));
        }
        shader.layout = serde_json::to_string_pretty(&layout).unwrap_or_default();
        Ok(shader)
    }

    fn define(&mut self, name: &str, value: usize) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.source, "const {name}: u32 = {value}u;");
    }

    fn append(&mut self, parts: &[&str]) {
        for part in parts {
            self.source.push('\n');
            self.source.push_str(part);
        }
    }

    /// Returns the shader in a language; text is UTF-8. Loops are not counted a second time, as they are for shaders that may not end.
    ///
    /// # Errors
    /// If `naga` rejects the shader or cannot translate it.
    pub fn translate(&self, target: Target) -> Result<Vec<u8>> {
        let refused = |reason: String| Error::argument(format!("shader for {}", target.name_and_extension().0), reason);
        let module =
            naga::front::wgsl::parse_str(&self.source).map_err(|error| refused(error.emit_to_string(&self.source)))?;
        let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
        let info = validator.validate(&module).map_err(|error| refused(error.emit_to_string(&self.source)))?;
        let text = match target {
            Target::Wgsl => self.source.clone(),
            Target::Glsl => to_glsl(&module, &info).map_err(refused)?,
            Target::Hlsl => to_hlsl(&module, &info).map_err(refused)?,
            Target::Msl => {
                // Shaders write workgroup memory before they read it.
                let options = msl::Options {
                    lang_version: (2, 0),
                    force_loop_bounding: false,
                    zero_initialize_workgroup_memory: false,
                    ..Default::default()
                };
                let written = msl::write_string(&module, &info, &options, &Default::default());
                written.map_err(|error| refused(error.to_string()))?.0
            }
            Target::Spirv => {
                let options = spv::Options { lang_version: (1, 3), force_loop_bounding: false, ..Default::default() };
                let words =
                    spv::write_vec(&module, &info, &options, None).map_err(|error| refused(error.to_string()))?;
                return Ok(words.into_iter().flat_map(u32::to_le_bytes).collect());
            }
        };
        Ok(text.into_bytes())
    }
}

fn to_glsl(module: &naga::Module, info: &ModuleInfo) -> std::result::Result<String, String> {
    let options = glsl::Options { version: glsl::Version::Desktop(430), ..Default::default() };
    let pipeline = glsl::PipelineOptions {
        shader_stage: ShaderStage::Compute,
        entry_point: "headtail_draw".into(),
        multiview: None,
    };
    let mut text = String::new();
    let writer = glsl::Writer::new(&mut text, module, info, &options, &pipeline, Default::default());
    writer.and_then(|mut writer| writer.write()).map_err(|error| error.to_string())?;
    Ok(text)
}

fn to_hlsl(module: &naga::Module, info: &ModuleInfo) -> std::result::Result<String, String> {
    let options = hlsl::Options { force_loop_bounding: false, ..Default::default() };
    let pipeline = hlsl::PipelineOptions::default();
    let mut text = String::new();
    hlsl::Writer::new(&mut text, &options, &pipeline).write(module, info, None).map_err(|error| error.to_string())?;
    Ok(text)
}

/// Appends numbers, and zeros up to whole tiles, and returns their offset.
fn append<T: Copy + Default>(all: &mut Vec<T>, numbers: &[T]) -> usize {
    let start = all.len();
    all.extend_from_slice(numbers);
    all.resize(all.len().next_multiple_of(network::TILE), T::default());
    start
}

/// Returns the shaders of a tail and of its cells, and defines their sizes.
fn tail_concepts(arrays: &[FlatArray], constant: &mut impl FnMut(&str, usize)) -> Result<Vec<&'static str>> {
    if let Ok(cells) = shape_of(arrays, "tail.cells") {
        constant("side", cells[0].isqrt());
        return Ok(vec![FLOW]);
    }
    // The map's columns of texels and rows of cells.
    let ([width, rows], own) = match integers_of(arrays, "tail.shape") {
        Ok(shape) => ([shape[0] as usize, shape[1] as usize], ROW_COLUMN),
        Err(_) => {
            let nodes = shape_of(arrays, "tail.nodes")?;
            constant("levels", shape_of(arrays, "tail.levels")?[0]);
            ([nodes[1], nodes[0] - 1], HIERARCHICAL)
        }
    };
    constant("width", width);
    constant("rows", rows);
    Ok(vec![CELLS, own])
}

/// Returns the shaders of a density over Y, and defines their sizes.
fn density_concepts(arrays: &[FlatArray], constant: &mut impl FnMut(&str, usize)) -> Result<Vec<&'static str>> {
    if let Ok(table) = shape_of(arrays, "table.along") {
        for (name, &count) in ["polar", "azimuth"].into_iter().zip(integers_of(arrays, "table.shape")?) {
            constant(name, count as usize);
        }
        constant("table_rows", table[1]);
        constant("table_columns", table[2]);
        return Ok(vec![TABLE]);
    }
    if let Ok(portals) = shape_of(arrays, "portals.rectangles") {
        constant("openings", portals[0]);
        constant("portal_pixels", shape_of(arrays, "portals.sums")?[1] - 1);
        return Ok(vec![PORTALS]);
    }
    let patches = shape_of(arrays, "patches.clusters");
    let Ok(layers) = integers_of(arrays, "head.layers") else {
        return Ok(if patches.is_ok() { vec![PATCHES, PATCHES_ALONE] } else { vec![TAIL_ALONE] });
    };
    for (name, value) in head_constants(layers, integers_of(arrays, "head.shape")?)? {
        constant(name, value);
    }
    Ok(match patches {
        Ok(_) => vec![NETWORK, RATIONAL_QUADRATIC, SPLINE, HEAD, PATCHES, HEAD_OVER_PATCHES],
        Err(_) => vec![NETWORK, RATIONAL_QUADRATIC, SPLINE, HEAD, HEAD_OVER_TAIL],
    })
}

/// Returns the sizes of a head's networks, and the layout of its intermediate values in one list: network
/// inputs (followed by two features), two rows of hidden values that layers alternate between, logits, and what both
/// networks make of a condition. Layers write whole tiles; what is too much is 0, and overwritten by what belongs there.
fn head_constants(layers: &[u32], shape: &[u32]) -> Result<Vec<(&'static str, usize)>> {
    let &[condition, coupled, encoder, elevation, azimuth, mixture_weight, elevation_bins, azimuth_bins] = shape else {
        return Err(missing("head.shape"));
    };
    let outputs: Vec<usize> = layers.chunks_exact(4).map(|layer| layer[1] as usize).collect();
    let of_layer = |layer: u32| outputs.get(layer as usize).copied().unwrap_or(0);
    let tiles_of_layer = |layer| of_layer(layer).next_multiple_of(network::TILE);
    let seen = condition as usize + if encoder > 0 { of_layer(encoder - 1) } else { 0 };
    let widest = outputs.iter().copied().max().unwrap_or(0).next_multiple_of(network::TILE);
    let hidden = seen + network::TILE;
    let logits = hidden + 2 * widest;
    let prepared_azimuth = logits + widest;
    let prepared_elevation = prepared_azimuth + tiles_of_layer(encoder + elevation);
    // Elevations that do not see the azimuth are known to the end.
    let last_prepared = if coupled == 1 { encoder } else { (encoder + elevation).saturating_sub(1) };
    let own = [
        ("head_condition", condition),
        ("head_coupled", coupled),
        ("head_encoder_layers", encoder),
        ("head_elevation_layers", elevation),
        ("head_azimuth_layers", azimuth),
        ("head_mixture_weight_layers", mixture_weight),
        ("head_elevation_bins", elevation_bins),
        ("head_azimuth_bins", azimuth_bins),
    ];
    let places = [
        ("head_seen", seen),
        ("head_widest", widest),
        ("head_hidden", hidden),
        ("head_logits", logits),
        ("head_prepared_azimuth", prepared_azimuth),
        ("head_prepared_elevation", prepared_elevation),
        ("head_units", prepared_elevation + tiles_of_layer(last_prepared)),
    ];
    Ok(own.into_iter().map(|(name, number)| (name, number as usize)).chain(places).collect())
}

fn integers_of<'a>(arrays: &'a [FlatArray], name: &str) -> Result<&'a [u32]> {
    match arrays.iter().find(|array| array.name == name).map(|array| &array.numbers) {
        Some(FlatNumbers::Integers(numbers)) => Ok(numbers),
        _ => Err(missing(name)),
    }
}

fn floats_of<'a>(arrays: &'a [FlatArray], name: &str) -> Result<&'a [f32]> {
    match arrays.iter().find(|array| array.name == name).map(|array| &array.numbers) {
        Some(FlatNumbers::Floats(numbers)) => Ok(numbers),
        _ => Err(missing(name)),
    }
}

fn missing(name: &str) -> Error {
    Error::argument("sampler", format!("has no array '{name}'"))
}

fn shape_of<'a>(arrays: &'a [FlatArray], name: &str) -> Result<&'a [usize]> {
    arrays.iter().find(|array| array.name == name).map(|array| &*array.shape).ok_or_else(|| missing(name))
}
