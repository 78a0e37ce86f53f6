//! Writes the shaders of training a head with 32 bins and networks of 64 in Metal's language, for `instructions.py`.

use std::{env, error::Error, fs, path::PathBuf};

use headtail_sampling::{
    environment::Environment,
    tail::{Tail, TailKind},
};
use headtail_shaders::{
    Shader, Target,
    training::{Kernel, TARGET_SIZES},
};

fn main() -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(env::args_os().nth(1).ok_or("a folder for the shaders is missing")?);
    fs::create_dir_all(&folder)?;
    // 8 rows of threads compute 64 outputs, 13 the 97 logits; forms are those of `affine.wgsl`.
    let kernels = [
        Kernel::Affine { rows: 8, form: 1 },
        Kernel::Affine { rows: 13, form: 0 },
        Kernel::Affine { rows: 8, form: 4 },
        Kernel::WeightGradient { rows: 8 },
        Kernel::WeightGradient { rows: 13 },
        Kernel::SplineForward,
        Kernel::Loss,
        Kernel::FirstLayer,
    ];
    let tail = Tail::of_environment(TailKind::Hierarchical, &Environment::open("studio")?)?;
    // A microfacet surface with a range of widths, points over the tail; the other sizes change no instruction.
    let sizes = TARGET_SIZES.map(|name| usize::from(!["IS_NEURAL", "IS_IN_X"].contains(&name)));
    let targets = Shader::of_targets(&tail.flat(), sizes, 0.0)?;
    fs::write(folder.join("place_strata.metal"), targets.translate(Target::Msl)?)?;
    for kernel in kernels {
        let shader = Shader { source: kernel.source(), floats: vec![], integers: vec![], layout: String::new() };
        let name = match kernel {
            Kernel::Affine { rows, form } => format!("affine {rows} {form}"),
            Kernel::WeightGradient { rows } => format!("weight_gradient {rows}"),
            _ => kernel.entry().into(),
        };
        fs::write(folder.join(name + ".metal"), shader.translate(Target::Msl)?)?;
    }
    Ok(())
}
