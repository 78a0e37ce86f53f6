//! The node hierarchy: which mesh stands where, and the camera.

use glam::{Affine3A, Mat4, Quat, Vec3, Vec3A};
use gltf::json::{Index, Node, validation::Checked};

use super::{document::Document, in_field};
use crate::{error::Result, scene::Camera};

/// A mesh and its transform to world space.
pub struct Instance {
    /// Index of the mesh.
    pub mesh: usize,
    /// From the mesh's coordinates to the world's.
    pub to_world: Affine3A,
    /// The node's name, or else the mesh's; empty where neither has one.
    pub name: String,
}

/// What the nodes of a scene hold.
pub struct Placed {
    /// Meshes with their transforms, in depth-first order.
    pub meshes: Vec<Instance>,
    /// The first perspective camera.
    pub camera: Option<Camera>,
}

/// Walks the default scene, or the first one.
pub fn placed(document: &Document) -> Result<Placed> {
    let root = document.root();
    let first = root.scene.map_or(0, |scene| scene.value());
    let Some(scene) = root.scenes.get(first) else {
        let reason =
            if root.scenes.is_empty() { "there is no scene".into() } else { format!("index {first} is out of range") };
        return Err(document.invalid("scene", reason));
    };

    let mut placed = Placed { meshes: Vec::new(), camera: None };
    let mut visited = vec![false; root.nodes.len()];
    // A stack, not a recursion: the depth is up to the file.
    let mut open: Vec<(Index<Node>, Affine3A, String)> = Vec::new();
    let roots = scene.nodes.iter().rev();
    open.extend(roots.map(|&node| (node, Affine3A::IDENTITY, format!("scenes[{first}].nodes"))));
    while let Some((index, parent, from)) = open.pop() {
        let node = document.get(index, &from)?;
        let index = index.value();
        // The hierarchy must be a forest; this refuses cycles, and sharing, which could double with each level.
        if std::mem::replace(&mut visited[index], true) {
            return Err(document.invalid(from, format!("node {index} is reached a second time: nodes form no tree")));
        }
        let field = format!("nodes[{index}]");
        let to_world = parent * local_transform(document, node, &field)?;
        if !to_world.is_finite() {
            return Err(document.invalid(field, "the product of the transforms down to it is not finite"));
        }
        if let Some(mesh) = node.mesh {
            let own = document.get(mesh, &format!("{field}.mesh"))?;
            let name = node.name.as_ref().or(own.name.as_ref()).cloned().unwrap_or_default();
            placed.meshes.push(Instance { mesh: mesh.value(), to_world, name });
        }
        if placed.camera.is_none() {
            placed.camera = camera(document, node, &to_world, &field)?;
        }
        let children = node.children.iter().flatten().rev();
        open.extend(children.map(|&child| (child, to_world, format!("{field}.children"))));
    }
    Ok(placed)
}

/// The transform of a node relative to its parent.
fn local_transform(document: &Document, node: &Node, field: &str) -> Result<Affine3A> {
    let transform = match node.matrix {
        Some(matrix) => Affine3A::from_mat4(Mat4::from_cols_array(&matrix)),
        None => {
            let rotation = Quat::from_array(node.rotation.unwrap_or_default().0);
            if !(rotation.length_squared() > 0.0 && rotation.is_finite()) {
                return Err(document.invalid(format!("{field}.rotation"), "is not a unit quaternion"));
            }
            let scale = node.scale.map_or(Vec3::ONE, Vec3::from);
            let translation = node.translation.map_or(Vec3::ZERO, Vec3::from);
            Affine3A::from_scale_rotation_translation(scale, rotation.normalize(), translation)
        }
    };
    if transform.is_finite() { Ok(transform) } else { Err(document.invalid(field, "its transform is not finite")) }
}

/// The camera of a node, if it is perspective: it looks along the node's -Z.
fn camera(document: &Document, node: &Node, to_world: &Affine3A, field: &str) -> Result<Option<Camera>> {
    let Some(index) = node.camera else { return Ok(None) };
    let camera = document.get(index, &format!("{field}.camera"))?;
    let Checked::Valid(_) = camera.type_ else {
        return Err(document.invalid(format!("cameras[{}].type", index.value()), "is not a camera type of glTF"));
    };
    let Some(perspective) = &camera.perspective else { return Ok(None) };
    let look_from = to_world.translation;
    let forward = to_world.transform_vector3a(-Vec3A::Z).normalize_or_zero();
    // Far from the origin of the coordinates, one metre ahead would be rounded away.
    let look_at = look_from + forward * look_from.abs().max_element().max(1.0);
    Camera::new(look_from, look_at, perspective.yfov.to_degrees())
        .map(Some)
        .map_err(|error| in_field(document, &format!("cameras[{}]", index.value()), error))
}
