//! `headtail inspect --portals`: writes the portals of a room for other programs.

use std::path::Path;

use anyhow::Result;
use base64::{Engine, prelude::BASE64_STANDARD};
use glam::Vec3A;
use headtail_render::{
    portals::{Portal, Portals, to_json},
    scene::{Camera, Scene},
};
use serde_json::{Value, json};

use super::light_files::{Format, LightFile, blender_vector, gltf_of_nodes};
use crate::{
    report::number,
    terminal::{self, out, warning},
};

/// Coverage below which light would be lost in renderers that sample the environment through portals alone.
const COVERED: f32 = 0.98;

const FORMATS: [Format<Portal>; 4] = [
    Format { extension: "json", text: to_json },
    Format { extension: "gltf", text: gltf },
    Format { extension: "usda", text: usd },
    Format { extension: "py", text: blender },
];

/// Finds the portals of the room that a camera is in, writes them and reports them.
pub fn inspect(scene: &Scene, camera: &Camera, path: &Path, json: bool) -> Result<()> {
    let output = LightFile::take(path, &FORMATS, ".json (for --sampler), .gltf, .usda (USD) or .py (Blender)")?;
    let found = Portals::find(scene, camera)?;
    let coverage = found.coverage(scene, camera, 1);
    let percent = |fraction: f32| format!("{:.1} %", 100.0 * fraction);
    output.write(&found.portals)?;
    if coverage < COVERED {
        warning!(
            "the portals cover {} of the rays; renderers that sample the environment through portals alone lose the rest",
            percent(coverage)
        );
    }
    if json {
        let mut described: Value = serde_json::from_str(&to_json(&found.portals))?;
        for (name, value) in [
            ("coverage", json!(coverage)),
            ("openness", json!(found.openness)),
            ("file", json!(path.display().to_string())),
        ] {
            described[name] = value;
        }
        return terminal::print_json(&described);
    }
    for (number, portal) in found.portals.iter().enumerate() {
        out!(
            "{}: {:.2} x {:.2} m at {}, normal {}",
            name(number),
            portal.width,
            portal.height,
            number::vector(portal.center),
            number::vector(portal.normal)
        );
    }
    out!(
        "{} of the rays reach the environment, {} of these through the portals\n{} written",
        percent(found.openness),
        percent(coverage),
        path.display()
    );
    Ok(())
}

fn name(number: usize) -> String {
    format!("portal-{}", number + 1)
}

