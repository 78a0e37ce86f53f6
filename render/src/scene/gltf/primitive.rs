//! The triangles of a mesh's primitives.

use glam::{DAffine3, Vec2, Vec3, Vec4};

use super::{
    accessor::{has_components, read_indices, read_vectors},
    document::{Document, in_field},
    json::{self, Primitive, TextureInfo, TextureTransform, Whole},
    skins::bend,
};
use crate::{
    error::Result,
    scene::{Mesh, TangentSpace},
};

/// The modes of primitives that have triangles.
const TRIANGLES: u64 = 4;
const TRIANGLE_STRIP: u64 = 5;
const TRIANGLE_FAN: u64 = 6;

/// Reads the triangles of a mesh in its own coordinates, one mesh per primitive; points and lines are left
/// out. `weights` are those of morph targets, `joints` the transforms of a skin, if there is one.
pub fn read_mesh(document: &Document, index: usize, weights: Option<&[f32]>, joints: &[DAffine3]) -> Result<Vec<Mesh>> {
    let own = document.get(&document.root().meshes, Whole(index as u64), "meshes")?;
    let weights = weights.unwrap_or(&own.weights);
    let mut meshes = Vec::new();
    for (i, primitive) in own.primitives.iter().enumerate() {
        let field = format!("meshes[{index}].primitives[{i}]");
        if !weights.is_empty() && weights.len() != primitive.targets.len() {
            let reason = format!("has {} morph targets for {} weights", primitive.targets.len(), weights.len());
            return Err(document.invalid(field, reason));
        }
        if let Some(extension) = extension_with_data(document, own, primitive) {
            let named =
                own.name.as_ref().map_or_else(String::new, |name| format!(" of mesh '{}'", name.escape_debug()));
            let reason =
                format!("the data{named} are in the extension {}, which is not read", extension.escape_debug());
            return Err(document.invalid(field, reason));
        }
        let Some(mesh) = read_primitive(document, primitive, weights, &field)? else { continue };
        meshes.push(if joints.is_empty() { mesh } else { bend(document, primitive, joints, mesh, &field)? });
    }
    Ok(meshes)
}

/// Returns the extension that has data of a primitive for which the file has no other source. Accessors
/// without data are otherwise zeros.
fn extension_with_data<'a>(document: &'a Document, mesh: &'a json::Mesh, primitive: &'a Primitive) -> Option<&'a str> {
    let root = document.root();
    let of_accessor = |index: &Whole| {
        let accessor = root.accessors.get(index.index())?;
        let places = match accessor.buffer_view {
            Some(view) => {
                let view = root.buffer_views.get(view.index())?;
                let buffer = root.buffers.get(view.buffer.index())?;
                let has_bytes = document.has_bytes(buffer, view.buffer.index());
                (!has_bytes).then_some([&view.extensions, &buffer.extensions, &accessor.extensions])
            }
            None => {
                let is_bare = accessor.sparse.is_none();
                is_bare.then_some([&primitive.extensions, &mesh.extensions, &accessor.extensions])
            }
        };
        let mut names = places?.into_iter().flat_map(|extensions| &extensions.0);
        names.find(|name| !Document::reads_extension(name)).map(String::as_str)
    };
    primitive.attributes.values().chain(&primitive.indices).filter_map(of_accessor).min()
}

