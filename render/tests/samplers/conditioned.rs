//! The same properties of heads that know the view direction and the width of the lobe, alone and beside BRDF sampling.

use super::{
    glossy::{Glossy, POINTS},
    *,
};

/// Heads with random weights, and with a random selection network.
pub static HEADS: LazyLock<[(&str, Head); 4]> = LazyLock::new(|| {
    let head = |condition, mode, bins, encoder: &[usize]| random_head_of(condition, mode, bins, encoder, &[16, 1]);
    [
        ("ggx, coupled", head(Condition::Ggx, Mode::Coupled, 8, &[16, 12])),
        ("ggx, autoregressive", head(Condition::Ggx, Mode::Autoregressive, 4, &[])),
        ("ggx-roughness, coupled", head(Condition::GgxRoughness, Mode::Coupled, 4, &[])),
        ("ggx-roughness, autoregressive", head(Condition::GgxRoughness, Mode::Autoregressive, 8, &[16, 12])),
    ]
});

/// A head under a light.
pub fn product(world: &World, head: &Head) -> ProductSampler<Head> {
    ProductSampler::new(world.light.clone(), head.clone())
}

/// The share of samples that a head asks for at a shading point.
fn share(head: &ProductSampler<Head>, at: &ShadingPoint) -> f32 {
    head.share_beside_brdf(&head.prepare(at))
}

/// `head` and `head+mis` of every head under a light.
fn cases(world: &World) -> Vec<Case> {
    let both = |(name, head): &(&'static str, Head)| {
        let mixture = OneSampleMis::new(product(world, head), BrdfSampler::new(world.environment().clone()));
        let case = |subject, through_tail| Case { name, subject, covers: true, through_tail };
        [case(Box::new(product(world, head)) as Box<dyn Subject>, true), case(Box::new(mixture), false)]
    };
    HEADS.iter().flat_map(both).collect()
}

/// Runs a check for both samplers of every head in every world at one of `step` glossy points: which ones changes from case to
/// case.
fn for_all_heads(step: usize, check: impl Fn(&World, &Case, &Glossy, usize) -> Verdict + Sync) {
    let cases: Vec<Vec<Case>> = WORLDS.iter().map(cases).collect();
    let tasks: Vec<(&World, &Case, &Glossy)> = WORLDS
        .iter()
        .zip(&*POINTS)
        .zip(&cases)
        .flat_map(|((world, points), cases)| cases.iter().map(move |case| (world, points, case)))
        .enumerate()
        .flat_map(|(k, (world, points, case))| {
            points.iter().skip(k % step).step_by(step).map(move |p| (world, case, p))
        })
        .collect();
    let failures: Vec<String> = tasks
        .par_iter()
        .filter_map(|(world, case, point)| {
            let form = if case.through_tail { "head" } else { "head+mis" };
            let verdict = check(world, case, point, tasks.len());
            verdict.err().map(|reason| format!("{} / {form} {}, {}: {reason}", world.name, case.name, point.name))
        })
        .collect();
    assert!(failures.is_empty(), "{} of {}:\n{}", failures.len(), tasks.len(), failures.join("\n"));
}

#[test]
fn their_directions_are_drawn_with_the_claimed_density() {
    for_all_heads(5, |world, case, point, tests| {
        // The quadrature of this test is made for wide lobes.
        if !case.through_tail && point.at.brdf.narrowest_lobe() < 0.1 {
            return Ok(());
        }
        let probes = if world.name == "sunset / row-column" { 12 } else { 3 };
        let dense = case.through_tail.then_some(&world.dense);
        draws_follow_pdf(&case.subject.bind(&point.at), dense, probes, tests)
    });
}

#[test]
fn the_pdf_of_their_samples_is_the_samples_pdf() {
    for_all_heads(3, |_, case, point, _| pdf_of_samples_agrees(&case.subject.bind(&point.at), 2_000));
}

#[test]
fn they_draw_whatever_is_reflected() {
    for_all_heads(5, |world, case, point, _| pdf_covers(&case.subject.bind(&point.at), &point.at, world));
}

#[test]
fn they_estimate_the_same_light() {
    for_all_heads(2, |world, case, point, tests| {
        if !point.suits(world, case) {
            return Ok(());
        }
        mean_of_sampler(&case.subject.bind(&point.at), &point.at, point.truth, 30_000, tests)
    });
}

#[test]
fn resampling_of_their_directions_estimates_it_too() {
    let tasks: Vec<_> = WORLDS
        .iter()
        .zip(&*POINTS)
        .flat_map(|(world, points)| points.iter().map(move |point| (world, point)))
        .enumerate()
        .flat_map(|(k, (world, point))| [k, k + 1].map(|k| (world, point, &HEADS[k % HEADS.len()])))
        .collect();
    let failures: Vec<String> = tasks
        .par_iter()
        .filter_map(|(world, point, (name, head))| {
            let brdf = BrdfSampler::new(world.environment().clone());
            let estimator = ResampledEstimator::new(Resampled::new(product(world, head), brdf, 4).unwrap());
            let mut random = Stream::new(8, Purpose::Test, 5);
            let one = || f64::from(luminance(estimator.estimate(&point.at, &Unshadowed, &mut random).radiance));
            let verdict = mean_is(point.truth, 20_000, one, tasks.len());
            verdict.err().map(|reason| format!("{} / ris:4 of {name}, {}: {reason}", world.name, point.name))
        })
        .collect();
    assert!(failures.is_empty(), "{} failed:\n{}", failures.len(), failures.join("\n"));
}

/// The learned share is what decides how often the head is drawn from: with shares near 0 and 1 directions come from one side.
#[test]
fn the_mixture_draws_as_often_from_the_head_as_it_asks() {
    let world = &WORLDS[0];
    let shares: Vec<f32> = POINTS[0]
        .iter()
        .flat_map(|point| HEADS.iter().map(|(_, head)| share(&product(world, head), &point.at)))
        .collect();
    let (least, most) = shares.iter().fold((1.0_f32, 0.0_f32), |(a, b), &share| (a.min(share), b.max(share)));
    assert!(least < 0.45 && most > 0.55, "{shares:?}: the selection networks say nothing");

    for (point, (name, head)) in POINTS[0].iter().zip(HEADS.iter().cycle()) {
        let (head, brdf) = (product(world, head), BrdfSampler::new(world.environment().clone()));
        let share = share(&head, &point.at);
        let mixture = OneSampleMis::new(head.clone(), brdf.clone());
        let (prepared, alone) = (mixture.prepare(&point.at), head.prepare(&point.at));
        let mut random = Stream::new(10, Purpose::Test, 0);
        for _ in 0..1000 {
            let u = random.uniform2();
            let (Some(sample), below) = (mixture.sample(&prepared, &point.at, u), u.x < share) else { continue };
            let v = if below { u.x / share } else { (u.x - share) / (1.0 - share) };
            let own = Vec2::new(v.min(1.0 - f32::EPSILON / 2.0), u.y);
            let expected = if below { head.sample(&alone, &point.at, own) } else { brdf.sample(&(), &point.at, own) };
            let expected = expected.expect("the mixture has a sample");
            assert_eq!(sample.wi, expected.wi, "{name}, {}", point.name);
            let wi = sample.wi;
            let (of_head, of_brdf) = (head.pdf(&alone, &point.at, wi), brdf.pdf(&(), &point.at, wi));
            let mixed = share * of_head + (1.0 - share) * of_brdf;
            assert!((sample.pdf / mixed - 1.0).abs() < 1e-2, "{name}, {}: {} {mixed}", point.name, sample.pdf);
        }
    }
}
