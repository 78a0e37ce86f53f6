//! Skins: vertices that follow the nodes of a skeleton, in their pose without animations.

use glam::{Affine3A, DAffine3, DMat3, DMat4};

use super::{
    accessor::read_vectors,
    document::{Document, in_field},
    json::{Primitive, Skin, Whole},
};
use crate::{
    error::Result,
    scene::{
        Mesh,
        mesh::{moved_tangent, normal_matrix},
    },
};

/// Reads the transforms of a skin's joints from the mesh at rest to world space; `globals` are those of the
/// nodes in the scene.
pub fn read_joints(
    document: &Document,
    skin: Whole,
    globals: &[Option<DAffine3>],
    field: &str,
) -> Result<Vec<DAffine3>> {
    let own = document.get(&document.root().skins, skin, &format!("{field}.skin"))?;
    let Skin { joints, inverse_bind_matrices } = own;
    let field = format!("skins[{}]", skin.0);
    let place = format!("{field}.inverseBindMatrices");
    let matrices = inverse_bind_matrices.map(|accessor| read_vectors::<16>(document, accessor, &place)).transpose()?;
    if matrices.as_ref().is_some_and(|matrices| matrices.len() < joints.len()) {
        return Err(document.invalid(place, format!("are fewer than the {} joints", joints.len())));
    }
    let joint = |(k, &node): (usize, &Whole)| {
        let Some(Some(global)) = globals.get(node.index()) else {
            return Err(document.invalid(format!("{field}.joints[{k}]"), "is not a node of the scene"));
        };
        let to_joint = matrices.as_ref().map_or(DAffine3::IDENTITY, |matrices| {
            DAffine3::from_mat4(DMat4::from_cols_array(&matrices[k].map(f64::from)))
        });
        Ok(*global * to_joint)
    };
    joints.iter().enumerate().map(joint).collect()
}

/// Moves the vertices of a primitive with its joints.
pub fn bend(document: &Document, primitive: &Primitive, joints: &[DAffine3], mesh: Mesh, field: &str) -> Result<Mesh> {
    let influences = influences(document, primitive, mesh.positions.len(), field)?;
    let Mesh { mut positions, mut normals, mut tangent_space, .. } = mesh;
    for (k, own) in influences.iter().enumerate() {
        let transform = blend(joints, own).ok_or_else(|| {
            document
                .invalid(format!("{field}.attributes.JOINTS_0"), format!("vertex {k} names a joint that is not there"))
        })?;
        positions[k] = transform.transform_point3(positions[k].as_dvec3()).as_vec3();
        let rounded: Affine3A = transform.as_affine3a();
        if let Some(normal) = normals.get_mut(k) {
            *normal = normal_matrix(&rounded) * *normal;
        }
        if let Some(tangent) = tangent_space.as_mut().and_then(|space| space.tangents.get_mut(k)) {
            *tangent = moved_tangent(*tangent, &rounded);
        }
    }
    // Checked again: joints may move vertices anywhere.
    Mesh::new(positions, normals, mesh.texcoords, mesh.triangles, mesh.material)
        .map(|moved| Mesh {
            tangent_space,
            roughness_texcoords: mesh.roughness_texcoords,
            emission_texcoords: mesh.emission_texcoords,
            colors: mesh.colors,
            alphas: mesh.alphas,
            ..moved
        })
        .map_err(|error| in_field(document, field, error))
}

/// The joints of a vertex with their weights.
type Influences = Vec<(usize, f64)>;

/// Reads the joints that move each vertex.
fn influences(document: &Document, primitive: &Primitive, vertices: usize, field: &str) -> Result<Vec<Influences>> {
    let mut influences = vec![Influences::new(); vertices];
    for set in 0.. {
        let names = [format!("JOINTS_{set}"), format!("WEIGHTS_{set}")];
        let [joints, weights] = names.each_ref().map(|name| primitive.attributes.get(name).copied());
        let fields = names.map(|name| format!("{field}.attributes.{name}"));
        let (joints, weights) = match (joints, weights, set) {
            (Some(joints), Some(weights), _) => (joints, weights),
            (None, None, 1..) => break,
            (None, ..) => return Err(document.invalid(&fields[0], "is missing, but the node has a skin")),
            _ => return Err(document.invalid(&fields[1], "is missing, but the node has a skin")),
        };
        let joints = read_vectors::<4>(document, joints, &fields[0])?;
        let weights = read_vectors::<4>(document, weights, &fields[1])?;
        if joints.len() != vertices || weights.len() != vertices {
            let reason = format!("there are {} and {} weights, but {vertices} positions", joints.len(), weights.len());
            return Err(document.invalid(&fields[0], reason));
        }
        for ((own, joints), weights) in influences.iter_mut().zip(joints).zip(weights) {
            // Joint indices are integers of at most 16 bits.
            let pairs = joints.into_iter().zip(weights).map(|(joint, weight)| (joint as usize, f64::from(weight)));
            own.extend(pairs.filter(|&(_, weight)| weight != 0.0));
        }
    }
    Ok(influences)
}

/// Returns the weighted mean of the joints' transforms; the first joint's for a vertex without weights.
/// `None` if a joint does not exist.
fn blend(joints: &[DAffine3], influences: &[(usize, f64)]) -> Option<DAffine3> {
    let total: f64 = influences.iter().map(|(_, weight)| weight).sum();
    if influences.is_empty() || total == 0.0 {
        return joints.first().copied();
    }
    let mut mean = DAffine3 { matrix3: DMat3::ZERO, translation: glam::DVec3::ZERO };
    for &(joint, weight) in influences {
        let own = joints.get(joint)?;
        mean.matrix3 += own.matrix3 * (weight / total);
        mean.translation += own.translation * (weight / total);
    }
    Some(mean)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    #[test]
    fn vertices_follow_the_weighted_mean_of_their_joints() {
        let joints = [DVec3::X, DVec3::Y].map(DAffine3::from_translation);
        let at = |influences: &[(usize, f64)]| blend(&joints, influences).unwrap().translation;
        assert_eq!(at(&[(0, 1.0)]), DVec3::X);
        assert_eq!(at(&[(0, 0.5), (1, 1.5)]), DVec3::new(0.25, 0.75, 0.0));
        assert_eq!(at(&[]), DVec3::X);
        assert!(blend(&joints, &[(2, 1.0)]).is_none() && blend(&[], &[]).is_none());
    }
}
