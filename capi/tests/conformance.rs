//! The C library passes the conformance kit.

use std::ffi::{CString, c_char};

use glam::Vec3A;
use headtail_c::*;
use headtail_eval::conformance::{self, Answer, Case};

/// Answers a case, by prepared points.
fn answers(sampler: HeadtailHandle, case: &Case) -> Vec<Answer> {
    let rows = case.rows().unwrap();
    let n: Vec<[f32; 3]> = rows.iter().map(|row| row.n.to_array()).collect();
    let wo: Vec<[f32; 3]> = rows.iter().map(|row| row.wo.to_array()).collect();
    let u: Vec<[f32; 2]> = rows.iter().map(|row| row.u.to_array()).collect();
    let given: Vec<[f32; 3]> = rows.iter().map(|row| row.given.to_array()).collect();
    let mut at = HeadtailPoints { n: n.as_ptr().cast(), n_count: n.len(), ..HeadtailPoints::default() };
    (at.wo, at.wo_count) = (wo.as_ptr().cast(), wo.len());
    if let Some(alpha) = &case.alpha {
        (at.alpha, at.alpha_count) = (alpha, 1);
    }
    let (count, mut points) = (rows.len(), 0);
    let (mut wi, mut pdf, mut of_given) = (vec![[0.0_f32; 3]; count], vec![0.0; count], vec![0.0; count]);
    // SAFETY: lists have the given lengths.
    unsafe {
        assert_eq!(headtail_points_prepare(sampler, &at, count, &mut points), HeadtailStatus::Ok);
        let (u, directions) = (u.as_ptr().cast(), wi.as_flattened_mut().as_mut_ptr());
        let status = headtail_points_sample(points, count, u, 0, directions, pdf.as_mut_ptr(), std::ptr::null_mut());
        assert_eq!(status, HeadtailStatus::Ok);
        let given = given.as_flattened().as_ptr();
        assert_eq!(headtail_points_pdf(points, count, given, of_given.as_mut_ptr()), HeadtailStatus::Ok);
    }
    assert_eq!(headtail_close(points), HeadtailStatus::Ok);
    let answer = |((wi, pdf), pdf_of_given)| Answer { wi: Vec3A::from_array(wi), pdf, pdf_of_given };
    wi.into_iter().zip(pdf).zip(of_given).map(answer).collect()
}

#[test]
fn the_c_library_passes_the_conformance_kit() {
    let (folder, map) = (tempfile::tempdir().unwrap(), conformance::map().unwrap());
    let table = folder.path().join("table.safetensors");
    conformance::table(&map).unwrap().write(&table).unwrap();
    let (image, mut environment) = (map.to_image(), 0);
    let texels = image.pixels.as_flattened().as_ptr();
    // SAFETY: the list has width * height texels.
    let status = unsafe { headtail_environment_from_texels(image.width, image.height, texels, &mut environment) };
    assert_eq!(status, HeadtailStatus::Ok);
    let cases = conformance::cases(&map).unwrap();
    let specs = [("emitter", "emitter"), ("patches", "patches"), ("table", "table"), ("mis-glossy", "mis")];
    for (name, spec) in specs {
        let mut sampler = 0;
        let text = CString::new(if name == "table" { table.to_str().unwrap() } else { spec }).unwrap();
        let open: unsafe extern "C" fn(*const c_char, HeadtailHandle, *mut HeadtailHandle) -> HeadtailStatus =
            if name == "table" { headtail_sampler_open } else { headtail_sampler_from_spec };
        // SAFETY: the text ends with a zero byte.
        assert_eq!(unsafe { open(text.as_ptr(), environment, &mut sampler) }, HeadtailStatus::Ok, "{name}");
        let case = cases.iter().find(|case| case.name == name).unwrap();
        conformance::write_answers(folder.path(), name, &answers(sampler, case)).unwrap();
    }
    let verdicts = conformance::check(folder.path()).unwrap();
    verdicts.iter().for_each(|verdict| println!("{verdict}"));
    assert!(verdicts.len() == 4 && verdicts.iter().all(conformance::Verdict::passed));
}