/// Reads a primitive in the coordinates of its mesh; `None` if it has no triangles.
fn read_primitive(document: &Document, primitive: &Primitive, weights: &[f32], field: &str) -> Result<Option<Mesh>> {
    let mode = match primitive.mode.map_or(TRIANGLES, |mode| mode.0) {
        mode @ TRIANGLES..=TRIANGLE_FAN => mode,
        0..TRIANGLES => return Ok(None),
        _ => return Err(document.invalid(format!("{field}.mode"), "is not a mode of glTF")),
    };
    if !primitive.attributes.contains_key("POSITION") {
        document.warn("left out primitives without POSITION");
        return Ok(None);
    }
    let attributes = Attributes { document, primitive, weights, field };
    let positions = attributes.positions()?;
    let indices = match primitive.indices {
        Some(indices) => read_indices(document, indices, &format!("{field}.indices"))?,
        None => {
            document.reserve_elements(positions.len() as u64, field)?;
            (0..positions.len() as u32).collect()
        }
    };
    let triangles = triangles(mode, &indices);
    let mut normals = attributes.normals()?;
    if let Some(normals) = &mut normals {
        repair_normals(document, normals, &positions, &triangles);
    }
    let (material, [color, roughness, normal, emission]) = material(document, primitive, field)?;
    let coordinates = |info: Option<&TextureInfo>| info.map_or(Ok(Vec::new()), |info| attributes.texcoords_of(info));
    let own_coordinates = |other: Option<&TextureInfo>| {
        let is_shared = match (color, other) {
            (Some(a), Some(b)) => (set_of(a), transform_of(a)) == (set_of(b), transform_of(b)),
            (a, b) => a.is_none() && b.is_none(),
        };
        if is_shared { Ok(None) } else { coordinates(other).map(Some) }
    };
    let roughness_texcoords = own_coordinates(roughness)?;
    // Most surfaces emit nothing.
    let emission_texcoords = if emission.is_some() { own_coordinates(emission)? } else { None };
    let tangent_space = TangentSpace {
        texcoords: coordinates(normal)?,
        tangents: if normal.is_some() { attributes.tangents()? } else { Vec::new() },
    };
    let texcoords = match color {
        Some(info) => attributes.texcoords_of(info)?,
        // Materials of `--material` may need coordinates that no texture of the file uses. Invalid ones are
        // dropped, because the file does not need them.
        None => {
            let is_whole = |own: &Vec<Vec2>| own.len() == positions.len() && own.iter().all(|place| place.is_finite());
            attributes.texcoords(Whole(0)).ok().filter(is_whole).unwrap_or_default()
        }
    };
    let is_masked = document.root().materials.get(material).is_some_and(json::Material::is_masked);
    let (colors, alphas) = attributes.colors(is_masked)?;
    Mesh::new(positions, normals.unwrap_or_default(), texcoords, triangles, material)
        .and_then(|mesh| match roughness_texcoords {
            Some(texcoords) => mesh.with_roughness_texcoords(texcoords),
            None => Ok(mesh),
        })
        .and_then(|mesh| match emission_texcoords {
            Some(texcoords) => mesh.with_emission_texcoords(texcoords),
            None => Ok(mesh),
        })
        .and_then(|mesh| mesh.with_tangent_space(tangent_space))
        .and_then(|mesh| mesh.with_colors(colors))
        .and_then(|mesh| mesh.with_alphas(alphas))
        .map(Some)
        .map_err(|error| in_field(document, field, error))
}

/// The vertex attributes of a primitive, moved to the weighted morph targets.
struct Attributes<'a> {
    document: &'a Document,
    primitive: &'a Primitive,
    weights: &'a [f32],
    field: &'a str,
}

impl Attributes<'_> {
    fn find(&self, name: &str) -> Option<(Whole, String)> {
        let accessor = *self.primitive.attributes.get(name)?;
        Some((accessor, format!("{}.attributes.{name}", self.field)))
    }

    fn positions(&self) -> Result<Vec<Vec3>> {
        // The caller skips primitives without positions.
        let Some((accessor, field)) = self.find("POSITION") else { return Ok(Vec::new()) };
        self.morphed("POSITION", read_vectors(self.document, accessor, &field)?)
    }

    /// `None` for flat shading.
    fn normals(&self) -> Result<Option<Vec<Vec3>>> {
        let Some((accessor, field)) = self.find("NORMAL") else { return Ok(None) };
        self.morphed("NORMAL", read_vectors(self.document, accessor, &field)?).map(Some)
    }

    fn tangents(&self) -> Result<Vec<Vec4>> {
        let Some((accessor, field)) = self.find("TANGENT") else { return Ok(Vec::new()) };
        Ok(read_vectors(self.document, accessor, &field)?.into_iter().map(Vec4::from_array).collect())
    }

    /// Adds the weighted displacements of the targets to the values of an attribute.
    fn morphed(&self, name: &str, values: Vec<[f32; 3]>) -> Result<Vec<Vec3>> {
        let mut values: Vec<Vec3> = values.into_iter().map(Vec3::from_array).collect();
        for (k, (target, &weight)) in self.primitive.targets.iter().zip(self.weights).enumerate() {
            let Some(&accessor) = target.get(name).filter(|_| weight != 0.0) else { continue };
            let field = format!("{}.targets[{k}].{name}", self.field);
            let moves = read_vectors::<3>(self.document, accessor, &field)?;
            if moves.len() != values.len() || !weight.is_finite() {
                let reason = format!("has {} displacements for {} vertices", moves.len(), values.len());
                return Err(self.document.invalid(field, reason));
            }
            for (value, by) in values.iter_mut().zip(moves) {
                *value += weight * Vec3::from_array(by);
            }
        }
        Ok(values)
    }

    /// Linear colours that multiply the base colour, and their alphas if `is_masked`.
    fn colors(&self, is_masked: bool) -> Result<(Vec<Vec3>, Vec<f32>)> {
        let Some((accessor, field)) = self.find("COLOR_0") else { return Ok((Vec::new(), Vec::new())) };
        if has_components::<4>(self.document, accessor) {
            let colors = read_vectors::<4>(self.document, accessor, &field)?;
            let alphas = if is_masked { colors.iter().map(|color| color[3]).collect() } else { Vec::new() };
            return Ok((colors.into_iter().map(|[r, g, b, _]| Vec3::new(r, g, b)).collect(), alphas));
        }
        let colors = read_vectors(self.document, accessor, &field)?.into_iter().map(Vec3::from_array).collect();
        Ok((colors, Vec::new()))
    }

    /// A set of texture coordinates; empty where there is none.
    fn texcoords(&self, set: Whole) -> Result<Vec<Vec2>> {
        let Some((accessor, field)) = self.find(&format!("TEXCOORD_{}", set.0)) else { return Ok(Vec::new()) };
        Ok(read_vectors(self.document, accessor, &field)?.into_iter().map(Vec2::from_array).collect())
    }

    /// The coordinates of a texture, after its `KHR_texture_transform`.
    fn texcoords_of(&self, info: &TextureInfo) -> Result<Vec<Vec2>> {
        let mut texcoords = self.texcoords(set_of(info))?;
        if let Some(transform) = transform_of(info) {
            let TextureTransform { offset, rotation, scale, .. } = transform;
            // Counter-clockwise as seen, v downwards.
            let (sin, cos) = rotation.sin_cos();
            for uv in &mut texcoords {
                let scaled = *uv * Vec2::from_array(scale);
                let turned = Vec2::new(cos * scaled.x + sin * scaled.y, cos * scaled.y - sin * scaled.x);
                *uv = turned + Vec2::from_array(offset);
            }
        }
        Ok(texcoords)
    }
}

