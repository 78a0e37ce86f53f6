//! The node hierarchy: placed meshes and cameras.

use std::collections::HashMap;

use glam::{DAffine3, DMat4, DQuat, DVec3};

use super::{
    accessor::read_vectors,
    cameras::PlacedCamera,
    document::Document,
    json::{Instancing, Node, Whole},
    skins::read_joints,
};
use crate::{error::Result, remark::Remark};

/// A mesh and its transform to world space.
pub struct Instance {
    /// Index of the mesh.
    pub mesh: usize,
    /// Transform from mesh coordinates to world space.
    pub to_world: DAffine3,
    /// The node's name, or else the mesh's; empty where neither has one.
    pub name: String,
    /// Weights of the morph targets, where the node has its own.
    pub weights: Option<Vec<f32>>,
    /// The transforms of joints, which replace `to_world`; empty without a skin.
    pub joints: Vec<DAffine3>,
    /// Whether the transform that joints replace mirrors.
    pub is_mirrored: bool,
}

impl Instance {
    fn at_origin(mesh: usize) -> Self {
        let (to_world, name, joints) = (DAffine3::IDENTITY, String::new(), Vec::new());
        Self { mesh, to_world, name, weights: None, joints, is_mirrored: false }
    }

    /// Returns whether it has neither morph weights of its own nor a skin.
    pub fn is_plain(&self) -> bool {
        self.weights.is_none() && self.joints.is_empty()
    }
}

/// The meshes and cameras of a scene's nodes, in depth-first order.
#[derive(Default)]
pub struct Placed<'a> {
    /// Meshes with their transforms.
    pub meshes: Vec<Instance>,
    /// Cameras.
    pub cameras: Vec<PlacedCamera<'a>>,
}

/// Walks a scene: the one of that name or number, else the default one, else the first one, else all nodes.
pub fn placed<'a>(document: &'a Document, scene: Option<&str>) -> Result<Placed<'a>> {
    let root = document.root();
    let (roots, from) = roots(document, scene)?;
    let mut placed = Placed::default();
    if root.nodes.is_empty() && !root.meshes.is_empty() {
        document.remark(Remark::Note("shows all meshes, because the file has no nodes".into()));
        placed.meshes = (0..root.meshes.len()).map(Instance::at_origin).collect();
        return Ok(placed);
    }
    let mut globals: Vec<Option<DAffine3>> = vec![None; root.nodes.len()];
    let mut skinned = Vec::new();
    // A stack, not recursion: the file determines the depth.
    let mut open: Vec<(Whole, DAffine3, String)> = Vec::new();
    open.extend(roots.into_iter().rev().map(|node| (node, DAffine3::IDENTITY, from.clone())));
    while let Some((index, parent, from)) = open.pop() {
        let node = document.get(&root.nodes, index, &from)?;
        let index = index.index();
        // The hierarchy must be a forest; this rejects cycles, and sharing, which could double the nodes per
        // level.
        if globals[index].is_some() {
            return Err(document.invalid(from, format!("node {index} is reached a second time: nodes form no tree")));
        }
        let field = format!("nodes[{index}]");
        let to_world = parent * local_transform(document, node, &field)?;
        if !to_world.is_finite() {
            return Err(document.invalid(field, "the product of the transforms down to it is not finite"));
        }
        globals[index] = Some(to_world);
        if node.extensions.light.is_some() {
            document.warn("ignored punctual lights: only the environment lights the scene");
        }
        if let Some(mesh) = node.mesh {
            let first = placed.meshes.len();
            place_mesh(document, node, mesh, to_world, &field, &mut placed.meshes)?;
            skinned.extend(node.skin.map(|skin| (first..placed.meshes.len(), skin, field.clone())));
        }
        if let Some(camera) = &node.camera {
            placed.cameras.push(PlacedCamera::new(document, node, camera, to_world, &field));
        }
        open.extend(node.children.iter().rev().map(|&child| (child, to_world, format!("{field}.children"))));
    }
    for (instances, skin, field) in skinned {
        let joints = read_joints(document, skin, &globals, &field)?;
        for instance in &mut placed.meshes[instances] {
            // The specification ignores the node's own transform, except for the winding order.
            instance.is_mirrored = instance.to_world.matrix3.determinant() < 0.0;
            (instance.to_world, instance.joints) = (DAffine3::IDENTITY, joints.clone());
        }
    }
    Ok(placed)
}

