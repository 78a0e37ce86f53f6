//! Cameras of nodes. Each is opened when it is chosen, so that broken ones that nobody uses do no harm.

use glam::{Affine3A, DAffine3, DVec3, Mat3A, Vec2};
use serde::Deserialize;
use serde_json::Value;

use super::{
    document::Document,
    json::{self, Node, Orthographic, Perspective, Whole},
};
use crate::{error::Error, scene::Camera};

/// A camera of the file with its transform.
pub struct PlacedCamera<'a> {
    camera: Result<&'a json::Camera, String>,
    /// The camera's field in the file.
    field: String,
    /// The node's name, or else the camera's; empty where neither has one.
    pub name: String,
    to_world: DAffine3,
}

impl<'a> PlacedCamera<'a> {
    /// The camera of a node, whose index is `index`; `field` is the node's.
    pub fn new(document: &'a Document, node: &Node, index: &Value, to_world: DAffine3, field: &str) -> Self {
        let index = Whole::deserialize(index).map_err(|error| error.to_string());
        let field = match &index {
            Ok(index) if document.root().cameras.get(index.index()).is_some() => format!("cameras[{}]", index.0),
            _ => format!("{field}.camera"),
        };
        let camera = index.and_then(|index| document.root().cameras.find(index.0));
        let own = camera.as_ref().ok().and_then(|camera| camera.name.as_ref());
        let name = node.name.as_ref().or(own).cloned().unwrap_or_default();
        Self { camera, field, name, to_world }
    }

    /// Returns whether the file declares a perspective camera.
    pub fn is_perspective(&self) -> bool {
        self.camera.as_ref().is_ok_and(|camera| camera.kind == "perspective")
    }

    /// Returns the camera, which looks along the node's -Z, relative to `origin`. As the specification says,
    /// the scaling of its node is ignored.
    ///
    /// # Errors
    /// The field and what is wrong with it.
    pub fn open(&self, origin: DVec3) -> Result<Camera, String> {
        self.checked(origin).map_err(|reason| format!("{}: {reason}", self.field))
    }

    fn checked(&self, origin: DVec3) -> Result<Camera, String> {
        let camera = self.camera.as_ref().map_err(String::clone)?;
        let motion = rigid(&(DAffine3::from_translation(-origin) * self.to_world));
        let opened = match (camera.kind.as_str(), &camera.perspective, &camera.orthographic) {
            ("perspective", Some(own), _) => perspective(motion, parsed::<Perspective>(own)?.yfov),
            ("orthographic", _, Some(own)) => {
                let Orthographic { ymag } = parsed(own)?;
                if !(ymag.is_finite() && ymag != 0.0) {
                    return Err(format!("orthographic.ymag: {ymag} is not a height"));
                }
                Camera::orthographic(motion, ymag.abs())
            }
            ("perspective" | "orthographic", ..) => return Err("has none of its projection".into()),
            _ => return Err("type: is not a camera type of glTF".into()),
        };
        opened.map_err(|error| match error {
            Error::Argument { what, reason } => format!("{what}: {reason}"),
            other => other.to_string(),
        })
    }
}

fn parsed<'a, T: Deserialize<'a>>(value: &'a Value) -> Result<T, String> {
    T::deserialize(value).map_err(|error| error.to_string())
}

fn perspective(motion: Affine3A, vertical_fov: f32) -> crate::error::Result<Camera> {
    let look_from = motion.translation;
    // Far from the origin of the coordinates, one metre ahead would be rounded away.
    let look_at = look_from - motion.matrix3.z_axis * look_from.abs().max_element().max(1.0);
    let upright = Camera::new(look_from, look_at, vertical_fov.to_degrees())?;
    // Rounding to six digits gives a camera without roll one of 0.001 degrees.
    let is_upright = upright.to_world().matrix3.y_axis.dot(motion.matrix3.y_axis) > 1.0 - 1e-6;
    if is_upright { Ok(upright) } else { Camera::of_photograph(motion, (0.5 * vertical_fov).tan(), Vec2::ZERO) }
}

/// Returns the rotation and the translation of a transform. Of a mirroring one, the view axis and the
/// vertical are kept, and of one that flattens an axis, the two others. `Camera` checks that it is a rotation.
fn rigid(to_world: &DAffine3) -> Affine3A {
    // In 64 bits, the squares of small scales do not vanish.
    let [x, y, z] =
        [to_world.matrix3.x_axis, to_world.matrix3.y_axis, to_world.matrix3.z_axis].map(DVec3::normalize_or_zero);
    let back = if z == DVec3::ZERO { x.cross(y).normalize_or_zero() } else { z };
    let up = if y == DVec3::ZERO { back.cross(x) } else { y };
    let up = up.reject_from_normalized(back).normalize_or_zero();
    let axes = [up.cross(back), up, back].map(DVec3::as_vec3a);
    Affine3A { matrix3: Mat3A::from_cols(axes[0], axes[1], axes[2]), translation: to_world.translation.as_vec3a() }
}
