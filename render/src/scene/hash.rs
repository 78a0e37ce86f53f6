//! Hashes of a scene's content: everything that an image depends on besides camera and light.

use blake3::Hasher;
use glam::{Vec2, Vec3, Vec4};

use super::{Material, Mesh, Scene, Texture};

impl Scene {
    /// Returns the BLAKE3 hash (hexadecimal) of all triangles and alpha masks: everything that visibility
    /// depends on, whatever the materials.
    pub fn geometry_hash(&self) -> String {
        let mut hasher = Hasher::new();
        for mesh in &self.meshes {
            add_floats(&mut hasher, mesh.positions.iter().map(Vec3::to_array));
            add(&mut hasher, &mesh.triangles.iter().flatten().flat_map(|i| i.to_le_bytes()).collect::<Vec<_>>());
            add_places(&mut hasher, mesh);
            add_mask(&mut hasher, mesh);
        }
        hasher.finalize().to_hex().to_string()
    }

    /// Returns the BLAKE3 hash (hexadecimal) of all meshes and materials: equal scenes have equal hashes,
    /// whatever their source.
    pub fn content_hash(&self) -> String {
        let mut hasher = Hasher::new();
        for mesh in &self.meshes {
            let space = mesh.tangent_space.clone().unwrap_or_default();
            let own = mesh.roughness_texcoords.as_deref().unwrap_or_default();
            add_floats(&mut hasher, mesh.positions.iter().map(Vec3::to_array));
            add_floats(&mut hasher, mesh.normals.iter().map(Vec3::to_array));
            for texcoords in [&mesh.texcoords[..], own, &space.texcoords] {
                add_floats(&mut hasher, texcoords.iter().map(Vec2::to_array));
            }
            add_floats(&mut hasher, space.tangents.iter().map(Vec4::to_array));
            add(&mut hasher, &mesh.triangles.iter().flatten().flat_map(|i| i.to_le_bytes()).collect::<Vec<_>>());
            let own = u64::from(mesh.roughness_texcoords.is_some());
            if !mesh.colors.is_empty() {
                add_floats(&mut hasher, mesh.colors.iter().map(Vec3::to_array));
            }
            if let Some(own) = &mesh.emission_texcoords {
                add_floats(&mut hasher, own.iter().map(Vec2::to_array));
            }
            add_places(&mut hasher, mesh);
            add_mask(&mut hasher, mesh);
            if mesh.is_single_sided {
                add(&mut hasher, b"single-sided");
            }
            add(&mut hasher, &[(mesh.material as u64).to_le_bytes(), own.to_le_bytes()].concat());
        }
        self.materials.iter().for_each(|material| add_material(&mut hasher, material));
        // The BRDFs that materials index; none in a scene of analytic BRDFs.
        self.brdfs.added().for_each(|brdf| add(&mut hasher, format!("{brdf:?}").as_bytes()));
        hasher.finalize().to_hex().to_string()
    }
}

/// Adds a list with its length, so that adjacent lists cannot be confused.
fn add(hasher: &mut Hasher, list: &[u8]) {
    hasher.update(&(list.len() as u64).to_le_bytes());
    hasher.update(list);
}

fn add_floats<const N: usize>(hasher: &mut Hasher, vectors: impl Iterator<Item = [f32; N]>) {
    add(hasher, &vectors.flatten().flat_map(f32::to_le_bytes).collect::<Vec<_>>());
}

/// Adds the transforms of a mesh's copies; nothing for meshes in world space.
fn add_places(hasher: &mut Hasher, mesh: &Mesh) {
    if !mesh.places.is_empty() {
        add(hasher, b"places");
        add_floats(hasher, mesh.places.iter().map(glam::Affine3A::to_cols_array));
    }
}

/// Adds the alpha mask of a mesh and the attributes it is evaluated on; nothing for opaque meshes.
fn add_mask(hasher: &mut Hasher, mesh: &Mesh) {
    let Some(mask) = &mesh.mask else { return };
    add(hasher, format!("mask {:?} {:?}", mask.cutoff, mask.factor).as_bytes());
    add(hasher, mask.texture.as_ref().map_or(&[] as &[u8], |texture| texture.digest()));
    add_floats(hasher, mesh.texcoords.iter().map(Vec2::to_array));
    add_floats(hasher, mesh.alphas.iter().map(|&alpha| [alpha]));
}

/// Adds a material: numbers as the shortest decimals that round-trip, textures by their texels.
fn add_material(hasher: &mut Hasher, material: &Material) {
    let Material::MetallicRoughness(textured) = material else {
        return add(hasher, format!("{material:?}").as_bytes());
    };
    let map = textured.normal_map.as_ref();
    let (color, metallic, roughness) = (textured.base_color, textured.metallic, textured.roughness);
    add(hasher, format!("{color:?} {metallic:?} {roughness:?} {:?}", map.map(|map| map.scale)).as_bytes());
    let textures = [
        textured.base_color_texture.as_ref(),
        textured.metallic_roughness_texture.as_ref(),
        map.map(|map| &map.texture),
    ];
    if textured.emission != glam::Vec3A::ZERO {
        add(hasher, format!("{:?}", textured.emission).as_bytes());
        let (shape, texels) =
            textured.emission_texture.as_ref().map_or_else(Default::default, |texture| Texture::content(texture));
        add(hasher, shape.as_bytes());
        add(hasher, texels);
    }
    for texture in textures {
        let (shape, texels) = texture.map_or_else(Default::default, |texture| Texture::content(texture));
        add(hasher, shape.as_bytes());
        add(hasher, texels);
    }
}
