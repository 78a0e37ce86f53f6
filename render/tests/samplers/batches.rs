//! The forms for many points at once, which the integrator uses, against the forms for one point and against the truth.

use headtail_render::{integrator::SingleSample, random::Streams};

use super::{
    conditioned::{HEADS, product},
    glossy::POINTS,
    *,
};

/// What a sampler gives for many points: fused, prepared, the pdfs of what was drawn in both ways, and the shares.
struct Together {
    samples: Vec<Option<DirectionSample>>,
    prepared: Vec<Option<DirectionSample>>,
    pdfs: Vec<f32>,
    fused_pdfs: Vec<f32>,
    shares: Vec<f32>,
}

/// One point at a time.
struct Alone {
    sample: Option<DirectionSample>,
    /// Of the direction that was drawn together with others.
    pdf: f32,
    share: f32,
}

fn together<S: DirectionSampler>(sampler: &S, at: &[ShadingPoint], u: &[Vec2]) -> Together {
    let none = || vec![None; at.len()];
    let zeros = || vec![0.0; at.len()];
    let mut out = Together { samples: none(), prepared: none(), pdfs: zeros(), fused_pdfs: zeros(), shares: zeros() };
    sampler.sample_batch(at, u, &mut out.samples);
    sampler.share_batch(at, &mut out.shares);
    let prepared = sampler.prepare_batch(at);
    let (prepared, references): (Vec<_>, Vec<_>) = prepared.iter().zip(at).unzip();
    sampler.sample_prepared(&prepared, &references, u, &mut out.prepared);
    let wi: Vec<Vec3A> = out.prepared.iter().map(|sample| sample.map_or(Vec3A::Z, |sample| sample.wi)).collect();
    sampler.pdf_prepared(&prepared, &references, &wi, &mut out.pdfs);
    sampler.pdf_batch(at, &wi, &mut out.fused_pdfs);
    out
}

/// Differences between both forms. Networks round differently, and a texel's edge between two roundings is a step of the pdf:
/// one sample in a hundred may differ, the rest by what 1e-5 in Y becomes through the tail.
fn check<S: DirectionSampler>(name: &str, sampler: &S, at: &[ShadingPoint], exact: bool) {
    let mut random = Stream::new(7, Purpose::Test, 5);
    let u: Vec<Vec2> = at.iter().map(|_| random.uniform2()).collect();
    let Together { samples, prepared, pdfs, fused_pdfs, shares } = together(sampler, at, &u);
    let alone = |k: usize| {
        let own = sampler.prepare(&at[k]);
        let wi = prepared[k].map_or(Vec3A::Z, |sample| sample.wi);
        let (sample, pdf) = (sampler.sample(&own, &at[k], u[k]), sampler.pdf(&own, &at[k], wi));
        Alone { sample, pdf, share: sampler.share_beside_brdf(&own) }
    };
    let near = |a: f32, b: f32| if exact { a == b } else { (a - b).abs() <= 2e-3 * a.abs().max(b.abs()) };
    let same = |a: Option<DirectionSample>, b: Option<DirectionSample>| match (a, b) {
        (Some(a), Some(b)) => {
            let moved = (a.wi - b.wi).length();
            (if exact { moved == 0.0 } else { moved < 1e-3 }) && near(a.pdf, b.pdf)
        }
        (None, None) => true,
        _ => false,
    };
    let wrong = |k: &usize| {
        let alone = alone(*k);
        let drawn = same(samples[*k], alone.sample) && same(prepared[*k], alone.sample);
        let known = near(pdfs[*k], alone.pdf) && near(fused_pdfs[*k], alone.pdf) && near(shares[*k], alone.share);
        !drawn || !known
    };
    let wrong: Vec<usize> = (0..at.len()).filter(wrong).collect();
    assert!(wrong.len() <= if exact { 0 } else { at.len() / 100 }, "{name}: {} of {}", wrong.len(), at.len());
}

