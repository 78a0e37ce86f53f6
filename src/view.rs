//! `headtail view`: a rectified view of a map with its camera, a photograph to composite into.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use clap::Args;
use glam::{Affine3A, Quat, Vec2, Vec3, Vec3A};
use headtail_render::{
    composite::rectified_view,
    file,
    image::{Attribute, encode_png_rgb8, latin_1, srgb_code, write_exr},
    memory,
    scene::{Camera, FspyProject, UpAxis},
};

use crate::arguments::{MapArguments, open_environment};
use crate::exposure;
use crate::given::given;
use crate::output::OutputFile;
use crate::terminal::say;

/// Take a photograph of a map.
/// Writes FILE.exr in the map's units, FILE.png to look at, and FILE.fspy with the picture and its camera.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail view --env room.hdr --out out/room.exr
  headtail view --env room.hdr --azimuth 120 --pitch -20 --fov 45 --width 1280 --height 720 --out out/window.exr

The camera stands --eye-height above the ground, and the origin of the world is on the ground in the lower middle of the picture, where \
composite puts objects. The .fspy file has Z up, as Blender's importer expects it. The PNG is sRGB without a tone curve, so that it is \
light that composite can read back; brighter values are clipped.")]
pub struct Arguments {
    /// Built-in environment or .hdr or .exr map.
    /// Built-in: overcast, window, studio, sunset.
    #[arg(long, value_name = "NAME|FILE", value_parser = given::<String>())]
    env: String,
    #[command(flatten)]
    map: MapArguments,
    /// Viewing direction around the vertical axis, in degrees.
    /// 0 is the middle of Mitsuba's map (-Z), 90 is +X.
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, allow_hyphen_values = true)]
    azimuth: f32,
    /// Angle by which the camera looks up, in degrees (negative: down).
    #[arg(long, value_name = "DEGREES", default_value_t = -12.0, allow_hyphen_values = true)]
    pitch: f32,
    /// Vertical field of view in degrees.
    #[arg(long, value_name = "DEGREES", default_value_t = 45.0)]
    fov: f32,
    /// Height of the camera above the ground, in metres.
    #[arg(long, value_name = "METRES", default_value_t = 1.6)]
    eye_height: f32,
    /// Image width in pixels.
    #[arg(long, default_value_t = 960, value_parser = clap::value_parser!(u32).range(1..=16384))]
    width: u32,
    /// Image height in pixels.
    #[arg(long, default_value_t = 640, value_parser = clap::value_parser!(u32).range(1..=16384))]
    height: u32,
    /// Stops added to the automatic exposure of the PNG.
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true)]
    exposure: f32,
    /// Linear OpenEXR file; PNG and .fspy are written beside it.
    #[arg(long, value_name = "FILE.exr")]
    out: PathBuf,
}

/// Vertical position of the world's origin, as a fraction of the picture's height.
const ORIGIN_ROW: f32 = 0.66;
/// Distance of the origin over the camera's height, if the camera does not see the ground.
const FAR: f32 = 4.0;

/// Writes the three files.
pub fn run(arguments: &Arguments) -> Result<()> {
    let is_exr = arguments.out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"));
    ensure!(is_exr, "--out {}: the file's name must end in .exr", arguments.out.display());
    let exr_file = OutputFile::take(&arguments.out)?;
    let beside = |extension: &str| OutputFile::take(&arguments.out.with_extension(extension));
    let (png_file, fspy_file) = (beside("png")?, beside("fspy")?);
    let environment = open_environment(&arguments.map.of(&arguments.env))?;
    let camera = camera(arguments)?;
    let (width, height) = (arguments.width as usize, arguments.height as usize);
    memory::require_pictures(width, height, 0)?;
    let image = rectified_view(&environment, &camera, width, height);
    let stops = exposure::of_photograph(&image) + arguments.exposure;
    let attributes =
        [Attribute::new("environment", latin_1(environment.name())), Attribute::new("png.exposure", stops)];
    exr_file.write(|path| write_exr(path, &image, &attributes))?;
    let codes: Vec<[u8; 3]> =
        image.pixels.iter().map(|pixel| pixel.map(|value| srgb_code(value * stops.exp2()))).collect();
    let png = encode_png_rgb8(width, height, &codes)?;
    png_file.write(|path| file::replace(path, &png))?;
    let project = FspyProject { camera, width: arguments.width, height: arguments.height, image: png };
    fspy_file.write(|path| file::replace(path, &project.encode(UpAxis::Z)))?;
    let at = camera.look_from();
    say!(
        "{}, .png (exposed by {stops:.2} stops) and .fspy written; camera at {:.2}, {:.2}, {:.2}",
        arguments.out.display(),
        at.x,
        at.y,
        at.z
    );
    Ok(())
}

/// Returns the camera that sees the origin in the lower middle of its picture.
fn camera(arguments: &Arguments) -> Result<Camera> {
    ensure!(arguments.fov > 0.0 && arguments.fov < 180.0, "--fov: {} is not between 0 and 180 degrees", arguments.fov);
    ensure!(arguments.pitch.abs() <= 90.0, "--pitch: {} is not between -90 and 90 degrees", arguments.pitch);
    ensure!(arguments.azimuth.is_finite(), "--azimuth: not an angle");
    let eye = arguments.eye_height;
    ensure!(eye > 0.0 && eye < 1e6, "--eye-height: {eye} is not between 0 and 1e6 m");
    // Positive azimuths are to the right of -Z.
    let turn =
        Quat::from_rotation_y(-arguments.azimuth.to_radians()) * Quat::from_rotation_x(arguments.pitch.to_radians());
    let half_height = (0.5 * arguments.fov.to_radians()).tan();
    let origin = Camera::of_photograph(Affine3A::from_quat(turn), half_height, Vec2::ZERO)?;
    let down = origin.ray(0.5, ORIGIN_ROW, 1, 1).direction;
    let ahead = Vec3A::from(turn * Vec3::NEG_Z);
    let offset = if down.y < -1.0 / FAR {
        down * (eye / -down.y)
    } else {
        eye * (FAR * Vec3A::new(ahead.x, 0.0, ahead.z).normalize_or_zero() - Vec3A::Y)
    };
    Ok(origin.moved(&Affine3A::from_translation((-offset).into())))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arguments(azimuth: f32, pitch: f32) -> Arguments {
        Arguments {
            env: String::new(),
            map: MapArguments::default(),
            azimuth,
            pitch,
            fov: 45.0,
            eye_height: 1.6,
            width: 960,
            height: 640,
            exposure: 0.0,
            out: PathBuf::new(),
        }
    }

    #[test]
    fn the_origin_is_on_the_ground_in_the_lower_middle() {
        for azimuth in [0.0, 90.0, -130.0] {
            let camera = camera(&arguments(azimuth, -12.0)).unwrap();
            assert!((camera.look_from().y - 1.6).abs() < 1e-5);
            let seen = camera.project(Vec3A::ZERO, 960, 640).unwrap();
            assert!((seen.x - 480.0).abs() < 0.1 && seen.y > 320.0 && seen.y < 640.0, "{seen}");
        }
        let right = camera(&arguments(90.0, 0.0)).unwrap();
        assert!(right.ray(480.0, 320.0, 960, 640).direction.x > 0.999);
    }

    #[test]
    fn origin_is_ahead_of_a_camera_that_sees_no_ground() {
        let up = camera(&arguments(0.0, 40.0)).unwrap();
        assert!((up.look_from() - Vec3A::new(0.0, 1.6, 6.4)).length() < 1e-4);
    }
}
