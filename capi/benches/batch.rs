//! Samples through the C interface beside the same from Rust, in turn: `cargo bench -p headtail-capi --bench batch`. Prints rows
//! of JSON: nanoseconds of a direction with its pdf and the light from it, each at a point of its own.
//!
//! Both compute the same; the C interface also checks its handles and lists. The header for C++ has no code of its own behind a
//! call.

use std::{
    ffi::CString,
    ptr::null,
    sync::Arc,
    time::{Duration, Instant},
};

use headtail_c::{
    HeadtailHandle, HeadtailPoints, HeadtailStatus, headtail_environment_open, headtail_sampler_from_spec,
    headtail_sampler_sample,
};
use headtail_sampling::{
    batch::{self, DrawList, Numbers, PointList, SurfaceList},
    environment::Environment,
    spec::SamplerSpec,
};

const SPECS: [&str; 3] = ["mis-comp", "patches", "brdf"];
/// Points of a call.
const SIZES: [usize; 3] = [1, 64, 4096];

/// How long each batch is measured, about.
const SPAN: Duration = Duration::from_secs(2);

fn main() {
    let rows: Vec<_> = SIZES.iter().flat_map(|&count| SPECS.map(|spec| row(spec, count))).collect();
    println!("{}", serde_json::Value::from(rows));
}

/// Measures one sampler with `count` points a call.
fn row(spec: &str, count: usize) -> serde_json::Value {
    let map = Arc::new(Environment::open("studio").expect("a map"));
    let parsed: SamplerSpec = spec.parse().expect("a sampler");
    let native = parsed.resolved(false).build_sampler(&map).expect("a sampler");
    let sampler = sampler(spec);
    let n = normals(count);
    let listed = PointList { p: &[], n: &n, wo: &[UP], surface: SurfaceList::Glossy { alpha: &ALPHA, f0: &[1.0] } };
    let at = HeadtailPoints {
        n: n.as_ptr().cast(),
        n_count: count,
        wo: UP.as_ptr(),
        wo_count: 1,
        alpha: ALPHA.as_ptr(),
        alpha_count: 1,
        ..HeadtailPoints::default()
    };
    let (mut wi, mut pdf, mut light) = (vec![[0.0; 3]; count], vec![0.0; count], vec![[0.0; 3]; count]);
    let (mut rust, mut c) = (Vec::new(), Vec::new());
    let start = Instant::now();
    while start.elapsed() < SPAN {
        let before = Instant::now();
        let out = DrawList { wi: &mut wi, pdf: &mut pdf, radiance: Some((&map, &mut light)) };
        batch::sample(&*native, &listed, Numbers::Seed(7), out).expect("samples");
        let between = Instant::now();
        let [wi, light] = [&mut wi, &mut light].map(|list| list.as_flattened_mut().as_mut_ptr());
        // SAFETY: lists have the given lengths.
        let status = unsafe { headtail_sampler_sample(sampler, &at, count, null(), 7, wi, pdf.as_mut_ptr(), light) };
        c.push(between.elapsed());
        rust.push(between - before);
        assert_eq!(status, HeadtailStatus::Ok);
    }
    let [rust, c] = [rust, c].map(|mut times| {
        times.sort_unstable();
        times[times.len() / 2].as_nanos() as f64 / count as f64
    });
    serde_json::json!({ "sampler": spec, "points": count.to_string(), "rust": rust, "c": c, "ratio": c / rust })
}

fn sampler(spec: &str) -> HeadtailHandle {
    let spec = CString::new(spec).expect("no zero in it");
    let (mut map, mut sampler) = (0, 0);
    // SAFETY: texts end with zeros, and the rest lives as long as the calls.
    unsafe {
        assert_eq!(headtail_environment_open(c"studio".as_ptr(), &mut map), HeadtailStatus::Ok);
        assert_eq!(headtail_sampler_from_spec(spec.as_ptr(), map, &mut sampler), HeadtailStatus::Ok);
    }
    sampler
}

/// Normals over the upper hemisphere, the viewer above.
fn normals(count: usize) -> Vec<[f32; 3]> {
    let normal = |k: usize| {
        let (y, angle) = ((k as f32 + 0.5) / count as f32, 2.4 * k as f32);
        let across = (1.0 - y * y).sqrt();
        [across * angle.cos(), y, across * angle.sin()]
    };
    (0..count).map(normal).collect()
}

const UP: [f32; 3] = [0.0, 1.0, 0.0];
const ALPHA: [f32; 1] = [0.3];