/// Returns the root nodes of a scene, and the field that lists them.
fn roots(document: &Document, scene: Option<&str>) -> Result<(Vec<Whole>, String)> {
    let root = document.root();
    let index = match scene {
        Some(wanted) => {
            let own_names = || root.scenes.iter().map(|scene| scene?.name.as_deref());
            let named = own_names().position(|name| name == Some(wanted));
            let numbered = || wanted.parse().ok().filter(|&index: &usize| index < root.scenes.len());
            named.or_else(numbered).ok_or_else(|| {
                let names: Vec<String> = (own_names().enumerate().take(12))
                    .map(|(k, name)| name.map_or(k.to_string(), |name| format!("'{}'", name.escape_debug())))
                    .collect();
                document.invalid("scenes", format!("no scene is called '{wanted}'; the file has {}", names.join(", ")))
            })?
        }
        None if root.scenes.is_empty() && root.scene.is_none() => {
            // The specification allows files without scenes: libraries of nodes.
            let mut is_child = vec![false; root.nodes.len()];
            for child in root.nodes.iter().flatten().flat_map(|node| &node.children) {
                if let Some(is_child) = is_child.get_mut(child.index()) {
                    *is_child = true;
                }
            }
            let roots = (0..root.nodes.len()).filter(|&k| !is_child[k]).map(|k| Whole(k as u64));
            return Ok((roots.collect(), "nodes".into()));
        }
        None => root.scene.map_or(0, Whole::index),
    };
    let scene = document.get(&root.scenes, Whole(index as u64), "scene")?;
    Ok((scene.nodes.clone(), format!("scenes[{index}].nodes")))
}

/// Adds the mesh of a node once, or once per instance.
fn place_mesh(
    document: &Document,
    node: &Node,
    mesh: Whole,
    to_world: DAffine3,
    field: &str,
    meshes: &mut Vec<Instance>,
) -> Result<()> {
    let own = document.get(&document.root().meshes, mesh, &format!("{field}.mesh"))?;
    let name = node.name.as_ref().or(own.name.as_ref()).cloned().unwrap_or_default();
    let instance = |to_world| Instance {
        mesh: mesh.index(),
        to_world,
        name: name.clone(),
        weights: node.weights.clone(),
        joints: Vec::new(),
        is_mirrored: false,
    };
    match &node.extensions.instancing {
        None => meshes.push(instance(to_world)),
        Some(instancing) => {
            let field = format!("{field}.extensions.EXT_mesh_gpu_instancing");
            for own in instances(document, instancing, &field)? {
                let to_world = to_world * own;
                if !to_world.is_finite() {
                    return Err(document.invalid(field, "a transform is not finite"));
                }
                meshes.push(instance(to_world));
            }
        }
    }
    Ok(())
}

/// The transforms of `EXT_mesh_gpu_instancing` relative to the node.
fn instances(document: &Document, instancing: &Instancing, field: &str) -> Result<Vec<DAffine3>> {
    let attributes: &HashMap<String, Whole> = &instancing.attributes;
    let at = |name: &str| (attributes.get(name).copied(), format!("{field}.attributes.{name}"));
    let vectors = |name| match at(name) {
        (Some(accessor), field) => read_vectors::<3>(document, accessor, &field),
        (None, _) => Ok(Vec::new()),
    };
    let (translations, scales) = (vectors("TRANSLATION")?, vectors("SCALE")?);
    let rotations = match at("ROTATION") {
        (Some(accessor), field) => read_vectors::<4>(document, accessor, &field)?,
        (None, _) => Vec::new(),
    };
    let count = translations.len().max(scales.len()).max(rotations.len());
    if [translations.len(), scales.len(), rotations.len()].iter().any(|&own| own != 0 && own != count) {
        return Err(document.invalid(field, "its attributes have different counts"));
    }
    let as_f64 = |v: &[f32; 3]| DVec3::from(v.map(f64::from));
    (0..count)
        .map(|k| {
            let rotation = rotations.get(k).map_or(DQuat::IDENTITY, |q| DQuat::from_array(q.map(f64::from)));
            if !(rotation.length_squared() > 0.0 && rotation.is_finite()) {
                return Err(document.invalid(field, format!("rotation {k} is not a unit quaternion")));
            }
            let scale = scales.get(k).map_or(DVec3::ONE, as_f64);
            let translation = translations.get(k).map_or(DVec3::ZERO, as_f64);
            Ok(DAffine3::from_scale_rotation_translation(scale, rotation.normalize(), translation))
        })
        .collect()
}

/// The transform of a node relative to its parent.
fn local_transform(document: &Document, node: &Node, field: &str) -> Result<DAffine3> {
    let transform = match node.matrix {
        Some(matrix) => DAffine3::from_mat4(DMat4::from_cols_array(&matrix)),
        None => {
            let rotation = node.rotation.map_or(DQuat::IDENTITY, DQuat::from_array);
            if !(rotation.length_squared() > 0.0 && rotation.is_finite()) {
                return Err(document.invalid(format!("{field}.rotation"), "is not a unit quaternion"));
            }
            let scale = node.scale.map_or(DVec3::ONE, DVec3::from);
            let translation = node.translation.map_or(DVec3::ZERO, DVec3::from);
            DAffine3::from_scale_rotation_translation(scale, rotation.normalize(), translation)
        }
    };
    // Values that overflow f32 are rejected, too.
    let is_finite = transform.to_cols_array().iter().all(|&x| (x as f32).is_finite());
    if is_finite { Ok(transform) } else { Err(document.invalid(field, "its transform is not finite")) }
}
