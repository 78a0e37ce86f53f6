//! The pointers of callers as text, lists and targets of results.

use std::{
    ffi::{CStr, c_char},
    slice,
    sync::Arc,
};

use headtail_sampling::{
    batch::{DrawList, FittedMaterial, Numbers, PointList, SurfaceList},
    environment::Environment,
};

use crate::{HeadtailHandle, HeadtailPoints, handles, status::Failure};

/// Largest number of elements of a list.
const MOST: usize = 1 << 40;

/// # Safety
/// `pointer` is NULL or ends with a zero byte.
pub unsafe fn text<'a>(name: &str, pointer: *const c_char) -> Result<&'a str, Failure> {
    if pointer.is_null() {
        return Err(Failure::argument(format!("{name}: is NULL")));
    }
    // SAFETY: guaranteed by the caller.
    let text = unsafe { CStr::from_ptr(pointer) };
    text.to_str().map_err(|_| Failure::argument(format!("{name}: is not UTF-8")))
}

/// # Safety
/// `pointer` is NULL or may be written to.
pub unsafe fn target<'a>(name: &str, pointer: *mut HeadtailHandle) -> Result<&'a mut HeadtailHandle, Failure> {
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
    check_count(name, count)
}

/// Rejects lengths that no list has.
pub fn check_count(name: &str, count: usize) -> Result<(), Failure> {
    if count > MOST { Err(Failure::argument(format!("{name}: has {count} entries"))) } else { Ok(()) }
}

/// # Safety
/// `pointer` is NULL or holds `count` entries.
pub unsafe fn list<'a, T>(name: &str, pointer: *const T, count: usize) -> Result<&'a [T], Failure> {
    check(name, pointer, count)?;
    // SAFETY: guaranteed by the caller.
    Ok(unsafe { slice::from_raw_parts(pointer, count) })
}

/// # Safety
/// `pointer` is NULL or holds `count` entries that nothing else refers to.
pub unsafe fn list_mut<'a, T>(name: &str, pointer: *mut T, count: usize) -> Result<&'a mut [T], Failure> {
    check(name, pointer, count)?;
    // SAFETY: guaranteed by the caller.
    Ok(unsafe { slice::from_raw_parts_mut(pointer, count) })
}

/// # Safety
/// `u` is NULL or holds `count` points.
pub unsafe fn numbers<'a>(u: *const f32, seed: u64, count: usize) -> Result<Numbers<'a>, Failure> {
    // SAFETY: guaranteed by the caller.
    Ok(if u.is_null() { Numbers::Seed(seed) } else { Numbers::Given(unsafe { list("u", u.cast(), count)? }) })
}

/// # Safety
/// Pointers are NULL or hold `count` entries that nothing else refers to.
pub unsafe fn draw_list(
    environment: &Environment,
    count: usize,
    wi: *mut f32,
    pdf: *mut f32,
    radiance: *mut f32,
) -> Result<DrawList<'_>, Failure> {
    // SAFETY: guaranteed by the caller.
    unsafe {
        let light = if radiance.is_null() { None } else { Some(list_mut("radiance", radiance.cast(), count)?) };
        Ok(DrawList {
            wi: list_mut("wi", wi.cast(), count)?,
            pdf: list_mut("pdf", pdf, count)?,
            radiance: light.map(|list| (environment, list)),
        })
    }
}

/// Returns the lists of points, whose material, if they have one, is kept in `material`.
///
/// # Safety
/// `points` is NULL or points to lists that are NULL or as long as their counts.
pub unsafe fn point_list<'a>(
    points: *const HeadtailPoints,
    needs_positions: bool,
    material: &'a mut Option<Arc<FittedMaterial>>,
) -> Result<PointList<'a>, Failure> {
    // SAFETY: guaranteed by the caller.
    unsafe {
        let [points] = list("points", points, 1)? else { unreachable!("a list of one") };
        if needs_positions && points.p.is_null() {
            return Err(Failure::argument("p: is NULL; the sampler depends on positions"));
        }
        Ok(PointList {
            p: optional("p", points.p.cast(), points.p_count)?.unwrap_or(&[]),
            n: list("n", points.n.cast(), points.n_count)?,
            wo: optional("wo", points.wo.cast(), points.wo_count)?.unwrap_or(&[]),
            surface: surface_list(points, material)?,
        })
    }
}

/// # Safety
/// Lists are NULL or as long as their counts.
unsafe fn surface_list<'a>(
    points: &HeadtailPoints,
    material: &'a mut Option<Arc<FittedMaterial>>,
) -> Result<SurfaceList<'a>, Failure> {
    let [glossy, of_gltf, fitted] = [!points.alpha.is_null(), !points.roughness.is_null(), points.material != 0];
    let others = [
        ("f0", points.f0, glossy, "alpha"),
        ("metallic", points.metallic, of_gltf, "roughness"),
        ("base_color", points.base_color, of_gltf, "roughness"),
        ("uv", points.uv, fitted, "material"),
        ("tangent", points.tangent, fitted, "material"),
        ("footprint", points.footprint, fitted, "material"),
    ];
    if let Some((name, _, _, kind)) = others.into_iter().find(|(_, list, has_kind, _)| !list.is_null() && !has_kind) {
        return Err(Failure::argument(format!("{name}: is of surfaces that have {kind}")));
    }
    // SAFETY: guaranteed by the caller.
    unsafe {
        Ok(match (glossy, of_gltf, fitted) {
            (false, false, false) => SurfaceList::Diffuse,
            (true, false, false) => SurfaceList::Glossy {
                alpha: list("alpha", points.alpha, points.alpha_count)?,
                f0: optional("f0", points.f0, points.f0_count)?.unwrap_or(&[1.0]),
            },
            (false, true, false) => SurfaceList::MetallicRoughness {
                base_color: optional("base_color", points.base_color.cast(), points.base_color_count)?
                    .unwrap_or(&[[1.0; 3]]),
                metallic: optional("metallic", points.metallic, points.metallic_count)?.unwrap_or(&[0.0]),
                roughness: list("roughness", points.roughness, points.roughness_count)?,
            },
            (false, false, true) => SurfaceList::Fitted {
                material: material.insert(handles::material(points.material)?),
                uv: optional("uv", points.uv.cast(), points.uv_count)?.unwrap_or(&[]),
                tangent: optional("tangent", points.tangent.cast(), points.tangent_count)?.unwrap_or(&[]),
                footprint: optional("footprint", points.footprint, points.footprint_count)?.unwrap_or(&[]),
            },
            _ => return Err(Failure::argument("alpha, roughness and material: are of different surfaces; give one")),
        })
    }
}

/// # Safety
/// As for [`list`].
unsafe fn optional<'a, T>(name: &str, pointer: *const T, count: usize) -> Result<Option<&'a [T]>, Failure> {
    // SAFETY: guaranteed by the caller.
    if pointer.is_null() { Ok(None) } else { unsafe { list(name, pointer, count).map(Some) } }
}
