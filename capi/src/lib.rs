//! The C library: environments and samplers by handles, batches of directions. Its header is
//! `include/headtail.h`.
//!
//! World space is right-handed with Y up; directions are unit vectors that point away from the surface, three
//! floats each. All pdfs are over solid angle. All functions may be called from any thread at any time, also
//! with the same handles. No function unwinds.

mod handles;
mod lists;
mod status;

use std::{ffi::c_char, path::Path, sync::Arc};

use handles::{Object, OpenPoints, OpenSampler};
use headtail_sampling::{
    batch::{self, FittedMaterial, PreparedPoints},
    environment::Environment,
    export::ExportedSampler,
    image::Image,
    spec::SamplerSpec,
};
use lists::{check_count, draw_list, list, list_mut, numbers, point_list, target, text};
use status::{Failure, call};

pub use status::HeadtailStatus;

/// A handle of an open environment, sampler, material or list of prepared points; 0 is never a valid handle.
pub type HeadtailHandle = u64;

/// Shading points. Each list has one entry for all points, or one per point. Surfaces are diffuse, unless `alpha`,
/// `roughness` or `material` is given.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct HeadtailPoints {
    /// Unit shading normals in world space, three floats each.
    pub n: *const f32,
    /// Number of entries of `n`.
    pub n_count: usize,
    /// Unit directions to the viewer; NULL uses the normals, which suffices for diffuse surfaces.
    pub wo: *const f32,
    /// Number of entries of `wo`.
    pub wo_count: usize,
    /// Trowbridge-Reitz widths from 0.001 to 1 of glossy surfaces, or NULL.
    pub alpha: *const f32,
    /// Number of entries of `alpha`.
    pub alpha_count: usize,
    /// Their reflectances at normal incidence from 0 to 1; NULL uses 1.
    pub f0: *const f32,
    /// Number of entries of `f0`.
    pub f0_count: usize,
    /// Roughness, from 0 to 1, of the metallic-roughness surfaces of glTF, or NULL.
    pub roughness: *const f32,
    /// Number of entries of `roughness`.
    pub roughness_count: usize,
    /// Metalness of these, from 0 to 1; NULL uses 0.
    pub metallic: *const f32,
    /// Number of entries of `metallic`.
    pub metallic_count: usize,
    /// Base colours of these, linear Rec.709 from 0 to 1, three floats each; NULL uses white.
    pub base_color: *const f32,
    /// Number of entries of `base_color`.
    pub base_color_count: usize,
    /// Positions in metres, three floats each, for samplers with visibility or portals; NULL for others.
    pub p: *const f32,
    /// Number of entries of `p`.
    pub p_count: usize,
    /// The measured or neural material of all surfaces, or 0.
    pub material: HeadtailHandle,
    /// Texture coordinates of a neural material, two floats each; NULL for others, as the following. The texture
    /// repeats with period 1.
    pub uv: *const f32,
    /// Number of entries of `uv`.
    pub uv_count: usize,
    /// Directions in world space in which u grows, of any length, and 1, or -1 where the texture is mirrored: four
    /// floats each, as tangents of glTF.
    pub tangent: *const f32,
    /// Number of entries of `tangent`.
    pub tangent_count: usize,
    /// Standard deviations of pixels' footprints on the surface, in units of the texture coordinates; NULL uses 0,
    /// which is the finest detail.
    pub footprint: *const f32,
    /// Number of entries of `footprint`.
    pub footprint_count: usize,
}

impl Default for HeadtailPoints {
    /// No lists; `n` is needed.
    fn default() -> Self {
        // SAFETY: pointers may be NULL, and counts 0.
        unsafe { std::mem::zeroed() }
    }
}

/// Returns the error message of this thread's last call that did not return HEADTAIL_STATUS_OK. It stays
/// valid until the next such call.
#[unsafe(no_mangle)]
pub extern "C" fn headtail_last_error() -> *const c_char {
    status::last()
}

/// Opens an environment by its UTF-8 name: a built-in one (overcast, window, studio, sunset) or a Radiance
/// .hdr file. For other formats, pass the texels to headtail_environment_from_texels.
///
/// # Safety
/// `name` is NULL or ends with a zero byte; `out` is NULL or may be written to.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn headtail_environment_open(name: *const c_char, out: *mut HeadtailHandle) -> HeadtailStatus {
    call(|| {
        // SAFETY: guaranteed by the caller.
        let (name, out) = unsafe { (text("name", name)?, target("out", out)?) };
        *out = handles::open(Object::Environment(Arc::new(Environment::open(name)?)));
        Ok(())
    })
}