#[test]
fn many_points_get_what_each_would_get_alone() {
    for (world, points) in WORLDS.iter().zip(&*POINTS).filter(|(world, _)| world.name.starts_with("window")) {
        let mut random = Stream::new(3, Purpose::Test, 6);
        let diffuse: Vec<ShadingPoint> = (0..500).map(|_| shading_point(random.direction())).collect();
        let glossy: Vec<ShadingPoint> = points.iter().cycle().take(500).map(|point| point.at).collect();
        let (brdf, emitter) = (BrdfSampler::new(world.environment().clone()), EmitterSampler::new(world.light.clone()));
        let (normals, cells) = (NormalGrid::new(16, 32).unwrap(), CellGrid::new(8, 8).unwrap());
        let table = direct_bake(world.light.tail(), normals, cells).unwrap();
        let table = ProductSampler::new(world.light.clone(), table);
        for at in [&diffuse, &glossy] {
            check("brdf", &brdf, at, true);
            check("emitter", &emitter, at, true);
            check("compensated", &CompensatedEmitterSampler::new(&world.light).unwrap(), at, true);
            check("mis", &OneSampleMis::new(emitter.clone(), brdf.clone()), at, true);
            check("table+mis", &OneSampleMis::new(table.clone(), brdf.clone()), at, false);
            check("table", &table, at, false);
            for (name, head) in HEADS.iter() {
                check(name, &product(world, head), at, false);
                check(name, &OneSampleMis::new(product(world, head), brdf.clone()), at, false);
            }
        }
    }
}

#[test]
fn estimators_of_many_points_estimate_the_same_light() {
    /// Samples of a point at a time: not a whole number of strips.
    const TOGETHER: usize = 100;
    let tasks: Vec<_> =
        WORLDS.iter().zip(&*POINTS).flat_map(|(world, points)| points.iter().map(move |at| (world, at))).collect();
    let tests = 5 * tasks.len();
    let failures: Vec<String> = tasks
        .par_iter()
        .enumerate()
        .flat_map_iter(|(k, (world, point))| {
            let head = product(world, &HEADS[k % HEADS.len()].1);
            let brdf = || BrdfSampler::new(world.environment().clone());
            let of_head = Resampled::new(head.clone(), brdf(), 4).unwrap();
            let of_emitter = Resampled::new(EmitterSampler::new(world.light.clone()), brdf(), 5).unwrap();
            let estimators: [(&str, Box<dyn DirectEstimator>); 5] = [
                ("head", Box::new(SingleSample::new(head.clone()))),
                ("head+mis", Box::new(SingleSample::new(OneSampleMis::new(head.clone(), brdf())))),
                ("mis2 of a head", Box::new(TwoSampleMis::new(head, brdf()))),
                ("ris:4 of a head", Box::new(ResampledEstimator::new(of_head))),
                ("ris:5", Box::new(ResampledEstimator::new(of_emitter))),
            ];
            let at = [point.at; TOGETHER];
            let of: Vec<usize> = (0..TOGETHER).collect();
            estimators.into_iter().filter_map(move |(name, estimator)| {
                // What a head alone does to a narrow lobe is another test's matter.
                if name == "head" && point.at.brdf.narrowest_lobe() < 0.3 {
                    return None;
                }
                let stream = |k: usize| Stream::new(8, Purpose::Test, k as u64);
                let mut streams: Vec<Stream> = (0..TOGETHER).map(stream).collect();
                let mut drawn = Vec::new();
                let one = || {
                    if drawn.is_empty() {
                        drawn = estimator.estimate_batch(&at, &Unshadowed, &mut Streams::new(&mut streams, &of));
                    }
                    f64::from(luminance(drawn.pop().expect("a batch has estimates").radiance))
                };
                let verdict = mean_is(point.truth, 20_000, one, tests);
                verdict.err().map(|reason| format!("{} / {name}, {}: {reason}", world.name, point.name))
            })
        })
        .collect();
    assert!(failures.is_empty(), "{} failed:\n{}", failures.len(), failures.join("\n"));
}
