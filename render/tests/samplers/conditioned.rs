//! The same properties for heads conditioned on the view direction and the lobe width, alone and in MIS with
//! BRDF sampling.

use headtail_render::estimator::SingleSample;

use super::{
    glossy::{Glossy, POINTS, for_all_cases},
    *,
};

/// Heads with random weights and random selection networks.
pub static HEADS: LazyLock<[(&str, Head); 5]> = LazyLock::new(|| {
    let head = |condition, mode, bins, encoder: &[usize]| random_head_of(condition, mode, bins, encoder, &[16, 1]);
    [
        ("ggx, coupled", head(Condition::Ggx, Mode::Coupled, 8, &[16, 12])),
        ("ggx, autoregressive", head(Condition::Ggx, Mode::Autoregressive, 4, &[])),
        ("ggx-roughness, coupled", head(Condition::GgxRoughness, Mode::Coupled, 4, &[])),
        ("ggx-roughness, autoregressive", head(Condition::GgxRoughness, Mode::Autoregressive, 8, &[16, 12])),
        ("family, coupled", head(Condition::Family, Mode::Coupled, 4, &[16, 12])),
    ]
});

/// Returns the product sampler of a head and a light.
pub fn product(world: &World, head: &Head) -> ProductSampler<Head> {
    ProductSampler::new(world.light.clone(), head.clone())
}

/// Returns `head` and `head+mis` for every head under a light.
fn cases(world: &World) -> Vec<Case> {
    let both = |(name, head): &(&'static str, Head)| {
        let mixture = OneSampleMis::new(product(world, head), BrdfSampler);
        let case = |sampler, through_tail| Case { name, sampler, covers: true, through_tail };
        [case(Box::new(product(world, head)) as Box<dyn Sampler>, true), case(Box::new(mixture), false)]
    };
    HEADS.iter().flat_map(both).collect()
}

/// Runs a check for both samplers of every head in every world at every `step`-th glossy point.
fn for_all_heads(step: usize, check: impl Fn(&World, &Case, &Glossy, usize) -> Verdict + Sync) {
    let cases: Vec<Vec<Case>> = WORLDS.iter().map(cases).collect();
    let all = WORLDS.iter().zip(&*POINTS).zip(&cases).map(|((world, points), cases)| (world, &**points, &**cases));
    for_all_cases(all, step, check);
}

#[test]
fn directions_of_heads_are_drawn_with_the_claimed_density() {
    for_all_heads(5, |world, case, point, tests| {
        // The quadrature of this test is for wide lobes.
        if !case.through_tail && point.width < 0.1 {
            return Ok(());
        }
        let probes = if world.name == "sunset / row-column" { 12 } else { 3 };
        let dense = case.through_tail.then_some(&world.dense);
        draws_follow_pdf(&AtPoint::of_table(&*case.sampler, &point.at, &BRDFS), dense, probes, tests)
    });
}

#[test]
fn the_pdf_of_a_direction_of_a_head_equals_the_returned_pdf() {
    for_all_heads(3, |_, case, point, _| {
        pdf_of_samples_agrees(&AtPoint::of_table(&*case.sampler, &point.at, &BRDFS), 2_000)
    });
}

#[test]
fn heads_cover_all_reflected_light() {
    for_all_heads(5, |world, case, point, _| pdf_covers(&AtPoint::of_table(&*case.sampler, &point.at, &BRDFS), world));
}

#[test]
fn heads_estimate_the_same_light() {
    for_all_heads(2, |world, case, point, tests| {
        if !point.suits(world, case) {
            return Ok(());
        }
        mean_of_sampler(&AtPoint::of_table(&*case.sampler, &point.at, &BRDFS), world, point.truth, 30_000, tests)
    });
}

