//! The C library: environments and samplers by handles, batches of directions. Its header is
//! `include/headtail.h`.
//!
//! World space is right-handed with Y up; directions are unit vectors that point away from the surface, three
//! floats each. All pdfs are over solid angle. All functions may be called from any thread at any time, also
//! with the same handles. No function unwinds.

mod handles;
mod status;

use std::{
    ffi::{CStr, c_char},
    path::Path,
    slice,
    sync::Arc,
};

use handles::{Object, OpenSampler};
use headtail_sampling::{
    batch::{self, DrawList, Numbers, PointList, SurfaceList},
    environment::Environment,
    export::ExportedSampler,
    image::Image,
    sampler::Sampler,
    spec::SamplerSpec,
};
use status::{Failure, call};

pub use status::HeadtailStatus;

/// Largest number of elements of a list.
const MOST: usize = 1 << 40;

/// A handle of an open environment or sampler; 0 is never a valid handle.
pub type HeadtailHandle = u64;

/// Shading points. Each list has one entry for all points, or one per point.
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
    /// Trowbridge-Reitz widths from 0.001 to 1; NULL for diffuse surfaces.
    pub alpha: *const f32,
    /// Number of entries of `alpha`.
    pub alpha_count: usize,
    /// Reflectances at normal incidence from 0 to 1; NULL uses 1.
    pub f0: *const f32,
    /// Number of entries of `f0`.
    pub f0_count: usize,
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

/// Creates the sampler of a SPEC for an environment, as on the command line: "auto" (here the same as
/// "patches", because there is no scene), "mis", "direct:FILE", ...
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
        *out = keep(sampler, environment, &serde_json::json!({ "sampler": parsed.to_string() }));
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
        let description = serde_json::to_value(exported.description()).unwrap_or_default();
        let sampler = exported.open(&environment).map_err(|error| error.in_file(path))?.into_inner();
        *out = keep(sampler, environment, &description);
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
            let at = point_list(points)?;
            let numbers = if u.is_null() { Numbers::Seed(seed) } else { Numbers::Given(list("u", u.cast(), count)?) };
            let light = if radiance.is_null() { None } else { Some(list_mut("radiance", radiance.cast(), count)?) };
            let out = DrawList {
                wi: list_mut("wi", wi.cast(), count)?,
                pdf: list_mut("pdf", pdf, count)?,
                radiance: light.map(|list| (&*sampler.environment, list)),
            };
            Ok(batch::sample(&*sampler.sampler, &at, numbers, out)?)
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
            Ok(batch::pdf(&*sampler.sampler, &point_list(points)?, wi, out)?)
        }
    })
}

/// Closes an environment or a sampler. A sampler keeps the data that it needs from its environment.
#[unsafe(no_mangle)]
pub extern "C" fn headtail_close(handle: HeadtailHandle) -> HeadtailStatus {
    call(|| handles::close(handle))
}

fn keep(sampler: Arc<dyn Sampler>, environment: Arc<Environment>, description: &serde_json::Value) -> HeadtailHandle {
    handles::open(Object::Sampler(Arc::new(OpenSampler { sampler, environment, description: description.to_string() })))
}

/// # Safety
/// `pointer` is NULL or ends with a zero byte.
unsafe fn text<'a>(name: &str, pointer: *const c_char) -> Result<&'a str, Failure> {
    if pointer.is_null() {
        return Err(Failure::argument(format!("{name}: is NULL")));
    }
    // SAFETY: guaranteed by the caller.
    let text = unsafe { CStr::from_ptr(pointer) };
    text.to_str().map_err(|_| Failure::argument(format!("{name}: is not UTF-8")))
}

/// # Safety
/// `pointer` is NULL or may be written to.
unsafe fn target<'a>(name: &str, pointer: *mut HeadtailHandle) -> Result<&'a mut HeadtailHandle, Failure> {
    check(name, pointer, 1)?;
    // SAFETY: guaranteed by the caller. The old value is overwritten; all bit patterns are valid handles.
    let out = unsafe { &mut *pointer };
    *out = 0;
    Ok(out)
}

fn check<T>(name: &str, pointer: *const T, count: usize) -> Result<(), Failure> {
    if pointer.is_null() {
        return Err(Failure::argument(format!("{name}: is NULL")));
    }
    if !pointer.is_aligned() {
        return Err(Failure::argument(format!("{name}: is not aligned")));
    }
    if count > MOST {
        return Err(Failure::argument(format!("{name}: has {count} entries")));
    }
    Ok(())
}

/// # Safety
/// `pointer` is NULL or holds `count` entries.
unsafe fn list<'a, T>(name: &str, pointer: *const T, count: usize) -> Result<&'a [T], Failure> {
    check(name, pointer, count)?;
    // SAFETY: guaranteed by the caller.
    Ok(unsafe { slice::from_raw_parts(pointer, count) })
}

/// # Safety
/// `pointer` is NULL or holds `count` entries that nothing else refers to.
unsafe fn list_mut<'a, T>(name: &str, pointer: *mut T, count: usize) -> Result<&'a mut [T], Failure> {
    check(name, pointer, count)?;
    // SAFETY: guaranteed by the caller.
    Ok(unsafe { slice::from_raw_parts_mut(pointer, count) })
}

/// # Safety
/// `points` is NULL or points to lists that are NULL or as long as their counts.
unsafe fn point_list<'a>(points: *const HeadtailPoints) -> Result<PointList<'a>, Failure> {
    // SAFETY: guaranteed by the caller.
    unsafe {
        let [points] = list("points", points, 1)? else { unreachable!("a list of one") };
        let wo = if points.wo.is_null() { &[] } else { list("wo", points.wo.cast(), points.wo_count)? };
        let f0 = if points.f0.is_null() { &[1.0] } else { list("f0", points.f0, points.f0_count)? };
        let surface = if points.alpha.is_null() {
            SurfaceList::Diffuse
        } else {
            SurfaceList::Glossy { alpha: list("alpha", points.alpha, points.alpha_count)?, f0 }
        };
        Ok(PointList { n: list("n", points.n.cast(), points.n_count)?, wo, surface })
    }
}
