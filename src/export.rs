//! `headtail export`: samplers as shaders.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Args;
use headtail_render::{
    export::{ExportedSampler, flat_exported, flat_patches, flat_portals},
    file::replace,
    patches::Detail,
    path_text::path_of,
    portals,
    tail::{Tail, TailKind},
};
use headtail_shaders::{Shader, Target};

use crate::arguments::open_environment;
use crate::given::{given, one_of};
use crate::output::OutputFolder;
use crate::terminal::{say, warning};

/// Write a sampler as a shader, with the buffers that it reads.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail export out/room/direct.safetensors --target wgsl --out out/room/shader
  headtail export patches --env room.hdr --target spirv --out out/room/shader
  headtail export portals:out/room/portals.json --env room.hdr --target wgsl --out out/room/shader

DIR/headtail.EXT has the functions headtail_sample, headtail_pdf and headtail_share and, as an example, a compute shader headtail_draw. \
DIR/floats.bin and DIR/integers.bin are the buffers of bindings 0 and 1 (little-endian, 32 bits), DIR/layout.json says what lies where. \
There are shaders of tables and heads over every tail, of patches, of heads over them, and of portals.")]
pub struct Arguments {
    /// Table of `bake`, head of `fit`, or patches, patches:fine or portals:FILE (`inspect --portals`), which need --env.
    #[arg(value_name = "FILE|patches|portals:FILE", value_parser = given::<String>())]
    sampler: String,
    /// Map of patches or portals, or the map that FILE must be for.
    /// A built-in environment or a .hdr or .exr file.
    #[arg(long, value_name = "MAP", value_parser = given::<String>())]
    env: Option<String>,
    /// Shader language.
    #[arg(long, value_parser = one_of(&TARGETS))]
    target: Target,
    /// Folder for the files.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

const TARGETS: [(Target, &str, &str); 5] = [
    (Target::Wgsl, "wgsl", "WebGPU"),
    (Target::Glsl, "glsl", "OpenGL 4.3"),
    (Target::Hlsl, "hlsl", "Direct3D"),
    (Target::Msl, "msl", "Metal"),
    (Target::Spirv, "spirv", "Vulkan"),
];

/// WebGPU's default `maxStorageBufferBindingSize`, in bytes.
const WEBGPU_BINDING: u64 = 134_217_728;

/// Writes the shader, its buffers and their layout.
pub fn run(arguments: &Arguments) -> Result<()> {
    let target = arguments.target;
    let source_name = format!("headtail.{}", target.name_and_extension().1);
    let output = OutputFolder::take(&arguments.out, &[&source_name, "floats.bin", "integers.bin", "layout.json"])?;
    let map = || match &arguments.env {
        Some(map) => open_environment(map),
        None => bail!("{} needs the map: give --env MAP", arguments.sampler),
    };
    let of_patches =
        |detail| -> Result<_> { Ok(flat_patches(&Tail::of_environment(TailKind::Hierarchical, &*map()?)?, detail)?) };
    let arrays = match (&*arguments.sampler, arguments.sampler.strip_prefix("portals:")) {
        ("patches", _) => of_patches(Detail::Leaves)?,
        ("patches:fine", _) => of_patches(Detail::Twigs)?,
        (_, Some(file)) => {
            let map = map()?;
            flat_portals(&portals::read(&path_of(file))?, &map)?
        }
        (file, None) => {
            let file = path_of(file);
            let exported = ExportedSampler::read(&file)?;
            if let Some(map) = &arguments.env {
                exported.check_environment(&*open_environment(map)?).map_err(|error| error.in_file(&file))?;
            }
            flat_exported(&exported).map_err(|error| error.in_file(&file))?
        }
    };
    let shader = Shader::new(&arrays)?;
    let source = shader.translate(target)?;
    output.begin()?;
    let bytes = |numbers: &[u32]| numbers.iter().flat_map(|number| number.to_le_bytes()).collect::<Vec<u8>>();
    let floats: Vec<u32> = shader.floats.iter().map(|number| number.to_bits()).collect();
    let files = [
        (&*source_name, source),
        ("floats.bin", bytes(&floats)),
        ("integers.bin", bytes(&shader.integers)),
        ("layout.json", shader.layout.into_bytes()),
    ];
    for (name, content) in &files {
        if name.ends_with(".bin") && content.len() as u64 > WEBGPU_BINDING {
            warning!(
                "{name} has {} bytes, more than the {WEBGPU_BINDING} of a storage buffer's binding that every WebGPU device has: ask for \
                 requiredLimits.maxStorageBufferBindingSize and maxBufferSize of as many",
                content.len()
            );
        }
    }
    for (name, content) in files {
        replace(&output.file(name)?, &content)?;
    }
    say!("{} written, with floats.bin, integers.bin and layout.json", arguments.out.join(&source_name).display());
    Ok(())
}
