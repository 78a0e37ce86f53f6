//! Calls with invalid arguments end with a code and a message.

use std::{
    ffi::{CStr, CString, c_char},
    ptr::{null, null_mut},
    sync::Arc,
    thread,
};

use headtail_c::*;
use headtail_sampling::{
    batch::{self, DrawList, Numbers, PointList, SurfaceList},
    environment::Environment,
    spec::SamplerSpec,
};

fn error() -> String {
    // SAFETY: the message of this thread, copied before the next call.
    unsafe { CStr::from_ptr(headtail_last_error()) }.to_str().unwrap().to_owned()
}

fn environment(name: &str) -> HeadtailHandle {
    let (name, mut handle) = (CString::new(name).unwrap(), 0);
    // SAFETY: both live as long as the call.
    assert_eq!(unsafe { headtail_environment_open(name.as_ptr(), &mut handle) }, HeadtailStatus::Ok);
    handle
}

fn patches(environment: HeadtailHandle) -> HeadtailHandle {
    let mut handle = 0;
    // SAFETY: both live as long as the call.
    assert_eq!(
        unsafe { headtail_sampler_from_spec(c"patches".as_ptr(), environment, &mut handle) },
        HeadtailStatus::Ok
    );
    handle
}

const UP: [f32; 3] = [0.0, 1.0, 0.0];

fn points(n: &[[f32; 3]]) -> HeadtailPoints {
    HeadtailPoints { n: n.as_ptr().cast(), n_count: n.len(), ..HeadtailPoints::default() }
}

#[test]
fn samples_match_the_batch_and_their_pdfs_agree() {
    let map = environment("studio");
    let sampler = patches(map);
    assert_eq!(headtail_close(map), HeadtailStatus::Ok);
    let (mut wi, mut pdf, mut radiance, mut again) = ([[0.0_f32; 3]; 100], [0.0; 100], [[0.0_f32; 3]; 100], [0.0; 100]);
    let at = points(&[UP]);
    // SAFETY: lists have the given lengths.
    unsafe {
        let [wi, light] = [wi.as_flattened_mut().as_mut_ptr(), radiance.as_flattened_mut().as_mut_ptr()];
        let status = headtail_sampler_sample(sampler, &at, 100, null(), 7, wi, pdf.as_mut_ptr(), light);
        assert_eq!(status, HeadtailStatus::Ok, "{}", error());
        assert_eq!(headtail_sampler_pdf(sampler, &at, 100, wi, again.as_mut_ptr()), HeadtailStatus::Ok, "{}", error());
    }
    assert!(pdf.iter().zip(again).all(|(a, b)| *a > 0.0 && (b / a - 1.0).abs() < 1e-2));
    let (mut own_wi, mut own_pdf, mut own_radiance) = ([[0.0_f32; 3]; 100], [0.0_f32; 100], [[0.0_f32; 3]; 100]);
    let studio = Arc::new(Environment::open("studio").unwrap());
    let patches = SamplerSpec::patches().build_sampler(&studio).unwrap();
    let at = PointList { p: &[], n: &[UP], wo: &[], surface: SurfaceList::Diffuse };
    let out = DrawList { wi: &mut own_wi, pdf: &mut own_pdf, radiance: Some((&studio, &mut own_radiance)) };
    batch::sample(&patches, &at, Numbers::Seed(7), out).unwrap();
    assert!(wi == own_wi && pdf == own_pdf && radiance == own_radiance);
    assert!(radiance.as_flattened().iter().any(|value| *value > 0.0));
    let (mut text, mut length) = ([0 as c_char; 12], 0);
    // SAFETY: the buffer has the given capacity.
    unsafe {
        assert_eq!(headtail_sampler_describe(sampler, text.as_mut_ptr(), text.len(), &mut length), HeadtailStatus::Ok);
        assert_eq!(CStr::from_ptr(text.as_ptr()).to_str(), Ok("{\"sampler\":"));
    }
    assert_eq!(length, "{\"sampler\":\"patches\"}".len() + 1);
}

