//! Every shader is valid, and has a translation to every language.

use std::path::Path;

use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    environment::Environment,
    export::{ExportedSampler, Intermediate, flat_exported, flat_patches},
    patches::Detail,
    tail::{Tail, TailKind},
};
use headtail_shaders::{Shader, Target};

fn shaders() -> [Shader; 3] {
    let map = Environment::open("studio").unwrap();
    let tail = Tail::of_environment(TailKind::Hierarchical, &map).unwrap();
    let table = direct_bake(&tail, NormalGrid::new(4, 8).unwrap(), CellGrid::new(8, 8).unwrap()).unwrap();
    let exported = ExportedSampler::new(Intermediate::DirectBake(table), TailKind::Hierarchical, &map, None).unwrap();
    let head = ExportedSampler::read(Path::new("../checkpoints/studio-head.safetensors")).unwrap();
    [flat_patches(&tail, Detail::Leaves).unwrap(), flat_exported(&exported).unwrap(), flat_exported(&head).unwrap()]
        .map(|arrays| Shader::new(&arrays).unwrap())
}

#[test]
fn every_shader_is_translated_to_every_language() {
    for shader in shaders() {
        for target in Target::ALL {
            let translated = shader.translate(target).unwrap_or_else(|error| panic!("{error}"));
            if target == Target::Spirv {
                assert_eq!(translated[..4], 0x0723_0203_u32.to_le_bytes());
            } else {
                let text = String::from_utf8(translated).unwrap();
                assert!(text.contains("headtail_sample") && text.contains("headtail_pdf"), "{target:?}");
            }
        }
    }
}

#[test]
fn arrays_that_are_no_sampler_are_refused() {
    assert!(Shader::new(&[]).unwrap_err().to_string().contains("tail.nodes"));
}
