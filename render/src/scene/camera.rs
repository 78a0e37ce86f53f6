//! The pinhole camera.

use glam::Vec3A;

use super::ray::{Bounds, Ray};
use crate::error::{Error, Result};

/// The width over height for which [`Camera::framing`] fits a scene.
const FRAMED_ASPECT: f32 = 4.0 / 3.0;

/// Free space around a framed scene, as a factor on its distance.
const FRAMING_MARGIN: f32 = 1.08;

/// A pinhole camera with up = +Y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    look_from: Vec3A,
    look_at: Vec3A,
    vertical_fov: f32,
    /// Half the image's height at distance 1.
    half_height: f32,
    right: Vec3A,
    up: Vec3A,
    forward: Vec3A,
}

impl Camera {
    /// A camera at `look_from` (metres) that points to `look_at`, of `vertical_fov` degrees.
    ///
    /// Looking straight up or down, the top of the image is towards -Z and +Z.
    ///
    /// # Errors
    /// When the two points are equal or not finite, or the angle is not inside (0, 180).
    pub fn new(look_from: Vec3A, look_at: Vec3A, vertical_fov: f32) -> Result<Self> {
        if !(vertical_fov > 0.0 && vertical_fov < 180.0) {
            let reason = format!("{vertical_fov} is not between 0 and 180 degrees");
            return Err(Error::argument("vertical field of view", reason));
        }
        let Some(forward) = (look_at - look_from).try_normalize() else {
            let reason = format!("{look_from} and {look_at} do not give a direction");
            return Err(Error::argument("camera positions", reason));
        };
        // Within 1e-6 of the vertical, forward x Y has lost its digits: the image's top is a convention there.
        let right = forward.cross(Vec3A::Y);
        let right = if right.length_squared() > 1e-12 { right.normalize() } else { Vec3A::X };
        let half_height = (0.5 * vertical_fov.to_radians()).tan();
        Ok(Self { look_from, look_at, vertical_fov, half_height, right, up: right.cross(forward), forward })
    }

    /// The ray through the point (`x`, `y`) of an image of `width` x `height` pixels.
    ///
    /// (0, 0) is the top left corner of the image; the centre of the first pixel is (0.5, 0.5).
    pub fn ray(&self, x: f32, y: f32, width: usize, height: usize) -> Ray {
        let (width, height) = (width as f32, height as f32);
        let pixel = 2.0 * self.half_height / height;
        let right = (x - 0.5 * width) * pixel;
        let up = (0.5 * height - y) * pixel;
        Ray::new(self.look_from, (self.forward + right * self.right + up * self.up).normalize())
    }

    /// A camera that sees all of `bounds`: a three-quarter view, slightly from above, for an image of 4 : 3.
    pub fn framing(bounds: &Bounds) -> Self {
        const FOV: f32 = 35.0;
        const AZIMUTH: f32 = 35.0;
        const ELEVATION: f32 = 18.0;
        let bounds = if bounds.is_empty() { Bounds { min: -Vec3A::ONE, max: Vec3A::ONE } } else { *bounds };
        let (sin_azimuth, cos_azimuth) = AZIMUTH.to_radians().sin_cos();
        let (sin_elevation, cos_elevation) = ELEVATION.to_radians().sin_cos();
        let back = Vec3A::new(sin_azimuth * cos_elevation, sin_elevation, cos_azimuth * cos_elevation);
        let center = bounds.center();
        let direction = Self::aimed(center + back, center, FOV);

        // The nearest distance from which every corner is inside the frustum.
        let tan = (0.5 * FOV).to_radians().tan();
        let distance = bounds.corners().into_iter().fold(0.0_f32, |distance, corner| {
            let offset = corner - center;
            let (right, up) = (offset.dot(direction.right).abs(), offset.dot(direction.up).abs());
            distance.max(offset.dot(back) + (right / (tan * FRAMED_ASPECT)).max(up / tan))
        });
        // A single point has no extent to fit: any distance that f32 can tell from zero will do.
        let distance = (FRAMING_MARGIN * distance).max(1e-3 * center.abs().max_element()).max(1e-3);
        Self::aimed(center + distance * back, center, FOV)
    }