#[test]
fn prepared_points_give_the_same_draws_and_outlive_their_sampler() {
    let map = environment("studio");
    let sampler = patches(map);
    let roughness = [0.3_f32];
    let at = HeadtailPoints { roughness: roughness.as_ptr(), roughness_count: 1, ..points(&[UP]) };
    let (mut prepared, mut none) = (0, 1);
    let (mut wi, mut pdf, mut again) = ([[[0.0_f32; 3]; 40]; 2], [[0.0_f32; 40]; 2], [0.0_f32; 40]);
    // SAFETY: lists have the given lengths.
    unsafe {
        let [once, twice] = wi.each_mut().map(|wi| wi.as_flattened_mut().as_mut_ptr());
        let [first, second] = pdf.each_mut().map(|pdf| pdf.as_mut_ptr());
        let status = headtail_sampler_sample(sampler, &at, 40, null(), 7, once, first, null_mut());
        assert_eq!(status, HeadtailStatus::Ok, "{}", error());
        assert_eq!(headtail_points_prepare(sampler, &at, 40, &mut prepared), HeadtailStatus::Ok, "{}", error());
        assert_eq!(headtail_points_prepare(sampler, &at, usize::MAX, &mut none), HeadtailStatus::Invalid);
        let both = HeadtailPoints { alpha: roughness.as_ptr(), alpha_count: 1, ..at };
        assert_eq!(headtail_points_prepare(sampler, &both, 40, &mut none), HeadtailStatus::Invalid);
        assert_eq!((error().as_str(), none), ("alpha, roughness and material: are of different surfaces; give one", 0));
        let smooth = HeadtailPoints { metallic: roughness.as_ptr(), metallic_count: 1, ..points(&[UP]) };
        assert_eq!(headtail_points_prepare(sampler, &smooth, 40, &mut none), HeadtailStatus::Invalid);
        assert!(error().contains("metallic: is of surfaces that have roughness"), "{}", error());
        let flat = HeadtailPoints { f0: roughness.as_ptr(), f0_count: 1, ..points(&[UP]) };
        assert_eq!(headtail_points_prepare(sampler, &flat, 40, &mut none), HeadtailStatus::Invalid);
        assert!(error().contains("f0: is of surfaces"), "{}", error());
        assert_eq!((headtail_close(sampler), headtail_close(map)), (HeadtailStatus::Ok, HeadtailStatus::Ok));
        let status = headtail_points_sample(prepared, 40, null(), 7, twice, second, null_mut());
        assert_eq!(status, HeadtailStatus::Ok, "{}", error());
        assert_eq!(headtail_points_pdf(prepared, 40, once, again.as_mut_ptr()), HeadtailStatus::Ok, "{}", error());
        assert_eq!(headtail_points_pdf(prepared, 39, once, again.as_mut_ptr()), HeadtailStatus::Invalid);
        assert_eq!(headtail_sampler_pdf(prepared, &at, 40, once, again.as_mut_ptr()), HeadtailStatus::Invalid);
        assert!(error().contains("is prepared points, not a sampler"), "{}", error());
    }
    assert!(wi[0] == wi[1] && pdf[0] == pdf[1]);
    assert!(pdf[0].iter().zip(again).all(|(a, b)| *a > 0.0 && (b / a - 1.0).abs() < 1e-2));
    assert_eq!(headtail_close(prepared), HeadtailStatus::Ok);
}

#[test]
fn materials_reflect_as_in_the_batch() {
    let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../checkpoints/satin.safetensors");
    let name = format!("neural:{}", file.display());
    let (text, mut material, map) = (CString::new(name.as_str()).unwrap(), 0, environment("studio"));
    // SAFETY: the text ends with a zero byte.
    assert_eq!(unsafe { headtail_material_open(text.as_ptr(), &mut material) }, HeadtailStatus::Ok, "{}", error());
    let (uv, tangent, wo, wi) =
        ([[0.3_f32, 0.6]], [[1.0_f32, 0.0, 0.0, -1.0]], [[0.6_f32, 0.8, 0.0]], [[0.0_f32, 0.8, 0.6]]);
    let at = HeadtailPoints {
        wo: wo.as_ptr().cast(),
        wo_count: 1,
        material,
        uv: uv.as_ptr().cast(),
        uv_count: 1,
        tangent: tangent.as_ptr().cast(),
        tangent_count: 1,
        ..points(&[UP])
    };
    let reflected = |at: &HeadtailPoints| {
        let mut value = [0.0_f32; 3];
        // SAFETY: lists have the given lengths.
        (unsafe { headtail_brdf_cosine(at, 1, wi.as_ptr().cast(), value.as_mut_ptr()) }, value)
    };
    let (status, value) = reflected(&at);
    assert_eq!(status, HeadtailStatus::Ok, "{}", error());
    for (wrong, reason) in [
        (HeadtailPoints { material: map, ..at }, "is an environment, not a material"),
        (HeadtailPoints { material: 0, ..at }, "uv: is of surfaces that have material"),
        (HeadtailPoints { uv: null(), ..at }, "uv: has 0 rows"),
    ] {
        assert_eq!(reflected(&wrong).0, HeadtailStatus::Invalid);
        assert!(error().contains(reason), "{}, not {reason}", error());
    }
    let own = batch::FittedMaterial::open(&name).unwrap();
    let surface = SurfaceList::Fitted { material: &own, uv: &uv, tangent: &tangent, footprint: &[] };
    let mut expected = [[0.0_f32; 3]];
    batch::brdf_cosine(&PointList { p: &[], n: &[UP], wo: &wo, surface }, &wi, &mut expected).unwrap();
    assert!([value] == expected && value[1] > 0.0, "{value:?} {expected:?}");
    // Closed materials stay with points that were prepared.
    let (sampler, mut prepared, mut pdf) = (patches(map), 0, 0.0);
    // SAFETY: lists have the given lengths.
    unsafe {
        assert_eq!(headtail_points_prepare(sampler, &at, 1, &mut prepared), HeadtailStatus::Ok, "{}", error());
        assert_eq!(headtail_close(material), HeadtailStatus::Ok);
        assert_eq!(headtail_points_pdf(prepared, 1, wi.as_ptr().cast(), &mut pdf), HeadtailStatus::Ok);
    }
    assert!(pdf > 0.0);
    assert_eq!(reflected(&at).0, HeadtailStatus::Invalid);
}

