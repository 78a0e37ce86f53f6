//! Scenes that are made by code: always there, and without a licence to follow.
//!
//! `temple`, `dishes`, `diorama`, `droid`, `bedroom` and `cloth` are stand-ins for the paper's scenes.
//!
//! | other file | concept |
//! | --- | --- |
//! | `arcade.rs` | a second interior |
//! | `simple.rs` | `sphere` and `plane` |
//! | `shapes.rs` | the shapes that scenes are made of |
//! | `worn.rs` | roughness that varies over a surface |

mod arcade;
mod bedroom;
mod cloth;
mod diorama;
mod dishes;
mod droid;
mod shapes;
mod simple;
mod temple;
mod worn;

use std::sync::Arc;

use glam::{Affine3A, Quat, Vec3, Vec3A};

use super::{Camera, Material, Mesh, Scene, Texture, TexturedMetallicRoughness};

/// Makes the parts of one scene.
type Generator = fn() -> Model;

/// Every built-in scene by name: stand-ins for the six of the paper, a second interior, two for tests.
const SCENES: [(&str, Generator); 9] = [
    ("temple", temple::model),
    ("dishes", dishes::model),
    ("diorama", diorama::model),
    ("droid", droid::model),
    ("bedroom", bedroom::model),
    ("cloth", cloth::model),
    ("arcade", arcade::model),
    ("sphere", simple::sphere),
    ("plane", simple::plane),
];

/// The names that [`Scene::built_in`] knows.
pub fn built_in_names() -> impl Iterator<Item = &'static str> {
    SCENES.iter().map(|&(name, _)| name)
}

/// The built-in scene of that name.
pub(super) fn build(name: &str) -> Option<Scene> {
    let &(name, generate) = SCENES.iter().find(|(known, _)| *known == name)?;
    let Model { meshes, materials, camera } = generate();
    Some(Scene::new(name, meshes, materials, Some(camera)).expect("generators use their own materials"))
}

/// A shape that takes a fabric (`--material neural:FILE`); it has texture coordinates.
fn fabric(shape: Mesh) -> Mesh {
    Mesh { name: "fabric".into(), ..shape }
}

/// A scene in the making.
struct Model {
    meshes: Vec<Mesh>,
    materials: Vec<Material>,
    camera: Camera,
}

/// The index of a material in its [`Model`].
#[derive(Clone, Copy)]
struct Paint(usize);

impl Model {
    /// An empty model seen by a camera: positions in metres, vertical field of view in degrees.
    fn seen(look_from: [f32; 3], look_at: [f32; 3], vertical_fov: f32) -> Self {
        let camera = Camera::aimed(look_from.into(), look_at.into(), vertical_fov);
        Self { meshes: Vec::new(), materials: Vec::new(), camera }
    }

    /// A new diffuse material of a linear Rec.709 albedo.
    fn paint(&mut self, albedo: [f32; 3]) -> Paint {
        self.materials.push(Material::diffuse(Vec3A::from_array(albedo)));
        Paint(self.materials.len() - 1)
    }

    /// A new metallic-roughness material of a linear Rec.709 base colour.
    fn gloss(&mut self, base_color: [f32; 3], metallic: f32, roughness: f32) -> Paint {
        self.textured(base_color, metallic, roughness, None)
    }

    /// [`Self::gloss`] whose roughness changes over the surface between the two given; shapes need [`worn::mapped`].
    fn worn(&mut self, base_color: [f32; 3], metallic: f32, roughness: [f32; 2]) -> Paint {
        self.textured(base_color, metallic, roughness[1], Some(worn::texture(roughness[0] / roughness[1])))
    }

    fn textured(&mut self, base_color: [f32; 3], metallic: f32, roughness: f32, wear: Option<Texture>) -> Paint {
        self.materials.push(Material::MetallicRoughness(TexturedMetallicRoughness {
            base_color: base_color.into(),
            base_color_texture: None,
            metallic,
            roughness,
            metallic_roughness_texture: wear.map(Arc::new),
            ..TexturedMetallicRoughness::default()
        }));
        Paint(self.materials.len() - 1)
    }

    /// Adds a shape, turned by `turn` degrees about the y axis, at a place.
    fn add_turned(&mut self, paint: Paint, shape: &Mesh, turn: f32, place: [f32; 3]) {
        let turn = Quat::from_rotation_y(turn.to_radians());
        self.add(paint, shape.clone().transformed(&Affine3A::from_rotation_translation(turn, Vec3::from(place))));
    }

    /// Adds a shape.
    fn add(&mut self, paint: Paint, mut shape: Mesh) {
        shape.material = paint.0;
        self.meshes.push(shape);
    }

    /// Adds a copy of a shape at each of the given places.
    fn add_at(&mut self, paint: Paint, shape: &Mesh, places: impl IntoIterator<Item = [f32; 3]>) {
        for place in places {
            self.add(paint, shape.clone().transformed(&Affine3A::from_translation(place.into())));
        }
    }
}