/// Creates an environment from linear Rec.709 radiance, three floats per texel, rows from the top.
///
/// # Safety
/// `texels` is NULL or holds 3 * width * height floats; `out` is NULL or may be written to.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn headtail_environment_from_texels(
    width: usize,
    height: usize,
    texels: *const f32,
    out: *mut HeadtailHandle,
) -> HeadtailStatus {
    call(|| {
        let count = width.checked_mul(height).filter(|count| *count <= 1 << 27);
        let count = count.ok_or_else(|| Failure::argument(format!("size: {width} x {height} is above 2^27 texels")))?;
        // SAFETY: guaranteed by the caller.
        let (pixels, out) = unsafe { (list("texels", texels.cast::<[f32; 3]>(), count)?, target("out", out)?) };
        let image = Image { width, height, pixels: pixels.to_vec() };
        *out = handles::open(Object::Environment(Arc::new(Environment::from_image("texels", image)?)));
        Ok(())
    })
}

/// Opens a measured or neural material by its UTF-8 name: "nbrdf:FILE#NAME" or "neural:FILE".
///
/// # Safety
/// `name` is NULL or ends with a zero byte; `out` is NULL or may be written to.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn headtail_material_open(name: *const c_char, out: *mut HeadtailHandle) -> HeadtailStatus {
    call(|| {
        // SAFETY: guaranteed by the caller.
        let (name, out) = unsafe { (text("name", name)?, target("out", out)?) };
        *out = handles::open(Object::Material(Arc::new(FittedMaterial::open(name)?)));
        Ok(())
    })
}

/// Creates the sampler of a SPEC for an environment, as on the command line: "auto" (here the same as
/// "patches", because there is no scene), "mis", "direct:FILE", "patches+vis:FILE", ... Visibility and portals in files
/// are in the coordinates of the scene that they were made for, and need the positions of points.
///
/// # Safety
/// `spec` is NULL or ends with a zero byte; `out` is NULL or may be written to.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn headtail_sampler_from_spec(
    spec: *const c_char,
    environment: HeadtailHandle,
    out: *mut HeadtailHandle,
) -> HeadtailStatus {
    call(|| {
        // SAFETY: guaranteed by the caller.
        let (spec, out) = unsafe { (text("spec", spec)?, target("out", out)?) };
        let environment = handles::environment(environment)?;
        let parsed = spec.parse::<SamplerSpec>()?.resolved(false);
        let sampler = parsed.build_sampler(&environment)?;
        let description = serde_json::json!({ "sampler": parsed.to_string() }).to_string();
        let needs_positions = parsed.needs_positions();
        let opened = OpenSampler { sampler, environment, needs_positions, description };
        *out = handles::open(Object::Sampler(Arc::new(opened)));
        Ok(())
    })
}

/// Opens a sampler's file for the environment that it was built for.
///
/// # Safety
/// `path` is NULL or ends with a zero byte; `out` is NULL or may be written to.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn headtail_sampler_open(
    path: *const c_char,
    environment: HeadtailHandle,
    out: *mut HeadtailHandle,
) -> HeadtailStatus {
    call(|| {
        // SAFETY: guaranteed by the caller.
        let (path, out) = unsafe { (Path::new(text("path", path)?), target("out", out)?) };
        let environment = handles::environment(environment)?;
        let exported = ExportedSampler::read(path)?;
        let description = serde_json::to_value(exported.description()).unwrap_or_default().to_string();
        let sampler = exported.open(&environment).map_err(|error| error.in_file(path))?.into_inner();
        let opened = OpenSampler { sampler, environment, needs_positions: false, description };
        *out = handles::open(Object::Sampler(Arc::new(opened)));
        Ok(())
    })
}

/// Writes the description of a sampler, as zero-terminated JSON, into `buffer`, truncated to `capacity`.
/// `length`, which may be NULL, is set to the required bytes, including the terminating zero.
///
/// # Safety
/// `buffer` is NULL or has room for `capacity` bytes; `length` is NULL or may be written to.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn headtail_sampler_describe(
    sampler: HeadtailHandle,
    buffer: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> HeadtailStatus {
    call(|| {
        let sampler = handles::sampler(sampler)?;
        let bytes = sampler.description.as_bytes();
        if !length.is_null() {
            // SAFETY: guaranteed by the caller.
            unsafe { length.write(bytes.len() + 1) };
        }
        if !buffer.is_null() && capacity > 0 {
            let count = bytes.len().min(capacity - 1);
            // SAFETY: `count` + 1 bytes are within the capacity, which the caller guarantees.
            unsafe {
                std::ptr::copy_nonoverlapping(bytes.as_ptr().cast(), buffer, count);
                buffer.add(count).write(0);
            }
        }
        Ok(())
    })
}

