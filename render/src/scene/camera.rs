//! The camera: a pinhole, or parallel rays.

use glam::{Affine3A, Vec2, Vec3A};

use super::ray::{Bounds, Ray};
use crate::error::{Error, Result};

/// Margin around a framed scene: the image's width over that of the framed points.
const FRAMING_MARGIN: f32 = 1.08;

/// A pinhole camera, with up = +Y ([`Self::new`]) or with any roll and principal point
/// ([`Self::of_photograph`]), or an orthographic camera ([`Self::orthographic`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    look_from: Vec3A,
    look_at: Vec3A,
    vertical_fov: f32,
    /// Half the image's height: at distance 1, or in metres for parallel rays.
    half_height: f32,
    is_orthographic: bool,
    /// Position of the principal point right of and above the middle of the image, in half heights.
    principal_point: Vec2,
    right: Vec3A,
    up: Vec3A,
    forward: Vec3A,
}

impl Camera {
    /// Creates a camera at `look_from` (metres) that points to `look_at`, of `vertical_fov` degrees.
    ///
    /// Looking straight up, the top of the image is towards +Z; straight down, towards -Z.
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
        // Within 1e-6 of the vertical, forward x Y has no significant digits: the image's top is a convention
        // there.
        let right = forward.cross(Vec3A::Y);
        let right = if right.length_squared() > 1e-12 { right.normalize() } else { Vec3A::X };
        let half_height = (0.5 * vertical_fov.to_radians()).tan();
        let (principal_point, up) = (Vec2::ZERO, right.cross(forward));
        let is_orthographic = false;
        Ok(Self { look_from, look_at, vertical_fov, half_height, is_orthographic, principal_point, right, up, forward })
    }

    /// Creates a camera of parallel rays, whose image is `2 half_height` metres high. `to_world` is as in
    /// [`Self::of_photograph`]; points behind the plane of its origin are not visible.
    ///
    /// # Errors
    /// As [`Self::of_photograph`].
    pub fn orthographic(to_world: Affine3A, half_height: f32) -> Result<Self> {
        let camera = Self::of_photograph(to_world, half_height, Vec2::ZERO)?;
        Ok(Self { is_orthographic: true, vertical_fov: 0.0, ..camera })
    }

    /// Creates the camera of a photograph. `to_world` is a rigid motion from camera coordinates, in which the
    /// camera looks along -Z with up = +Y. `principal_point` is right of and above the middle of the image,
    /// in half heights; the image is `2 half_height` high at distance 1.
    ///
    /// # Errors
    /// When `to_world` is not a rigid motion, or a number is out of range or not finite.
    pub fn of_photograph(to_world: Affine3A, half_height: f32, principal_point: Vec2) -> Result<Self> {
        // Rotations stored with six digits are off by 1e-6; a matrix that is off by 1e-3 is not a rotation.
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
        let is_orthographic = false;
        Ok(Self { look_from, look_at, vertical_fov, half_height, is_orthographic, principal_point, right, up, forward })
    }

    /// Returns the camera moved by a rotation about the origin and a translation.
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

    /// Returns the transform from camera coordinates (looking along -Z, up is +Y) to world space.
    pub fn to_world(&self) -> Affine3A {
        let axes = glam::Mat3A::from_cols(self.right, self.up, -self.forward);
        Affine3A { matrix3: axes, translation: self.look_from }
    }

    /// Returns the angle in radians between neighbouring pixels in the middle of an image of `height` pixels;
    /// 0 for parallel rays.
    pub fn pixel_spread(&self, height: usize) -> f32 {
        if self.is_orthographic { 0.0 } else { 2.0 * self.half_height / height as f32 }
    }

    /// Returns whether its rays are parallel.
    pub fn is_orthographic(&self) -> bool {
        self.is_orthographic
    }

    /// Returns half the image's height: at distance 1, or in metres for parallel rays.
    pub fn half_height(&self) -> f32 {
        self.half_height
    }

    /// Returns the principal point's position right of and above the middle of the image, in half heights.
    pub fn principal_point(&self) -> Vec2 {
        self.principal_point
    }

    /// Projects a world-space point to the pixel coordinates of [`Self::ray`]; `None` behind the camera.
    pub fn project(&self, p: Vec3A, width: usize, height: usize) -> Option<Vec2> {
        let offset = p - self.look_from;
        let depth = offset.dot(self.forward);
        let distance = if self.is_orthographic { 1.0 } else { depth };
        let (half, scale) = (0.5 * height as f32, 1.0 / (distance * self.half_height));
        let right = offset.dot(self.right) * scale + self.principal_point.x;
        let up = offset.dot(self.up) * scale + self.principal_point.y;
        (depth > 0.0).then(|| Vec2::new(0.5 * width as f32 + half * right, half - half * up))
    }

    /// Returns the ray through the point (`x`, `y`) of an image of `width` x `height` pixels.
    ///
    /// (0, 0) is the top left corner of the image; the centre of the first pixel is (0.5, 0.5).
    pub fn ray(&self, x: f32, y: f32, width: usize, height: usize) -> Ray {
        let (width, height) = (width as f32, height as f32);
        let pixel = 2.0 * self.half_height / height;
        let principal = self.half_height * self.principal_point;
        let right = (x - 0.5 * width) * pixel - principal.x;
        let up = (0.5 * height - y) * pixel - principal.y;
        if self.is_orthographic {
            return Ray::new(self.look_from + right * self.right + up * self.up, self.forward);
        }
        Ray::new(self.look_from, (self.forward + right * self.right + up * self.up).normalize())
    }

    /// Creates a camera that sees all points: a three-quarter view, slightly from above, for an image of
    /// aspect ratio `aspect`. It is as near as possible: points lie close to two opposite sides of the image.
    /// Without points it frames the cube from -1 to 1.
    pub fn framing<I: Iterator<Item = Vec3A>>(points: impl Fn() -> I, aspect: f32) -> Self {
        const FOV: f32 = 35.0;
        const AZIMUTH: f32 = 35.0;
        const ELEVATION: f32 = 12.0;
        let (sin_azimuth, cos_azimuth) = AZIMUTH.to_radians().sin_cos();
        let (sin_elevation, cos_elevation) = ELEVATION.to_radians().sin_cos();
        let back = Vec3A::new(sin_azimuth * cos_elevation, sin_elevation, cos_azimuth * cos_elevation);
        let turned = Self::aimed(back, Vec3A::ZERO, FOV);
        let axes = [turned.right, turned.up, back].map(Vec3A::as_dvec3);
        let tan_y = f64::from((0.5 * FOV).to_radians().tan() / FRAMING_MARGIN);
        let tangents = [tan_y * f64::from(aspect), tan_y];

        // A point (x, z) is seen from (cx, cz) if |x - cx| <= tan (cz - z): x + tan z has an upper bound, x - tan z a lower one.
        let (mut upper, mut lower) = ([f64::NEG_INFINITY; 2], [f64::INFINITY; 2]);
        let mut depths = [f64::INFINITY, f64::NEG_INFINITY];
        let mut take = |point: Vec3A| {
            let [x, y, z] = axes.map(|axis| axis.dot(point.as_dvec3()));
            depths = [depths[0].min(z), depths[1].max(z)];
            for (k, side) in [x, y].into_iter().enumerate() {
                upper[k] = upper[k].max(side + tangents[k] * z);
                lower[k] = lower[k].min(side - tangents[k] * z);
            }
        };
        if points().next().is_some() {
            points().for_each(take);
        } else {
            Bounds { min: -Vec3A::ONE, max: Vec3A::ONE }.corners().into_iter().for_each(&mut take);
        }
        let [x, y] = [0, 1].map(|k| 0.5 * (upper[k] + lower[k]));
        let depth = [0, 1].map(|k| (upper[k] - lower[k]) / (2.0 * tangents[k])).into_iter().fold(depths[1], f64::max);
        let middle = 0.5 * (depths[0] + depths[1]);
        // A single point has no extent to fit: any distance that differs from zero in f32 works.
        let distance = (depth - middle).max(1e-4 * x.abs().max(y.abs()).max(middle.abs()));
        let distance = if distance > 0.0 { distance } else { 1e-3 };
        let at = |z: f64| (x * axes[0] + y * axes[1] + z * axes[2]).as_vec3a();
        Self::aimed(at(middle + distance), at(middle), FOV)
    }

    /// [`Self::new`] for arguments known to be valid.
    pub(super) fn aimed(look_from: Vec3A, look_at: Vec3A, vertical_fov: f32) -> Self {
        Self::new(look_from, look_at, vertical_fov).expect("distinct finite points and an angle below 180 degrees")
    }

    /// Returns the camera's position in metres.
    pub fn look_from(&self) -> Vec3A {
        self.look_from
    }

    /// Returns a point on the principal axis, in metres; it is in the middle of the image, unless the
    /// principal point is elsewhere.
    pub fn look_at(&self) -> Vec3A {
        self.look_at
    }

    /// Returns the vertical field of view in degrees, of an image whose principal point is in its middle; 0
    /// for parallel rays.
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
    fn vertical_cameras_have_a_valid_frame() {
        for (y, top) in [(1.0, Vec3A::Z), (-1.0, -Vec3A::Z)] {
            let camera = Camera::new(Vec3A::ZERO, Vec3A::new(0.0, y, 0.0), 60.0).unwrap();
            assert!(near(camera.ray(50.0, 50.0, 100, 100).direction, Vec3A::new(0.0, y, 0.0)));
            let above = camera.ray(50.0, 10.0, 100, 100).direction;
            assert!(above.is_normalized() && above.dot(top) > 0.1, "{above}");
        }
    }

    #[test]
    fn invalid_camera_arguments_are_rejected() {
        assert!(Camera::new(Vec3A::ONE, Vec3A::ONE, 40.0).is_err());
        assert!(Camera::new(Vec3A::ONE, Vec3A::NAN, 40.0).is_err());
        assert!(Camera::new(Vec3A::ONE, Vec3A::ZERO, 180.0).is_err());
        assert!(Camera::new(Vec3A::ONE, Vec3A::ZERO, f32::NAN).is_err());
    }

    #[test]
    fn projection_inverts_camera_rays() {
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
    fn invalid_photograph_cameras_are_rejected() {
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
    fn a_framed_box_fills_the_image() {
        for aspect in [0.5, 4.0 / 3.0, 3.0] {
            for (min, max) in [([-1.0; 3], [1.0; 3]), ([0.0, 0.0, 0.0], [10.0, 0.0, 3.0]), ([5e3; 3], [5e3 + 2.0; 3])] {
                let bounds = Bounds { min: min.into(), max: max.into() };
                let camera = Camera::framing(|| bounds.corners().into_iter(), aspect);
                let (width, height) = ((1200.0 * aspect) as usize, 1200);
                let seen = bounds.corners().map(|corner| camera.project(corner, width, height).unwrap());
                // From 0 to 1 over the image.
                let sides = [0, 1].map(|k| {
                    let of = |p: Vec2| p[k] / [width, height][k] as f32;
                    seen.iter().fold([1.0_f32, 0.0], |[low, high], &p| [low.min(of(p)), high.max(of(p))])
                });
                // Half of the margin on either side, and the f32 error of positions at 5 km.
                let (free, slack) = (0.5 * (1.0 - 1.0 / FRAMING_MARGIN), 2e-3);
                for [low, high] in sides {
                    assert!(low > free - slack && high < 1.0 - free + slack, "{sides:?}");
                }
                let is_filled = |[low, high]: [f32; 2]| low < free + slack && high > 1.0 - free - slack;
                assert!(sides.into_iter().any(is_filled), "{sides:?}");
            }
        }
    }

    #[test]
    fn single_points_and_empty_scenes_are_framed() {
        for points in [vec![], vec![Vec3A::splat(7.0)], vec![Vec3A::ZERO; 2]] {
            let camera = Camera::framing(|| points.iter().copied(), 1.0);
            assert!(camera.ray(1.0, 2.0, 4, 4).direction.is_normalized());
        }
    }
}
