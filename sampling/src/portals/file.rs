//! The file format of portals: JSON, as `headtail inspect --portals` writes it.

use std::path::Path;

use glam::Vec3A;
use serde::Deserialize;

use super::Portal;
use crate::{
    error::{Error, Result},
    file,
};

/// Portals of a file at most.
const MOST: usize = 64;

#[derive(Deserialize)]
struct File {
    portals: Vec<Rectangle>,
}

/// Other fields are ignored.
#[derive(Deserialize)]
struct Rectangle {
    center: [f32; 3],
    normal: [f32; 3],
    up: [f32; 3],
    width: f32,
    height: f32,
}

/// Reads a file of portals, `{"portals": [{"center", "normal", "up", "width", "height"}]}`, in metres. Normals
/// point into the room; directions have any length, and `up` is made perpendicular to the normal.
///
/// # Errors
/// The file cannot be read, is not of this form, has no portal or more than 64, or one of them is not a rectangle.
pub fn read(path: &Path) -> Result<Vec<Portal>> {
    let text = file::read_text(path).map_err(|error| Error::io(path, error))?;
    let File { portals } =
        serde_json::from_str(&text).map_err(|error| Error::invalid(path, "portals", error.to_string()))?;
    if portals.is_empty() || portals.len() > MOST {
        return Err(Error::invalid(path, "portals", format!("has {}; 1 to {MOST} are possible", portals.len())));
    }
    let of = |(number, rectangle): (usize, &Rectangle)| {
        let wrong = |reason: &str| Error::invalid(path, format!("portals[{number}]"), reason);
        rectangle.portal().map_err(wrong)
    };
    portals.iter().enumerate().map(of).collect()
}

impl Rectangle {
    fn portal(&self) -> std::result::Result<Portal, &'static str> {
        let Self { center, normal, up, width, height } = self;
        if !center.iter().all(|number| number.abs() < 1e9) {
            return Err("'center' is not finite");
        }
        if ![width, height].iter().all(|&&size| size > 1e-9 && size < 1e9) {
            return Err("'width' and 'height' are not positive");
        }
        let normal = Vec3A::from_array(*normal).try_normalize().ok_or("'normal' is not a direction")?;
        let up = Vec3A::from_array(*up).try_normalize().ok_or("'up' is not a direction")?;
        let across = up.reject_from_normalized(normal);
        if across.length() < 1e-3 {
            return Err("'up' is parallel to 'normal'");
        }
        let center = Vec3A::from_array(*center);
        Ok(Portal { center, normal, up: across.normalize(), width: *width, height: *height })
    }
}

/// Returns the text of a file, with the corners of each portal for other programs.
pub fn to_json(portals: &[Portal]) -> String {
    let portals: Vec<_> = portals
        .iter()
        .map(|portal| {
            serde_json::json!({
                "center": portal.center.to_array(),
                "normal": portal.normal.to_array(),
                "up": portal.up.to_array(),
                "width": portal.width,
                "height": portal.height,
                "corners": portal.corners().map(|corner| corner.to_array()),
            })
        })
        .collect();
    format!("{:#}\n", serde_json::json!({ "portals": portals }))
}