/// Samples a direction for each of `count` points. `u` holds two uniform numbers in [0, 1) per point; if it
/// is NULL, random numbers are generated from `seed`. `wi` receives three floats per point, `pdf` one,
/// `radiance`, which may be NULL, three. A pdf of 0 marks no sample; the other results are then 0.
///
/// # Safety
/// Lists are NULL or as long as their counts. Results may be written to, and do not overlap each other or
/// other lists.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn headtail_sampler_sample(
    sampler: HeadtailHandle,
    points: *const HeadtailPoints,
    count: usize,
    u: *const f32,
    seed: u64,
    wi: *mut f32,
    pdf: *mut f32,
    radiance: *mut f32,
) -> HeadtailStatus {
    call(|| {
        let sampler = handles::sampler(sampler)?;
        // SAFETY: guaranteed by the caller.
        unsafe {
            let mut material = None;
            let at = point_list(points, sampler.needs_positions, &mut material)?;
            let out = draw_list(&sampler.environment, count, wi, pdf, radiance)?;
            Ok(batch::sample(&*sampler.sampler, &at, numbers(u, seed, count)?, out)?)
        }
    })
}

/// Evaluates the solid-angle pdfs with which [`headtail_sampler_sample`] samples the `count` unit directions
/// `wi` at the points.
///
/// # Safety
/// As for [`headtail_sampler_sample`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn headtail_sampler_pdf(
    sampler: HeadtailHandle,
    points: *const HeadtailPoints,
    count: usize,
    wi: *const f32,
    pdf: *mut f32,
) -> HeadtailStatus {
    call(|| {
        let sampler = handles::sampler(sampler)?;
        // SAFETY: guaranteed by the caller.
        unsafe {
            let (wi, out) = (list("wi", wi.cast(), count)?, list_mut("pdf", pdf, count)?);
            let mut material = None;
            let at = point_list(points, sampler.needs_positions, &mut material)?;
            Ok(batch::pdf(&*sampler.sampler, &at, wi, out)?)
        }
    })
}

/// Evaluates BRDF times max(0, cosine) of the `count` unit directions `wi` at the points, in 1/sr: `value` receives
/// three floats per point, linear Rec.709. Surfaces that are not diffuse need `wo`.
///
/// # Safety
/// As for [`headtail_sampler_sample`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn headtail_brdf_cosine(
    points: *const HeadtailPoints,
    count: usize,
    wi: *const f32,
    value: *mut f32,
) -> HeadtailStatus {
    call(|| {
        // SAFETY: guaranteed by the caller.
        unsafe {
            let (wi, out) = (list("wi", wi.cast(), count)?, list_mut("value", value.cast(), count)?);
            let mut material = None;
            Ok(batch::brdf_cosine(&point_list(points, false, &mut material)?, wi, out)?)
        }
    })
}

/// Prepares `count` points for a sampler, whose samples and pdfs then cost less: copies the points, and computes what
/// the sampler needs of each. Close the handle when the points are done.
///
/// # Safety
/// As for [`headtail_sampler_sample`]; `out` is NULL or may be written to.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn headtail_points_prepare(
    sampler: HeadtailHandle,
    points: *const HeadtailPoints,
    count: usize,
    out: *mut HeadtailHandle,
) -> HeadtailStatus {
    call(|| {
        let sampler = handles::sampler(sampler)?;
        let mut material = None;
        // SAFETY: guaranteed by the caller.
        let (at, out) = unsafe { (point_list(points, sampler.needs_positions, &mut material)?, target("out", out)?) };
        check_count("points", count)?;
        let points = PreparedPoints::new(sampler.sampler.clone(), &at, count)?;
        *out =
            handles::open(Object::Prepared(Arc::new(OpenPoints { points, environment: sampler.environment.clone() })));
        Ok(())
    })
}

/// [`headtail_sampler_sample`] for prepared points; `count` is their number.
///
/// # Safety
/// As for [`headtail_sampler_sample`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn headtail_points_sample(
    points: HeadtailHandle,
    count: usize,
    u: *const f32,
    seed: u64,
    wi: *mut f32,
    pdf: *mut f32,
    radiance: *mut f32,
) -> HeadtailStatus {
    call(|| {
        let prepared = handles::prepared(points)?;
        // SAFETY: guaranteed by the caller.
        unsafe {
            let out = draw_list(&prepared.environment, count, wi, pdf, radiance)?;
            Ok(prepared.points.sample(numbers(u, seed, count)?, out)?)
        }
    })
}

/// [`headtail_sampler_pdf`] for prepared points; `count` is their number.
///
/// # Safety
/// As for [`headtail_sampler_sample`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn headtail_points_pdf(
    points: HeadtailHandle,
    count: usize,
    wi: *const f32,
    pdf: *mut f32,
) -> HeadtailStatus {
    call(|| {
        let prepared = handles::prepared(points)?;
        // SAFETY: guaranteed by the caller.
        unsafe {
            let (wi, out) = (list("wi", wi.cast(), count)?, list_mut("pdf", pdf, count)?);
            Ok(prepared.points.pdf(wi, out)?)
        }
    })
}

/// Closes an environment, a sampler, a material, or prepared points. Samplers and prepared points keep what they need.
#[unsafe(no_mangle)]
pub extern "C" fn headtail_close(handle: HeadtailHandle) -> HeadtailStatus {
    call(|| handles::close(handle))
}
