//! The pinhole camera.

use glam::{Affine3A, Vec2, Vec3A};

use super::ray::{Bounds, Ray};
use crate::error::{Error, Result};

/// The width over height for which [`Camera::framing`] fits a scene.
const FRAMED_ASPECT: f32 = 4.0 / 3.0;

/// Free space around a framed scene, as a factor on its distance.
const FRAMING_MARGIN: f32 = 1.08;

/// A pinhole camera: with up = +Y ([`Self::new`]), or with any roll and principal point ([`Self::of_photograph`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    look_from: Vec3A,
    look_at: Vec3A,
    vertical_fov: f32,
    /// Half the image's height at distance 1.
    half_height: f32,
    /// Where the principal point is, right of and above the middle of the image, in half heights.
    principal_point: Vec2,
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
        let (principal_point, up) = (Vec2::ZERO, right.cross(forward));
        Ok(Self { look_from, look_at, vertical_fov, half_height, principal_point, right, up, forward })
    }

    /// The camera of a photograph. `to_world` is a rigid motion from the camera's coordinates, in which it looks along -Z with up = +Y; the
    /// principal point lies right of and above the middle of the image by so many half heights, and the image is `2 half_height` high at
    /// distance 1.
    ///
    /// # Errors
    /// When `to_world` is no rigid motion, or a number has no meaning.
    pub fn of_photograph(to_world: Affine3A, half_height: f32, principal_point: Vec2) -> Result<Self> {
        // Rotations that were stored with six digits are off by 1e-6; what is off by a thousandth is no rotation.
        const TOLERANCE: f32 = 1e-3;
        let axes = to_world.matrix3;
        let product = axes.transpose() * axes - glam::Mat3A::IDENTITY;
        let is_rotation = product.to_cols_array().iter().all(|x| x.abs() < TOLERANCE) && axes.determinant() > 0.0;
        if !(is_rotation && to_world.is_finite()) {
            return Err(Error::argument("camera transform", "is not a rotation with a finite translation"));
        }
        if !(half_height > 0.0 && half_height.is_finite()) {
            return Err(Error::argument("field of view", "is not between 0 and 180 degrees"));
        }
        if !principal_point.is_finite() {
            return Err(Error::argument("principal point", "is not finite"));
        }
        let right = axes.x_axis.normalize();
        let up = (axes.y_axis - axes.y_axis.dot(right) * right).normalize();
        let (look_from, forward) = (to_world.translation, up.cross(right));
        let look_at = look_from + forward * look_from.abs().max_element().max(1.0);
        let vertical_fov = 2.0 * half_height.atan().to_degrees();
        Ok(Self { look_from, look_at, vertical_fov, half_height, principal_point, right, up, forward })
    }

    /// The camera moved by a rotation about the origin and a translation.
    #[must_use]
    pub fn moved(&self, motion: &Affine3A) -> Self {
        let turned = |v| motion.transform_vector3a(v);
        Self {
            look_from: motion.transform_point3a(self.look_from),
            look_at: motion.transform_point3a(self.look_at),
            right: turned(self.right),
            up: turned(self.up),
            forward: turned(self.forward),
            ..*self
        }
    }

    /// From the camera's coordinates (it looks along -Z, up is +Y) to those of the world.
    pub fn to_world(&self) -> Affine3A {
        let axes = glam::Mat3A::from_cols(self.right, self.up, -self.forward);
        Affine3A { matrix3: axes, translation: self.look_from }
    }

    /// The angle in radians between neighbouring pixels in the middle of an image of `height` pixels.
    pub fn pixel_spread(&self, height: usize) -> f32 {
        2.0 * self.half_height / height as f32
    }

    /// Half the image's height at distance 1.
    pub fn half_height(&self) -> f32 {
        self.half_height
    }

    /// Where the principal point is, right of and above the middle of the image, in half heights.
    pub fn principal_point(&self) -> Vec2 {
        self.principal_point
    }

    /// Where a point of the world is in an image, as [`Self::ray`] has it; `None` behind the camera.
    pub fn project(&self, p: Vec3A, width: usize, height: usize) -> Option<Vec2> {
        let offset = p - self.look_from;
        let depth = offset.dot(self.forward);
        let (half, scale) = (0.5 * height as f32, 1.0 / (depth * self.half_height));
        let right = offset.dot(self.right) * scale + self.principal_point.x;
        let up = offset.dot(self.up) * scale + self.principal_point.y;
        (depth > 0.0).then(|| Vec2::new(0.5 * width as f32 + half * right, half - half * up))
    }

    /// The ray through the point (`x`, `y`) of an image of `width` x `height` pixels.
    ///
    /// (0, 0) is the top left corner of the image; the centre of the first pixel is (0.5, 0.5).
    pub fn ray(&self, x: f32, y: f32, width: usize, height: usize) -> Ray {
        let (width, height) = (width as f32, height as f32);
        let pixel = 2.0 * self.half_height / height;
        let principal = self.half_height * self.principal_point;
        let right = (x - 0.5 * width) * pixel - principal.x;
        let up = (0.5 * height - y) * pixel - principal.y;
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

    /// A point on the principal axis, in metres: that in the middle of the image, unless the principal point is elsewhere.
    pub fn look_at(&self) -> Vec3A {
        self.look_at
    }

    /// The vertical field of view in degrees, of an image whose principal point is in its middle.
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
    fn points_are_projected_to_where_their_ray_goes_through() {
        let turn = glam::Quat::from_euler(glam::EulerRot::YXZ, 0.7, -0.3, 0.2);
        let to_world = Affine3A::from_rotation_translation(turn, glam::Vec3::new(2.0, 1.0, -3.0));
        let camera = Camera::of_photograph(to_world, 0.6, Vec2::new(0.3, -0.2)).unwrap();
        for (x, y) in [(0.0, 0.0), (320.0, 200.0), (17.0, 399.0), (639.0, 3.5)] {
            let ray = camera.ray(x, y, 640, 400);
            let found = camera.project(ray.at(7.0), 640, 400).unwrap();
            // A few roundings of numbers up to 10 m, over 7 m, times 400 pixels.
            assert!((found - Vec2::new(x, y)).length() < 2e-3, "{found} {x} {y}");
            assert!(camera.project(ray.at(-7.0), 640, 400).is_none());
        }
        // The principal axis goes through the principal point: 0.3 x 200 right of the middle, 0.2 x 200 below it.
        let axis = camera.ray(380.0, 240.0, 640, 400).direction;
        assert!(near(axis, to_world.transform_vector3a(-Vec3A::Z)));
        assert!(camera.moved(&to_world.inverse()).look_from().length() < 1e-5);
    }

    #[test]
    fn what_is_no_rigid_motion_is_refused() {
        let good = Affine3A::from_rotation_y(0.4);
        assert!(Camera::of_photograph(good, 0.5, Vec2::ZERO).is_ok());
        for bad in [Affine3A::from_scale(glam::Vec3::splat(1.1)), Affine3A::from_scale(glam::Vec3::new(1.0, 1.0, -1.0))]
        {
            assert!(Camera::of_photograph(bad * good, 0.5, Vec2::ZERO).is_err());
        }
        let far = Affine3A::from_translation(glam::Vec3::new(f32::INFINITY, 0.0, 0.0));
        assert!(Camera::of_photograph(far, 0.5, Vec2::ZERO).is_err());
        for (half_height, point) in [(0.0, 0.0), (f32::NAN, 0.0), (f32::INFINITY, 0.0), (0.5, f32::NAN)] {
            assert!(Camera::of_photograph(good, half_height, Vec2::splat(point)).is_err());
        }
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
