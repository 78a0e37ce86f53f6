//! Project files of fSpy, the program that finds a photograph's camera from its vanishing points.
//!
//! A file is `fspy`, three 32-bit little-endian numbers (version 1, bytes of the state, bytes of the image),
//! the state as JSON, and the image as the file that was opened. Only `cameraParameters` is read from the
//! state; it is `null` where vanishing points give no camera. On its image plane, the longer side of the
//! image is from -1 to 1, y upwards; the focal length and the principal point are in these units.

use std::{io::Read, path::Path};

use glam::{Affine3A, Mat3A, Vec2, Vec3, Vec3A};
use serde::Deserialize;

use super::Camera;
use crate::{
    error::{Error, Result},
    file::open_regular,
    image::Photograph,
};

/// The first bytes of every file.
const MAGIC: &[u8; 4] = b"fspy";
const VERSION: u32 = 1;
const HEADER: usize = 16;
/// Maximum size of a file in bytes; photographs of 100 megapixels are smaller.
const MAX_BYTES: u64 = 1 << 30;
/// Maximum size of the state in bytes; in practice it is a few thousand.
const MAX_STATE_BYTES: usize = 1 << 24;
/// The largest width and height of an image.
const MAX_SIDE: u32 = 1 << 16;

/// The axis of a project's world that points up. fSpy leaves the choice to the user who names the vanishing
/// points; its importer for Blender keeps the axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UpAxis {
    /// +Y, as in this crate.
    Y,
    /// +Z, as in Blender.
    #[default]
    Z,
}

impl UpAxis {
    /// Returns the rotation from the file's world to the one in which +Y is up.
    fn to_y_up(self) -> Mat3A {
        match self {
            Self::Y => Mat3A::IDENTITY,
            // (x, y, z) with z up is (x, z, -y).
            Self::Z => Mat3A::from_cols(Vec3A::X, Vec3A::NEG_Z, Vec3A::Y),
        }
    }
}

/// A project: a camera and usually its photograph.
#[derive(Clone, Debug)]
pub struct FspyProject {
    /// The camera in a world with +Y up. Lengths are in the unit of the file's reference distance.
    pub camera: Camera,
    /// Width of the photograph in pixels.
    pub width: u32,
    /// Height of the photograph in pixels.
    pub height: u32,
    /// The photograph as the file (PNG, JPEG, …) that was opened in fSpy; may be empty.
    pub image: Vec<u8>,
}

/// The part of the state that is read.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct State {
    camera_parameters: Option<Parameters>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Parameters {
    principal_point: Point,
    camera_transform: Transform,
    horizontal_field_of_view: f64,
    /// Missing in files of the first versions.
    relative_focal_length: Option<f64>,
    image_width: u32,
    image_height: u32,
}

#[derive(Deserialize)]
struct Point {
    x: f64,
    y: f64,
}

#[derive(Deserialize)]
struct Transform {
    rows: [[f64; 4]; 4],
}

impl FspyProject {
    /// Reads a file whose world has the given axis up.
    ///
    /// # Errors
    /// When the file cannot be read, is not a project of version 1, is cut off, or has no valid camera.
    pub fn read(path: &Path, up: UpAxis) -> Result<Self> {
        let (file, size) = open_regular(path).map_err(|error| Error::io(path, error))?;
        if size > MAX_BYTES {
            return Err(Error::invalid(path, "file", format!("has {size} bytes; up to {MAX_BYTES} are read")));
        }
        let mut bytes = Vec::new();
        file.take(MAX_BYTES).read_to_end(&mut bytes).map_err(|error| Error::io(path, error))?;
        Self::decode(&bytes, up).map_err(|error| error.in_file(path))
    }

    /// Reads the bytes of a file.
    ///
    /// # Errors
    /// As [`Self::read`]; the error names the field.
    pub fn decode(bytes: &[u8], up: UpAxis) -> Result<Self> {
        if !bytes.starts_with(MAGIC) {
            return Err(Error::argument("first bytes", "are not those of an fSpy project"));
        }
        let Some(header) = bytes.get(..HEADER) else {
            return Err(Error::argument("header", format!("is cut off after {} of {HEADER} bytes", bytes.len())));
        };
        let number =
            |k: usize| u32::from_le_bytes(*header[4 * k..].first_chunk().expect("sixteen bytes are four numbers"));
        let (version, state_size, image_size) = (number(1), number(2) as usize, number(3) as usize);
        if version != VERSION {
            return Err(Error::argument("version", format!("is {version}; only version {VERSION} is known")));
        }
        if state_size > MAX_STATE_BYTES {
            return Err(Error::argument(
                "state size",
                format!("is {state_size} bytes; up to {MAX_STATE_BYTES} are read"),
            ));
        }
        let left = bytes.len() - HEADER;
        if state_size.checked_add(image_size) != Some(left) {
            let reason =
                format!("state and image take {state_size} and {image_size} bytes, but {left} follow the header");
            return Err(Error::argument("sizes", reason));
        }
        let (state, image) = bytes[HEADER..].split_at(state_size);
        let state: State = serde_json::from_slice(state)
            .map_err(|error| Error::argument("state", format!("is not what fSpy writes: {error}")))?;
        let Some(parameters) = state.camera_parameters else {
            let reason = "is null: the vanishing points give no camera; open the project in fSpy and move them";
            return Err(Error::argument("cameraParameters", reason));
        };
        let (width, height) = (parameters.image_width, parameters.image_height);
        let camera = parameters.camera(up)?;
        Ok(Self { camera, width, height, image: image.to_vec() })
    }

