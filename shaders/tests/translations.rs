//! All shaders are valid and have translations to all languages.

use std::{env, fs, path::Path, process::Command};

use glam::Vec3A;
use headtail_sampling::{
    bake::{CellGrid, NormalGrid, direct_bake},
    environment::Environment,
    export::{ExportedSampler, Intermediate, flat_exported, flat_patches, flat_portals},
    patches::Detail,
    portals::Portal,
    tail::{Tail, TailKind},
};
use headtail_shaders::{Shader, Target};

fn shaders() -> Vec<Shader> {
    let map = Environment::open("studio").unwrap();
    let tail = Tail::of_environment(TailKind::Hierarchical, &map).unwrap();
    let table = direct_bake(&tail, NormalGrid::new(4, 8).unwrap(), CellGrid::new(8, 8).unwrap()).unwrap();
    let exported = ExportedSampler::new(Intermediate::DirectBake(table), TailKind::Hierarchical, &map, None).unwrap();
    let head = ExportedSampler::read(Path::new("../checkpoints/studio-head.safetensors")).unwrap();
    let over_patches = head.clone().over_patches(Detail::Leaves);
    let row_column = ExportedSampler::new(head.intermediate.clone(), TailKind::RowColumn, &map, None).unwrap();
    let window = Portal { center: Vec3A::X, normal: Vec3A::NEG_X, up: Vec3A::Y, width: 1.0, height: 2.0 };
    let arrays = [
        flat_patches(&tail, Detail::Leaves),
        flat_exported(&exported),
        flat_exported(&head),
        flat_exported(&over_patches),
        flat_exported(&row_column),
        flat_portals(&[window], &map),
    ];
    arrays.into_iter().map(|arrays| Shader::new(&arrays.unwrap()).unwrap()).collect()
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
fn arrays_that_are_not_a_sampler_are_rejected() {
    assert!(Shader::new(&[]).unwrap_err().to_string().contains("tail.nodes"));
}

/// Checks every translation with a validator, if it is installed.
fn check_by(program: &str, target: Target) {
    if Command::new(program).arg("--version").output().is_err() {
        println!("{program} is not installed");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    for (number, shader) in shaders().iter().enumerate() {
        let file = folder.path().join(format!("{number}.{}", target.name_and_extension().1));
        fs::write(&file, shader.translate(target).unwrap()).unwrap();
        let output = Command::new(program).arg(&file).output().unwrap();
        let said = [output.stdout, output.stderr].concat();
        assert!(output.status.success(), "{number}: {}", String::from_utf8_lossy(&said));
    }
}

/// glslang accepts the translations, if it is installed.
#[test]
fn glslang_accepts_translations() {
    check_by("glslangValidator", Target::Glsl);
}

/// Vulkan's validator accepts the translations, if it is installed.
#[test]
fn spirv_val_accepts_translations() {
    check_by("spirv-val", Target::Spirv);
}

/// DirectX's compiler accepts the translations and rejects an invalid shader, if `HEADTAIL_DXC` names its
/// library.
#[test]
fn dxc_accepts_translations() {
    let Some(library) = env::var_os("HEADTAIL_DXC") else {
        println!("HEADTAIL_DXC does not name a libdxcompiler.so");
        return;
    };
    let compile = |file: &Path| {
        let profile = ["cs_6_0", "headtail_draw"];
        Command::new("python3").arg("tests/dxc.py").arg(&library).args(profile).arg(file).output().unwrap()
    };
    let folder = tempfile::tempdir().unwrap();
    for (number, shader) in shaders().iter().enumerate() {
        let file = folder.path().join(format!("{number}.hlsl"));
        let text = shader.translate(Target::Hlsl).unwrap();
        fs::write(&file, &text).unwrap();
        let output = compile(&file);
        assert!(output.status.success(), "{number}: {}", String::from_utf8_lossy(&output.stdout));
        let broken = String::from_utf8(text).unwrap().replace("headtail_sample(", "headtail_nothing(");
        let broken = broken.replacen("headtail_nothing(", "headtail_sample(", 1);
        fs::write(&file, broken).unwrap();
        let output = compile(&file);
        assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    }
}