/// One node per portal: a square of 1 m with a scale, whose front faces the room.
fn gltf(portals: &[Portal]) -> String {
    let positions: [[f32; 3]; 4] = [[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]];
    let mut bytes: Vec<u8> = positions.as_flattened().iter().flat_map(|number| number.to_le_bytes()).collect();
    bytes.extend([0_u16, 1, 2, 0, 2, 3].iter().flat_map(|index| index.to_le_bytes()));
    let nodes: Vec<Value> = portals
        .iter()
        .enumerate()
        .map(|(number, portal)| {
            let axes = [portal.width * portal.right(), portal.height * portal.up, portal.normal];
            let columns = axes.map(|axis| [axis.x, axis.y, axis.z, 0.0]);
            let [x, y, z] = portal.center.to_array();
            let matrix: Vec<f32> = columns.into_iter().flatten().chain([x, y, z, 1.0]).collect();
            json!({"name": name(number), "mesh": 0, "matrix": matrix})
        })
        .collect();
    let mut file = gltf_of_nodes("portals", nodes);
    file["meshes"] = json!([{"name": "portal", "primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}]);
    file["accessors"] = json!([
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [-0.5, -0.5, 0.0], "max": [0.5, 0.5, 0.0]},
        {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
    ]);
    file["bufferViews"] = json!([
        {"buffer": 0, "byteOffset": 0, "byteLength": 48, "target": 34962},
        {"buffer": 0, "byteOffset": 48, "byteLength": 12, "target": 34963},
    ]);
    file["buffers"] = json!([{
        "byteLength": bytes.len(),
        "uri": format!("data:application/octet-stream;base64,{}", BASE64_STANDARD.encode(&bytes)),
    }]);
    format!("{file:#}")
}

/// `PortalLight` prims, which transmit light along -Z.
fn usd(portals: &[Portal]) -> String {
    let mut text = String::from(
        "#usda 1.0\n(\n    doc = \"Portals found by headtail. Reference this layer and list its lights in the dome \
         light's relationship 'portals'.\"\n    defaultPrim = \"portals\"\n    metersPerUnit = 1\n    upAxis = \"Y\"\n)\n\n\
         def Scope \"portals\"\n{\n",
    );
    for (number, portal) in portals.iter().enumerate() {
        let row = |v: Vec3A, last: u8| format!("({}, {}, {}, {last})", v.x, v.y, v.z);
        let rows =
            [row(-portal.right(), 0), row(portal.up, 0), row(-portal.normal, 0), row(portal.center, 1)].join(", ");
        let (width, height) = (portal.width, portal.height);
        text += &format!(
            "    def PortalLight \"{}\"\n    {{\n        float inputs:width = {width}\n        float inputs:height = {height}\n        \
             matrix4d xformOp:transform = ({rows})\n        uniform token[] xformOpOrder = [\"xformOp:transform\"]\n    }}\n",
            name(number).replace('-', "_"),
        );
    }
    text + "}\n"
}

/// A script that adds area lights as portals of Cycles.
fn blender(portals: &[Portal]) -> String {
    let rows: Vec<String> = portals
        .iter()
        .map(|portal| {
            let vectors = [portal.center, portal.normal, portal.up].map(blender_vector).join(", ");
            format!("    ({vectors}, {}, {}),\n", portal.width, portal.height)
        })
        .collect();
    format!(
        "\"\"\"Adds portals found by headtail as area lights of Cycles. Run it in Blender's text editor.\"\"\"\n\nimport bpy\n\
         from mathutils import Matrix, Vector\n\n# Middle, normal into the room, direction of the height; width and height. Z is up.\n\
         PORTALS = [\n{}]\n\n\
         for number, (center, normal, up, width, height) in enumerate(PORTALS, 1):\n    \
         light = bpy.data.lights.new(f\"portal-{{number}}\", \"AREA\")\n    \
         light.shape, light.size, light.size_y = \"RECTANGLE\", width, height\n    \
         light.cycles.is_portal = True\n    \
         portal = bpy.data.objects.new(light.name, light)\n    \
         # Area lights face -Z.\n    \
         y, z = Vector(up), -Vector(normal)\n    \
         portal.matrix_world = Matrix.Translation(center) @ Matrix((y.cross(z), y, z)).transposed().to_4x4()\n    \
         bpy.context.scene.collection.objects.link(portal)\n",
        rows.concat()
    )
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    fn portals() -> Vec<Portal> {
        let turned = Vec3A::new(2.0, 3.0, 6.0) / 7.0;
        let (window, skylight) = (Vec3A::new(-1.5, 1.2, 0.3), Vec3A::new(0.5, 2.8, -4.0));
        vec![
            Portal { center: window, normal: turned, up: turned.any_orthonormal_vector(), width: 1.4, height: 0.9 },
            Portal { center: skylight, normal: Vec3A::NEG_Y, up: Vec3A::NEG_Z, width: 0.6, height: 2.0 },
        ]
    }

    /// Returns the numbers of a text, in order.
    fn numbers_of(text: &str) -> Vec<f32> {
        text.split(|c: char| !(c.is_ascii_digit() || "+-.e".contains(c))).filter_map(|word| word.parse().ok()).collect()
    }

    /// Panics if two points differ by more than rounding: metres, in steps of 1.2e-7 of 4 m.
    fn assert_near(a: Vec3A, b: Vec3A) {
        assert!(a.distance(b) < 2e-6, "{a} {b}");
    }

    #[test]
    fn gltf_files_hold_the_rectangles_with_their_fronts_to_the_room() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("portals.gltf");
        std::fs::write(&file, gltf(&portals())).unwrap();
        let scene = Scene::open(file.to_str().unwrap()).unwrap();
        let triangles: Vec<[Vec3; 3]> = scene.triangles().collect();
        assert_eq!(triangles.len(), 4);
        for (portal, pair) in portals().iter().zip(triangles.chunks_exact(2)) {
            let corners = portal.corners();
            for (triangle, expected) in pair.iter().zip([[0, 1, 2], [0, 2, 3]]) {
                for (&vertex, corner) in triangle.iter().zip(expected) {
                    assert_near(vertex.into(), corners[corner]);
                }
                let [a, b, c] = triangle.map(Vec3A::from);
                assert_near((b - a).cross(c - a).normalize(), portal.normal);
            }
        }
    }

    #[test]
    fn lights_of_usd_face_the_room_along_negative_z() {
        let text = usd(&portals());
        let blocks: Vec<&str> = text.split("def PortalLight").skip(1).collect();
        assert_eq!(blocks.len(), 2);
        for (portal, block) in portals().iter().zip(blocks) {
            let of = |name: &str| numbers_of(block.split(name).nth(1).unwrap().split('\n').next().unwrap());
            assert_eq!((of("inputs:width = ")[0], of("inputs:height = ")[0]), (portal.width, portal.height));
            let rows = of("xformOp:transform = ");
            let rows: Vec<Vec3A> = rows.chunks_exact(4).map(|row| Vec3A::new(row[0], row[1], row[2])).collect();
            let [x, y, z, center] = rows[..] else { panic!("{block}") };
            assert_near(x.cross(y), z);
            assert_near(-z, portal.normal);
            let corner = center + 0.5 * (portal.width * x + portal.height * y);
            assert!(portal.corners().iter().any(|other| other.distance(corner) < 2e-6), "{corner}");
        }
    }

    #[test]
    fn rows_of_the_blender_script_are_turned_to_z_up() {
        let text = blender(&portals());
        let rows = text.split("PORTALS = [\n").nth(1).unwrap().split(']').next().unwrap();
        assert_eq!(rows.lines().count(), 2);
        for (portal, row) in portals().iter().zip(rows.lines()) {
            let row = numbers_of(row);
            let y_up = |k: usize| Vec3A::new(row[k], row[k + 2], -row[k + 1]);
            assert_eq!([y_up(0), y_up(3), y_up(6)], [portal.center, portal.normal, portal.up]);
            assert_eq!(row[9..], [portal.width, portal.height]);
        }
    }
}