    /// Encodes the project in a world with the given axis up.
    pub fn encode(&self, up: UpAxis) -> Vec<u8> {
        let state = self.state(up).to_string();
        let mut bytes = MAGIC.to_vec();
        for number in [VERSION, state.len() as u32, self.image.len() as u32] {
            bytes.extend(number.to_le_bytes());
        }
        bytes.extend(state.as_bytes());
        bytes.extend(&self.image);
        bytes
    }

    /// Decodes the photograph.
    ///
    /// # Errors
    /// When there is none, or it is neither PNG nor JPEG.
    pub fn photograph(&self) -> Result<Photograph> {
        if self.image.is_empty() {
            return Err(Error::argument("image", "the project holds none; name a photograph"));
        }
        // The camera refers to the pixels as stored, without EXIF orientation.
        Photograph::decode_stored(&self.image).map_err(|reason| Error::argument("image", reason))
    }

    /// Returns a state that holds the camera parameters only.
    fn state(&self, up: UpAxis) -> serde_json::Value {
        let (width, height) = (f64::from(self.width), f64::from(self.height));
        let half_height = half_height(width, height);
        let focal = half_height / f64::from(self.camera.half_height());
        let point = half_height * self.camera.principal_point().as_dvec2();
        let turn = Affine3A { matrix3: up.to_y_up().transpose(), translation: Vec3A::ZERO };
        let to_world = self.camera.moved(&turn).to_world();
        // The vanishing point of a world direction.
        let vanishing = |axis: Vec3A| {
            let seen = to_world.inverse().transform_vector3a(axis).as_dvec3();
            serde_json::json!({ "x": point.x - focal * seen.x / seen.z, "y": point.y - focal * seen.y / seen.z })
        };
        let third = if up == UpAxis::Z { "zPositive" } else { "yPositive" };
        let second = if up == UpAxis::Z { ("yPositive", Vec3A::Y) } else { ("zPositive", Vec3A::Z) };
        let top = if up == UpAxis::Z { Vec3A::Z } else { Vec3A::Y };
        serde_json::json!({
            "cameraParameters": {
                "principalPoint": { "x": point.x, "y": point.y },
                "viewTransform": { "rows": rows(&to_world.inverse()) },
                "cameraTransform": { "rows": rows(&to_world) },
                // As in fSpy, these assume a landscape. For a portrait, Blender's importer takes the first as
                // that of the longer side.
                "horizontalFieldOfView": 2.0 * (1.0 / focal).atan(),
                "verticalFieldOfView": 2.0 * (height / width / focal).atan(),
                "vanishingPoints": [vanishing(Vec3A::X), vanishing(second.1), vanishing(top)],
                "vanishingPointAxes": ["xPositive", second.0, third],
                "relativeFocalLength": focal,
                "imageWidth": self.width,
                "imageHeight": self.height,
            }
        })
    }
}

impl Parameters {
    fn camera(&self, up: UpAxis) -> Result<Camera> {
        let (width, height) = (self.image_width, self.image_height);
        if !(1..=MAX_SIDE).contains(&width) || !(1..=MAX_SIDE).contains(&height) {
            let reason = format!("{width} x {height} is not the size of an image");
            return Err(Error::argument("cameraParameters.imageWidth", reason));
        }
        // `horizontalFieldOfView` is that of the longer side.
        let focal = self.relative_focal_length.unwrap_or_else(|| 1.0 / (0.5 * self.horizontal_field_of_view).tan());
        if !(focal > 0.0 && focal.is_finite()) {
            let reason = format!("{focal} is not a focal length");
            return Err(Error::argument("cameraParameters.relativeFocalLength", reason));
        }
        let rows = &self.camera_transform.rows;
        if rows[3] != [0.0, 0.0, 0.0, 1.0] {
            return Err(Error::argument("cameraParameters.cameraTransform", "its last row is not 0 0 0 1"));
        }
        let column = |k: usize| Vec3::new(rows[0][k] as f32, rows[1][k] as f32, rows[2][k] as f32);
        let axes = Mat3A::from_cols(column(0).into(), column(1).into(), column(2).into());
        let turn = up.to_y_up();
        let to_world = Affine3A { matrix3: turn * axes, translation: turn * Vec3A::from(column(3)) };
        let half_height = half_height(f64::from(width), f64::from(height));
        let point =
            Vec2::new((self.principal_point.x / half_height) as f32, (self.principal_point.y / half_height) as f32);
        Camera::of_photograph(to_world, (half_height / focal) as f32, point).map_err(|error| match error {
            Error::Argument { what, reason } => Error::argument(format!("cameraParameters: {what}"), reason),
            other => other,
        })
    }
}

/// Half the height of an image whose longer side is from -1 to 1.
fn half_height(width: f64, height: f64) -> f64 {
    height / width.max(height)
}

fn rows(transform: &Affine3A) -> [[f32; 4]; 4] {
    let (m, t) = (transform.matrix3, transform.translation);
    let row = |k: usize| [m.x_axis[k], m.y_axis[k], m.z_axis[k], t[k]];
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

#[cfg(test)]
mod tests;