    /// [`Self::new`] for positions known to be good.
    pub(super) fn aimed(look_from: Vec3A, look_at: Vec3A, vertical_fov: f32) -> Self {
        Self::new(look_from, look_at, vertical_fov).expect("distinct finite points and an angle below 180 degrees")
    }

    /// Where the camera stands, in metres.
    pub fn look_from(&self) -> Vec3A {
        self.look_from
    }

    /// The angle that a pixel spans in the middle of an image of so many rows, in radians.
    pub fn pixel_angle(&self, height: usize) -> f32 {
        2.0 * self.half_height / height as f32
    }

    /// The point in the middle of the image, in metres.
    pub fn look_at(&self) -> Vec3A {
        self.look_at
    }

    /// The vertical field of view in degrees.
    pub fn vertical_fov(&self) -> f32 {
        self.vertical_fov
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(a: Vec3A, b: Vec3A) -> bool {
        (a - b).length() < 1e-5
    }

    #[test]
    fn corners_of_the_image_are_where_the_field_of_view_puts_them() {
        let camera = Camera::new(Vec3A::new(0.0, 0.0, 5.0), Vec3A::ZERO, 90.0).unwrap();
        let direction = |x, y| camera.ray(x, y, 200, 100).direction;
        assert!(near(direction(100.0, 50.0), -Vec3A::Z));
        assert!(near(direction(100.0, 0.0), Vec3A::new(0.0, 1.0, -1.0).normalize()));
        assert!(near(direction(200.0, 50.0), Vec3A::new(2.0, 0.0, -1.0).normalize()));
        assert!(near(direction(0.0, 100.0), Vec3A::new(-2.0, -1.0, -1.0).normalize()));
    }

    #[test]
    fn straight_up_and_down_have_a_full_frame() {
        for (y, top) in [(1.0, -Vec3A::Z), (-1.0, Vec3A::Z)] {
            let camera = Camera::new(Vec3A::ZERO, Vec3A::new(0.0, y, 0.0), 60.0).unwrap();
            assert!(near(camera.ray(50.0, 50.0, 100, 100).direction, Vec3A::new(0.0, y, 0.0)));
            let above = camera.ray(50.0, 10.0, 100, 100).direction;
            assert!(above.is_normalized() && above.dot(top).abs() > 0.1, "{above}");
        }
    }

    #[test]
    fn nonsense_is_refused() {
        assert!(Camera::new(Vec3A::ONE, Vec3A::ONE, 40.0).is_err());
        assert!(Camera::new(Vec3A::ONE, Vec3A::NAN, 40.0).is_err());
        assert!(Camera::new(Vec3A::ONE, Vec3A::ZERO, 180.0).is_err());
        assert!(Camera::new(Vec3A::ONE, Vec3A::ZERO, f32::NAN).is_err());
    }

    #[test]
    fn a_framed_box_is_inside_the_image() {
        for (min, max) in [([-1.0; 3], [1.0; 3]), ([0.0, 0.0, 0.0], [10.0, 0.0, 3.0]), ([5e3; 3], [5e3 + 2.0; 3])] {
            let bounds = Bounds { min: min.into(), max: max.into() };
            let camera = Camera::framing(&bounds);
            let tan = (0.5 * camera.vertical_fov()).to_radians().tan();
            for corner in bounds.corners() {
                let offset = corner - camera.look_from();
                let depth = offset.dot(camera.forward);
                assert!(depth > 0.0);
                assert!(offset.dot(camera.up).abs() <= depth * tan);
                assert!(offset.dot(camera.right).abs() <= depth * tan * FRAMED_ASPECT);
            }
        }
    }

    #[test]
    fn points_and_nothing_are_framed_too() {
        for bounds in [Bounds::EMPTY, Bounds { min: Vec3A::splat(7.0), max: Vec3A::splat(7.0) }] {
            assert!(Camera::framing(&bounds).ray(1.0, 2.0, 4, 4).direction.is_normalized());
        }
    }
}
