//! A synthetic comparison for tests: a lit ball on a plane with the noise of samplers of known quality.

use headtail_eval::{Measurement, mean_luminance};
use headtail_render::image::Image;
use headtail_render::random::{Purpose, Stream};
use headtail_render::statistics::{ErrorMetrics, ttuv};

use super::comparison::{Comparison, Preparation, RenderedImage, State};

/// A run with arbitrary results.
pub fn row(sampler: &str, budget: &str, run: u32) -> Measurement {
    Measurement {
        scene: "ball".into(),
        env: "sky".into(),
        sampler: sampler.into(),
        budget: budget.into(),
        run,
        spp: 16.0,
        rays_per_sample: 1.0,
        seconds: 0.5,
        mse: 0.1,
        relmse: 0.2,
        relmse_trimmed: 0.15,
        ttuv: 0.05,
        mean_luminance: 1.0,
        max_weight: 7.5,
        seed: 1000 + u64::from(run),
        version: "0.1.0".into(),
        points: "sobol".into(),
        ..Measurement::unknown()
    }
}

/// A smooth picture: a shaded ball on a plane under a bright sky.
fn reference(width: usize, height: usize) -> Image {
    let mut image = Image::black(width, height);
    for y in 0..height {
        for x in 0..width {
            let (u, v) = ((x as f32 + 0.5) / width as f32 * 2.0 - 1.0, 1.0 - (y as f32 + 0.5) / height as f32 * 2.0);
            let r2 = (u * u + v * v) / 0.36;
            image.pixels[y * width + x] = if r2 < 1.0 {
                let z = (1.0 - r2).sqrt();
                let light = (0.5 * u / 0.6 + 0.7 * v / 0.6 + 0.5 * z).max(0.0);
                [0.05 + 0.8 * light, 0.04 + 0.45 * light, 0.03 + 0.2 * light].map(|c| c + 3.0 * light.powi(40))
            } else if v < -0.3 {
                let shade = 0.15 + 0.5 * ((u + 0.4).hypot(1.5 * (v + 0.65))).min(1.0);
                [shade, 0.95 * shade, 0.85 * shade]
            } else {
                [0.5 + 0.2 * v, 0.7 + 0.3 * v, 1.0 + 0.6 * v]
            };
        }
    }
    image
}

/// A rendering with gamma-like noise of the given relative variance.
fn noisy(reference: &Image, variance: f32, random: &mut Stream) -> Image {
    let mut image = reference.clone();
    let terms = (1.0 / variance).ceil().max(1.0) as usize;
    let spread = (variance * terms as f32).sqrt();
    for pixel in &mut image.pixels {
        let mean = (0..terms.min(24)).map(|_| -(1.0 - random.uniform()).ln()).sum::<f32>() / terms.min(24) as f32;
        let spread = spread * (terms.min(24) as f32 / terms as f32).sqrt();
        let factor = 1.0 + spread * (mean - 1.0);
        *pixel = pixel.map(|c| c * factor.max(0.0));
    }
    image
}

/// Seven samplers, three budgets of samples and one of time, three runs each.
pub fn comparison() -> Comparison {
    let (width, height) = (96, 64);
    let reference = reference(width, height);
    // Relative variance of a sample, seconds per sample per pixel, rays per sample.
    let samplers = [
        ("mis", 1.6, 0.010, 1.0),
        ("brdf", 9.0, 0.007, 1.0),
        ("emitter", 2.9, 0.008, 1.0),
        ("two-sample-mis", 0.75, 0.018, 2.0),
        ("ris-4", 0.36, 0.021, 1.0),
        ("cosine-bake", 0.15, 0.013, 1.0),
        ("head <ggx> + brdf", 0.09, 0.034, 1.0),
    ];
    let mut rows = Vec::new();
    let mut images = Vec::new();
    for (index, &(sampler, variance, seconds_per_sample, rays)) in samplers.iter().enumerate() {
        for budget in ["4spp", "16spp", "64spp", "2s"] {
            let spp = match budget.strip_suffix("spp") {
                Some(spp) => spp.parse().unwrap(),
                None => (2.0_f64 / seconds_per_sample).floor(),
            };
            for run in 0..3 {
                let seed = 100 * index as u64 + u64::from(run);
                let mut random = Stream::new(seed, Purpose::Test, spp as u64);
                let image = noisy(&reference, variance / spp as f32, &mut random);
                let errors = ErrorMetrics::of(&image, &reference).unwrap();
                let seconds = spp * seconds_per_sample * (1.0 + 0.03 * f64::from(random.uniform()));
                rows.push(Measurement {
                    spp,
                    rays_per_sample: rays,
                    seconds,
                    mse: errors.mse,
                    relmse: errors.relmse,
                    relmse_trimmed: errors.relmse_trimmed,
                    ttuv: ttuv(errors.mse, seconds),
                    mean_luminance: mean_luminance(&image),
                    max_weight: f64::from(40.0 * variance * (1.0 + random.uniform())),
                    seed,
                    ..row(sampler, budget, run)
                });
                if run == 0 {
                    images.push(RenderedImage { sampler: sampler.into(), budget: budget.into(), image });
                }
            }
        }
    }
    let preparation = [
        ("cosine-bake", 0.8, "tabulated on 16 x 32 normals, 8 x 8 cells"),
        ("head <ggx> + brdf", 68.0, "trained for 2500 steps of 4096 points on the CPU"),
    ]
    .map(|(sampler, seconds, text)| Preparation { sampler: sampler.into(), seconds, text: text.into() });
    Comparison {
        scene: "ball on a plane".into(),
        env: "sky & sun".into(),
        width,
        height,
        command: "headtail compare --scene ball --env sky.exr --spp 4,16,64 --seconds 2 --runs 3 --out results".into(),
        machine: "8-core example CPU, 32 GB, Linux".into(),
        version: "0.1.0".into(),
        reference,
        measured: Vec::new(),
        reference_note: "65536 samples per pixel of one-sample MIS, another seed".into(),
        rows,
        images,
        preparation: preparation.into(),
        state: State::Complete,
    }
}