#[test]
fn multi_sample_estimators_of_heads_estimate_the_same_light() {
    let tasks: Vec<_> = WORLDS
        .iter()
        .zip(&*POINTS)
        .flat_map(|(world, points)| points.iter().map(move |point| (world, point)))
        .enumerate()
        .flat_map(|(k, (world, point))| [k, k + 1].map(|k| (world, point, &HEADS[k % HEADS.len()])))
        .collect();
    let tests = 5 * tasks.len();
    let failures: Vec<String> = tasks
        .par_iter()
        .flat_map_iter(|(world, point, (head_name, head))| {
            let single = |sampler: Arc<dyn Sampler>| -> Box<dyn Estimator> {
                Box::new(SingleSample::new(Covering::new(sampler).unwrap(), world.environment().clone()))
            };
            let head = || product(world, head);
            let estimators: [(&str, Box<dyn Estimator>); 5] = [
                ("head", single(Arc::new(head()))),
                ("head+mis", single(Arc::new(OneSampleMis::new(head(), BrdfSampler)))),
                ("mis2", mis2(head(), world)),
                ("ris:4", ris(head(), 4, world)),
                ("ris:5 of emitters", ris(EmitterSampler::new(world.light.clone()), 5, world)),
            ];
            estimators.into_iter().filter_map(move |(name, estimator)| {
                // Heads alone on narrow lobes are excluded here.
                if name == "head" && point.width < 0.3 {
                    return None;
                }
                let verdict = mean_is(point.truth, &estimates(&*estimator, &point.at, 20_000, 8), tests);
                verdict.err().map(|reason| format!("{} / {name} of {head_name}, {}: {reason}", world.name, point.name))
            })
        })
        .collect();
    assert!(failures.is_empty(), "{} failed:\n{}", failures.len(), failures.join("\n"));
}

/// The learned mixture weight decides how often the head is sampled; near 0 and 1, directions come
/// from one sampler.
#[test]
fn the_mixture_samples_the_head_with_its_mixture_weight() {
    let world = &WORLDS[0];
    let mixture_weight =
        |head: &Head, at: &ShadingPoint| AtPoint::of_table(&product(world, head), at, &BRDFS).mixture_weight();
    let mixture_weights: Vec<f32> =
        POINTS[0].iter().flat_map(|point| HEADS.iter().map(|(_, head)| mixture_weight(head, &point.at))).collect();
    let (least, most) =
        mixture_weights.iter().fold((1.0_f32, 0.0_f32), |(a, b), &weight| (a.min(weight), b.max(weight)));
    assert!(least < 0.45 && most > 0.55, "{mixture_weights:?}: the mixture weight networks have no effect");

    for (point, (name, head)) in POINTS[0].iter().zip(HEADS.iter().cycle()) {
        let (head, weight) = (product(world, head), mixture_weight(head, &point.at));
        let mixture = OneSampleMis::new(head.clone(), BrdfSampler);
        let [mixture, of_head, of_brdf] = [&mixture as &dyn Sampler, &head, &BrdfSampler]
            .map(|sampler| AtPoint::of_table(sampler, &point.at, &BRDFS));
        let u = uniforms(&mut Stream::new(10, Purpose::Test, 0), 1000);
        // The first number, rescaled for the selected sampler.
        let own = |u: &Vec2| {
            let v = if u.x < weight { u.x / weight } else { (u.x - weight) / (1.0 - weight) };
            Vec2::new(v.min(1.0 - f32::EPSILON / 2.0), u.y)
        };
        let own: Vec<Vec2> = u.iter().map(own).collect();
        let (by_head, by_brdf) = (of_head.sample_many(&own), of_brdf.sample_many(&own));
        let drawn = mixture.sample_many(&u);
        let wi: Vec<Vec3A> = drawn.iter().map(|sample| sample.map_or(Vec3A::Z, |sample| sample.wi)).collect();
        let (head_pdfs, brdf_pdfs) = (of_head.pdf_many(&wi), of_brdf.pdf_many(&wi));
        for (k, sample) in drawn.iter().enumerate() {
            let Some(sample) = sample else { continue };
            let expected = if u[k].x < weight { by_head[k] } else { by_brdf[k] };
            assert_eq!(sample.wi, expected.expect("the mixture has a sample").wi, "{name}, {}", point.name);
            let mixed = weight * head_pdfs[k] + (1.0 - weight) * brdf_pdfs[k];
            assert!((sample.pdf / mixed - 1.0).abs() < 1e-2, "{name}, {}: {} {mixed}", point.name, sample.pdf);
        }
    }
}