/// The coordinate set of a texture, which its transform may override.
fn set_of(info: &TextureInfo) -> Whole {
    info.extensions.transform.and_then(|transform| transform.tex_coord).unwrap_or(info.tex_coord)
}

/// The transform of a texture's coordinates, if it changes them.
fn transform_of(info: &TextureInfo) -> Option<TextureTransform> {
    let transform = TextureTransform { tex_coord: None, ..info.extensions.transform? };
    (transform != TextureTransform::default()).then_some(transform)
}

/// Replaces invalid vertex normals by those of adjacent triangles, weighted by their areas.
fn repair_normals(document: &Document, normals: &mut [Vec3], positions: &[Vec3], triangles: &[[u32; 3]]) {
    let is_broken = |normal: &Vec3| !normal.is_finite() || *normal == Vec3::ZERO;
    let count = normals.iter().filter(|normal| is_broken(normal)).count();
    // Lists of different lengths are rejected later.
    if count == 0 || normals.len() != positions.len() {
        return;
    }
    let mut sums = vec![Vec3::ZERO; normals.len()];
    for triangle in triangles {
        let corners = triangle.map(|i| positions.get(i as usize).copied());
        let [Some(a), Some(b), Some(c)] = corners else { continue };
        let normal = (b - a).cross(c - a);
        triangle.iter().for_each(|&i| sums[i as usize] += normal);
    }
    for (normal, sum) in normals.iter_mut().zip(sums).filter(|(normal, _)| is_broken(normal)) {
        // A vertex without triangles is not visible.
        *normal = sum.try_normalize().unwrap_or(Vec3::ZERO);
    }
    document.warn(format!("replaced {count} invalid normals by those of adjacent triangles"));
}

/// Returns the index of the primitive's material, and its references to the textures of base colour,
/// metalness and roughness, normals and emission.
///
/// The index after the last one is the default material.
fn material<'a>(
    document: &'a Document,
    primitive: &Primitive,
    field: &str,
) -> Result<(usize, [Option<&'a TextureInfo>; 4])> {
    let materials = &document.root().materials;
    let Some(index) = primitive.material else { return Ok((materials.len(), [None; 4])) };
    let material = document.get(materials, index, &format!("{field}.material"))?;
    let pbr = &material.pbr_metallic_roughness;
    let textures = [
        &pbr.base_color_texture,
        &pbr.metallic_roughness_texture,
        &material.normal_texture,
        &material.emissive_texture,
    ];
    Ok((index.index(), textures.map(Option::as_ref)))
}

/// Returns the triangles of a list, strip or fan of vertices; incomplete triangles are left out.
fn triangles(mode: u64, indices: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        TRIANGLE_STRIP => {
            let turned = |(i, t): (usize, &[u32])| if i % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] };
            indices.windows(3).enumerate().map(turned).collect()
        }
        TRIANGLE_FAN => indices.windows(2).skip(1).map(|edge| [indices[0], edge[0], edge[1]]).collect(),
        _ => indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_strips_and_fans() {
        let indices = [7, 8, 9, 10, 11];
        assert_eq!(triangles(TRIANGLES, &indices), [[7, 8, 9]]);
        assert_eq!(triangles(TRIANGLE_STRIP, &indices), [[7, 8, 9], [9, 8, 10], [9, 10, 11]]);
        assert_eq!(triangles(TRIANGLE_FAN, &indices), [[7, 8, 9], [7, 9, 10], [7, 10, 11]]);
        for mode in [TRIANGLES, TRIANGLE_STRIP, TRIANGLE_FAN] {
            for n in 0..3 {
                assert!(triangles(mode, &indices[..n]).is_empty());
            }
        }
    }
}