#[test]
fn closed_and_invalid_handles_are_errors() {
    let map = environment("overcast");
    let sampler = patches(map);
    let (mut handle, mut wi, mut pdf) = (1, [0.0; 3], [0.0; 1]);
    let mut draw = |handle, at: *const HeadtailPoints, wi_out: *mut f32| {
        // SAFETY: lists have the given lengths, or are NULL.
        unsafe { headtail_sampler_sample(handle, at, 1, null(), 0, wi_out, pdf.as_mut_ptr(), null_mut()) }
    };
    let at = points(&[UP]);
    for wrong in [0, map, u64::MAX] {
        assert_eq!(draw(wrong, &at, wi.as_mut_ptr()), HeadtailStatus::Invalid);
        assert!(error().contains(if wrong == map { "is an environment" } else { "is not open" }));
    }
    assert_eq!(draw(sampler, null(), wi.as_mut_ptr()), HeadtailStatus::Invalid);
    assert_eq!(error(), "points: is NULL");
    assert_eq!(draw(sampler, &at, null_mut()), HeadtailStatus::Invalid);
    assert_eq!(error(), "wi: is NULL");
    assert_eq!(draw(sampler, &points(&[[f32::NAN; 3]]), wi.as_mut_ptr()), HeadtailStatus::Invalid);
    assert!(error().contains("n: row 0 is (NaN, NaN, NaN)"));
    assert_eq!(draw(sampler, &points(&[UP; 2]), wi.as_mut_ptr()), HeadtailStatus::Invalid);
    let crooked = HeadtailPoints { n: (1 + wi.as_ptr() as usize) as *const f32, ..at };
    assert_eq!(draw(sampler, &crooked, wi.as_mut_ptr()), HeadtailStatus::Invalid);
    assert_eq!(headtail_close(sampler), HeadtailStatus::Ok);
    assert_eq!(headtail_close(sampler), HeadtailStatus::Invalid);
    assert_eq!(draw(sampler, &at, wi.as_mut_ptr()), HeadtailStatus::Invalid);
    // SAFETY: texts end with a zero byte, or are NULL.
    unsafe {
        assert_eq!(headtail_environment_open(null(), &mut handle), HeadtailStatus::Invalid);
        assert_eq!(headtail_environment_open(c"studio".as_ptr(), null_mut()), HeadtailStatus::Invalid);
        assert_eq!(headtail_environment_open(c"missing.hdr".as_ptr(), &mut handle), HeadtailStatus::Invalid);
        assert_eq!(handle, 0);
        assert_eq!(headtail_environment_open(c"\xff\xfe".as_ptr(), &mut handle), HeadtailStatus::Invalid);
        assert_eq!(
            headtail_environment_from_texels(1 << 40, 1 << 40, wi.as_ptr(), &mut handle),
            HeadtailStatus::Invalid
        );
        assert_eq!(headtail_sampler_from_spec(c"ris:4".as_ptr(), map, &mut handle), HeadtailStatus::Invalid);
        assert_eq!(headtail_sampler_from_spec(c"nonsense".as_ptr(), map, &mut handle), HeadtailStatus::Invalid);
        assert_eq!(headtail_sampler_open(c"missing".as_ptr(), map, &mut handle), HeadtailStatus::Io);
        let of_studio = c"../checkpoints/studio-direct.safetensors".as_ptr();
        assert_eq!(headtail_sampler_open(of_studio, map, &mut handle), HeadtailStatus::Invalid);
    }
    assert_eq!(handle, 0);
    assert!(error().contains("was made for the environment 'studio', not for 'overcast'"), "{}", error());
}

#[test]
fn a_sampler_may_be_closed_while_other_threads_sample() {
    let map = environment("overcast");
    let sampler = patches(map);
    thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                let (mut wi, mut pdf) = (vec![0.0; 3 * 5000], vec![0.0; 5000]);
                loop {
                    let at = points(&[UP]);
                    // SAFETY: lists have the given lengths.
                    let status = unsafe {
                        headtail_sampler_sample(
                            sampler,
                            &at,
                            5000,
                            null(),
                            0,
                            wi.as_mut_ptr(),
                            pdf.as_mut_ptr(),
                            null_mut(),
                        )
                    };
                    if status != HeadtailStatus::Ok {
                        break assert!(error().contains("is not open"));
                    }
                    assert!(pdf.iter().all(|pdf| *pdf > 0.0));
                }
            });
        }
        thread::sleep(std::time::Duration::from_millis(50));
        assert_eq!(headtail_close(sampler), HeadtailStatus::Ok);
    });
}
