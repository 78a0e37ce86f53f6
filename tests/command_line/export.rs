//! `headtail export`.

use std::fs;

use super::{PORTALS, fail, succeed};

#[test]
fn shaders_are_written_with_their_buffers() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    succeed(at, "bake --direct --env overcast --normals 4x6 --cells 4x4 --out table");
    for (target, file) in [("wgsl", "headtail.wgsl"), ("spirv", "headtail.spv")] {
        let said = succeed(at, &format!("export table --target {target} --out table-{target}"));
        assert!(said.contains(&format!("table-{target}/{file} written")), "{said}");
        assert!(fs::metadata(at.join(format!("table-{target}/{file}"))).unwrap().len() > 1000);
    }
    succeed(
        at,
        "fit --env overcast --material lambert --steps 1 --set conditions=4 --set validation_conditions=2 --tail row-column --out head",
    );
    succeed(at, "export head/sampler.safetensors --target hlsl --out head-hlsl");
    let run = "--steps 1 --set conditions=4 --set validation_conditions=2 --out over";
    succeed(at, &format!("fit --env overcast --material ggx:alpha=0.4 --over patches {run}"));
    succeed(at, "export over/sampler.safetensors --target wgsl --out over-wgsl");
    let layout = fs::read_to_string(at.join("over-wgsl/layout.json")).unwrap();
    assert!(layout.contains("head.weights") && layout.contains("patches.leaves"), "{layout}");
    fs::write(at.join("portals.json"), PORTALS).unwrap();
    succeed(at, "export portals:portals.json --env overcast --target msl --out portals");
    assert!(fs::read_to_string(at.join("portals/layout.json")).unwrap().contains("portals.sums"));
    succeed(at, "export patches --env overcast --target glsl --out patches");
    let layout = fs::read_to_string(at.join("patches/layout.json")).unwrap();
    let layout: serde_json::Value = serde_json::from_str(&layout).unwrap();
    let array = &layout["patches.narrow"];
    let start = 4 * array["start"].as_u64().unwrap() as usize;
    let floats = fs::read(at.join("patches/floats.bin")).unwrap();
    assert_eq!(f32::from_le_bytes(floats[start..start + 4].try_into().unwrap()), 0.3);
}

#[test]
fn exports_without_their_map_or_for_another_map_are_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let run = "--steps 1 --set conditions=4 --set validation_conditions=2 --out head";
    succeed(at, &format!("fit --env sunset --material lambert {run}"));
    let file = "head/sampler.safetensors --target wgsl --out x";
    assert!(fail(at, &format!("export {file} --env studio")).contains("was made for the environment 'sunset'"));
    succeed(at, &format!("export {file} --env sunset"));
    assert!(fail(at, "export patches --target wgsl --out x").contains("give --env MAP"));
    assert!(fail(at, "export portals:missing --target wgsl --out x").contains("give --env MAP"));
    assert!(fail(at, "export portals:missing --env overcast --target wgsl --out x").starts_with("missing"));
    assert!(fail(at, "export missing --target wgsl --out x").contains("missing"));
}
