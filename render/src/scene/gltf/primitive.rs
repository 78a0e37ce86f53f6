//! From the primitives of a mesh to triangles in world space.

use glam::{Vec2, Vec3, Vec4};
use gltf::{
    Semantic,
    json::{
        mesh::{Mode, Primitive},
        validation::Checked,
    },
};

use super::{
    accessor::{read_indices, read_vectors},
    document::Document,
    in_field,
    nodes::Instance,
};
use crate::{
    error::Result,
    scene::{Mesh, TangentSpace},
};

/// The triangles of an instance, one mesh per primitive; points and lines are left out.
pub fn read_mesh(document: &Document, instance: &Instance) -> Result<Vec<Mesh>> {
    let mut meshes = Vec::new();
    for (i, primitive) in document.root().meshes[instance.mesh].primitives.iter().enumerate() {
        let field = format!("meshes[{}].primitives[{i}]", instance.mesh);
        let Some(mesh) = read_primitive(document, primitive, &field)? else { continue };
        let Mesh { positions, normals, texcoords, roughness_texcoords, tangent_space, triangles, material, .. } =
            mesh.transformed(&instance.to_world);
        // Checked a second time: the transform may have made them infinite.
        let placed = Mesh::new(positions, normals, texcoords, triangles, material).map(|mesh| Mesh {
            roughness_texcoords,
            tangent_space,
            name: instance.name.clone(),
            ..mesh
        });
        meshes.push(placed.map_err(|error| in_field(document, &format!("{field}, placed by its node"), error))?);
    }
    Ok(meshes)
}

/// A primitive in the coordinates of its mesh.
fn read_primitive(document: &Document, primitive: &Primitive, field: &str) -> Result<Option<Mesh>> {
    let Checked::Valid(mode) = primitive.mode else {
        return Err(document.invalid(format!("{field}.mode"), "is not a mode of glTF"));
    };
    if !matches!(mode, Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
        return Ok(None);
    }
    let attribute = |semantic: Semantic| primitive.attributes.get(&Checked::Valid(semantic)).copied();
    let at = |name: &str| format!("{field}.attributes.{name}");

    let Some(positions) = attribute(Semantic::Positions) else {
        return Err(document.invalid(at("POSITION"), "is missing"));
    };
    let positions = read_vectors(document, positions, &at("POSITION"))?;
    let normals = match attribute(Semantic::Normals) {
        Some(normals) => read_vectors(document, normals, &at("NORMAL"))?,
        None => Vec::new(),
    };
    let (material, [color_set, roughness_set, normal_set]) = material(document, primitive, field)?;
    let texcoords = |set: Option<u32>| -> Result<Vec<Vec2>> {
        Ok(match set.and_then(|set| attribute(Semantic::TexCoords(set))) {
            Some(texcoords) => {
                read_vectors(document, texcoords, &at("TEXCOORD"))?.into_iter().map(Vec2::from_array).collect()
            }
            None => Vec::new(),
        })
    };
    let roughness_texcoords = if roughness_set == color_set { None } else { Some(texcoords(roughness_set)?) };
    let tangent_space = TangentSpace {
        texcoords: texcoords(normal_set)?,
        tangents: match attribute(Semantic::Tangents).filter(|_| normal_set.is_some()) {
            Some(tangents) => {
                read_vectors(document, tangents, &at("TANGENT"))?.into_iter().map(Vec4::from_array).collect()
            }
            None => Vec::new(),
        },
    };
    let texcoords = match color_set {
        Some(_) => texcoords(color_set)?,
        // Materials that are given by name want coordinates where no texture of the file does. Broken ones are none: the file is whole without.
        None => {
            let is_whole = |own: &Vec<Vec2>| own.len() == positions.len() && own.iter().all(|place| place.is_finite());
            texcoords(Some(0)).ok().filter(is_whole).unwrap_or_default()
        }
    };
    let indices = match primitive.indices {
        Some(indices) => read_indices(document, indices, &format!("{field}.indices"))?,
        None => {
            document.reserve_elements(positions.len() as u64, field)?;
            (0..positions.len() as u32).collect()
        }
    };
    Mesh::new(
        positions.into_iter().map(Vec3::from_array).collect(),
        normals.into_iter().map(Vec3::from_array).collect(),
        texcoords,
        triangles(mode, &indices),
        material,
    )
    .and_then(|mesh| match roughness_texcoords {
        Some(texcoords) => mesh.with_roughness_texcoords(texcoords),
        None => Ok(mesh),
    })
    .and_then(|mesh| mesh.with_tangent_space(tangent_space))
    .map(Some)
    .map_err(|error| in_field(document, field, error))
}

/// The index of the primitive's material, and the sets of texture coordinates that its base-colour, its
/// metallic-roughness and its normal texture want.
///
/// The index after the last one is the default material.
fn material(document: &Document, primitive: &Primitive, field: &str) -> Result<(usize, [Option<u32>; 3])> {
    let Some(index) = primitive.material else { return Ok((document.root().materials.len(), [None; 3])) };
    let material = document.get(index, &format!("{field}.material"))?;
    let pbr = &material.pbr_metallic_roughness;
    let [color, roughness] = [&pbr.base_color_texture, &pbr.metallic_roughness_texture]
        .map(|texture| texture.as_ref().map(|texture| texture.tex_coord));
    let normal = material.normal_texture.as_ref().map(|texture| texture.tex_coord);
    Ok((index.value(), [color, roughness, normal]))
}

/// The triangles of a list, strip or fan of vertices; a rest that makes no triangle is left out.
fn triangles(mode: Mode, indices: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        Mode::TriangleStrip => {
            let turned = |(i, t): (usize, &[u32])| if i % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] };
            indices.windows(3).enumerate().map(turned).collect()
        }
        Mode::TriangleFan => indices.windows(2).skip(1).map(|edge| [indices[0], edge[0], edge[1]]).collect(),
        _ => indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_strips_and_fans() {
        let indices = [7, 8, 9, 10, 11];
        assert_eq!(triangles(Mode::Triangles, &indices), [[7, 8, 9]]);
        assert_eq!(triangles(Mode::TriangleStrip, &indices), [[7, 8, 9], [9, 8, 10], [9, 10, 11]]);
        assert_eq!(triangles(Mode::TriangleFan, &indices), [[7, 8, 9], [7, 9, 10], [7, 10, 11]]);
        for mode in [Mode::Triangles, Mode::TriangleStrip, Mode::TriangleFan] {
            for n in 0..3 {
                assert!(triangles(mode, &indices[..n]).is_empty());
            }
        }
    }
}
