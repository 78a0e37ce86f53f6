//! Conversion of meshes and their nodes to triangles in world space, or to copies by reference in large
//! scenes.

use std::collections::HashMap;

use glam::{Affine3A, DAffine3, DVec3, Vec3};

use super::{
    document::{Document, in_field},
    nodes::Instance,
    primitive::read_mesh,
};
use crate::{
    error::Result,
    scene::{MAX_COORDINATE, Mesh, copies::is_placement},
};

/// Reads the meshes of instances in their own coordinates with their transforms to world space: one transform
/// each, or several where there would be more than `most_copied` triangles.
pub fn read(document: &Document, instances: Vec<Instance>, most_copied: usize) -> Result<Vec<(Mesh, Vec<DAffine3>)>> {
    let mut shared: HashMap<usize, Shared> = HashMap::new();
    for instance in instances.iter().filter(|instance| instance.is_plain()) {
        if let Some(shared) = shared.get_mut(&instance.mesh) {
            shared.uses += 1;
        } else {
            let meshes = read_mesh(document, instance.mesh, None, &[])?;
            shared.insert(instance.mesh, Shared { meshes, uses: 1, first: None, is_copied: false });
        }
    }
    let triangles = shared.values().map(|shared| shared.uses.saturating_mul(shared.triangles()));
    let is_large = triangles.fold(0_usize, usize::saturating_add) > most_copied;
    let mut placed: Vec<(Mesh, Vec<DAffine3>)> = Vec::new();
    for instance in instances {
        let is_plain = instance.is_plain();
        let Instance { mesh, to_world, name, weights, joints, is_mirrored } = instance;
        let named = |own: &Mesh| Mesh { name: name.clone(), ..own.clone() };
        let Some(shared) = shared.get_mut(&mesh).filter(|_| is_plain) else {
            let mut own = read_mesh(document, mesh, weights.as_deref(), &joints)?;
            if is_mirrored {
                own.iter_mut().for_each(Mesh::turn_over);
            }
            placed.extend(own.iter().map(|own| (named(own), vec![to_world])));
            continue;
        };
        if is_large && shared.uses > 1 && is_placement(&to_world.as_affine3a()) {
            let first = *shared.first.get_or_insert_with(|| {
                placed.extend(shared.meshes.iter().map(|own| (named(own), Vec::new())));
                placed.len() - shared.meshes.len()
            });
            placed[first..][..shared.meshes.len()].iter_mut().for_each(|(_, places)| places.push(to_world));
        } else {
            if std::mem::replace(&mut shared.is_copied, true) {
                document.reserve_elements(shared.elements(), &format!("meshes[{mesh}]"))?;
            }
            placed.extend(shared.meshes.iter().map(|own| (named(own), vec![to_world])));
        }
    }
    Ok(placed)
}

/// A mesh of the file, without a node's own weights or a skin.
struct Shared {
    /// One mesh per primitive.
    meshes: Vec<Mesh>,
    /// How many instances show it.
    uses: usize,
    /// Index of the copies by reference, once there are any.
    first: Option<usize>,
    /// Whether there is a copy with its own memory.
    is_copied: bool,
}

impl Shared {
    fn triangles(&self) -> usize {
        self.meshes.iter().map(|mesh| mesh.triangles.len()).sum()
    }

    /// Vertices and indices.
    fn elements(&self) -> u64 {
        self.meshes.iter().map(|mesh| (mesh.positions.len() + 3 * mesh.triangles.len()) as u64).sum()
    }
}

/// Moves a mesh, or its copies, to world space, whose origin is at `origin` of the file's.
pub fn place(document: &Document, mesh: Mesh, places: &[DAffine3], origin: DVec3) -> Result<Mesh> {
    let field = format!("mesh '{}', placed by its node", mesh.name.escape_debug());
    let shifted = |to_world: &DAffine3| DAffine3::from_translation(-origin) * *to_world;
    let [to_world] = places else {
        let places: Vec<Affine3A> = places.iter().map(|place| shifted(place).as_affine3a()).collect();
        let mesh = Mesh { places, ..mesh };
        let far = |p: &Vec3| !p.abs().cmple(Vec3::splat(MAX_COORDINATE)).all();
        let far = mesh.world_positions().find(far);
        return match far {
            Some(p) => {
                let reason = format!("a copy has a vertex at {p}, which is not finite or beyond {MAX_COORDINATE:e} m");
                Err(document.invalid(field, reason))
            }
            None => Ok(mesh),
        };
    };
    let shifted = shifted(to_world);
    let exact = (origin != DVec3::ZERO).then(|| {
        let moved = mesh.positions.iter().map(|p| shifted.transform_point3(p.as_dvec3()).as_vec3());
        moved.collect::<Vec<_>>()
    });
    let moved = mesh.transformed(&shifted.as_affine3a());
    let Mesh { positions, normals, texcoords, triangles, material, .. } = moved;
    // Checked again: the transform may have made positions infinite.
    Mesh::new(exact.unwrap_or(positions), normals, texcoords, triangles, material)
        .map(|mesh| Mesh {
            roughness_texcoords: moved.roughness_texcoords,
            emission_texcoords: moved.emission_texcoords,
            tangent_space: moved.tangent_space,
            colors: moved.colors,
            alphas: moved.alphas,
            name: moved.name,
            ..mesh
        })
        .map_err(|error| in_field(document, &field, error))
}
