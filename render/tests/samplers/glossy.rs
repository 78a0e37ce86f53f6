//! The same properties on glossy surfaces.

use headtail_render::{
    brdf::{Ggx, MAX_PARAMETERS, MetallicRoughness, Surface},
    environment::Environment,
    frame::Frame,
    image::Image,
    latlong,
    patches::{Detail, PatchSampler},
    tail::TailKind,
};

use super::*;

/// Index of the first network in [`BRDFS`].
pub(super) const MEASURED: u32 = BrdfTable::METALLIC_ROUGHNESS + 1;

/// A glossy shading point with its reflected light.
pub(super) struct Glossy {
    pub(super) name: &'static str,
    pub(super) at: ShadingPoint,
    /// Luminance reflected without shadows.
    pub(super) truth: f64,
    /// Width of the narrowest lobe.
    pub(super) width: f32,
}

impl Glossy {
    /// Returns every kind of surface under a light, at normals and views that differ between lights.
    fn points(world: &World, index: usize) -> Vec<Self> {
        let ggx = |alpha| Surface::from(Ggx::new(alpha, Vec3::ONE));
        // Grey, since the quadrature uses the luminance of the light.
        let color = Vec3::splat(0.6);
        let mixture = |metallic, roughness| Surface::from(MetallicRoughness::new(color, metallic, roughness));
        let measured = |k| Surface { brdf: MEASURED + k, parameters: [0.0; MAX_PARAMETERS] };
        let surfaces = [
            ("ggx 0.05", ggx(0.05), 0.8),
            ("ggx 0.2", ggx(0.2), 0.4),
            ("ggx 0.4", ggx(0.4), 0.7),
            ("ggx 0.4, grazing", ggx(0.4), 0.05),
            ("ggx 1", ggx(1.0), 0.5),
            ("rough dielectric", mixture(0.0, 0.8), 0.2),
            ("glossy mixture", mixture(0.5, 0.4), 0.6),
            ("measured, mirror-like", measured(0), 0.5),
            ("measured, matte", measured(1), 0.3),
        ];
        let normals = world.normals();
        surfaces
            .into_iter()
            .enumerate()
            .map(|(k, (name, surface, cos))| {
                // 5 and 3 are coprime to the 11 normals.
                let normal = normals[(5 * index + 3 * k) % normals.len()];
                let (sin, phi) = ((1.0_f32 - cos * cos).sqrt(), (7 * index + 2 * k) as f32);
                let wo = Frame::from_normal(normal.into()).to_world(Vec3::new(sin * phi.cos(), sin * phi.sin(), cos));
                let wo = wo.normalize().into();
                let at = ShadingPoint { p: Vec3A::ZERO, ng: normal, ns: normal, wo, surface };
                Self { name, at, truth: world.quadrature.reflected_at(&at), width: at.one_of(&BRDFS).lobe_width() }
            })
            .collect()
    }

    /// Returns whether the mean of 30,000 estimates is close enough to normally distributed for a t-test.
    pub(super) fn suits(&self, world: &World, case: &Case) -> bool {
        // Half of the light in 1e-5 of the sphere, or half of the weight in a lobe that is hit by chance.
        let sun_by_chance = case.name == "cosine" && world.name.starts_with("sunset");
        let lobe_by_chance = case.through_tail && case.name != "oracle" && self.width < 0.3;
        case.covers && !sun_by_chance && !lobe_by_chance
    }
}

pub(super) static POINTS: LazyLock<Vec<Vec<Glossy>>> =
    LazyLock::new(|| WORLDS.par_iter().enumerate().map(|(k, world)| Glossy::points(world, k)).collect());

/// Runs a check for every sampler of every world at every `step`-th of its points, with an offset that varies
/// between cases.
pub(super) fn for_all_cases<'a>(
    all: impl Iterator<Item = (&'a World, &'a [Glossy], &'a [Case])>,
    step: usize,
    check: impl Fn(&World, &Case, &Glossy, usize) -> Verdict + Sync,
) {
    let tasks: Vec<(&World, &Case, &Glossy)> = all
        .flat_map(|(world, points, cases)| cases.iter().map(move |case| (world, points, case)))
        .enumerate()
        .flat_map(|(k, (world, points, case))| {
            points.iter().skip(k % step).step_by(step).map(move |p| (world, case, p))
        })
        .collect();
    let failures: Vec<String> = tasks
        .par_iter()
        .filter_map(|(world, case, point)| {
            let through = if case.through_tail { "" } else { " (not through the tail alone)" };
            let verdict = check(world, case, point, tasks.len());
            verdict.err().map(|reason| format!("{} / {}{through}, {}: {reason}", world.name, case.name, point.name))
        })
        .collect();
    assert!(failures.is_empty(), "{} of {}:\n{}", failures.len(), tasks.len(), failures.join("\n"));
}

/// Runs a check as [`for_all_cases`] for the samplers and the glossy points of all worlds.
fn for_all_glossy(step: usize, check: impl Fn(&World, &Case, &Glossy, usize) -> Verdict + Sync) {
    let all = WORLDS.iter().zip(&*POINTS).map(|(world, points)| (world, &**points, &*world.cases));
    for_all_cases(all, step, check);
}

#[test]
fn glossy_directions_are_drawn_with_the_claimed_density() {
    for_all_glossy(3, |world, case, point, tests| {
        // Densities of the others do not depend on the BRDF; the quadrature of this test is for wide lobes.
        let is_patches = case.name.contains("patches");
        let glossy = is_patches || matches!(case.name, "oracle" | "cosine" | "mis");
        if !glossy || point.width < 0.1 {
            return Ok(());
        }
        // Patches end at edges of lamps: three points across miss all draws, up to 2.5e-3, in a cell beside a
        // softbox.
        let probes = match (&*world.name, case.name) {
            ("sunset / row-column", _) | ("window / row-column", "oracle") => 12,
            _ if is_patches => 8,
            _ => 3,
        };
        let dense = case.through_tail.then_some(&world.dense);
        draws_follow_pdf(&AtPoint::of_table(&*case.sampler, &point.at, &BRDFS), dense, probes, tests)
    });
}

#[test]
fn the_pdf_of_a_glossy_direction_equals_the_returned_pdf() {
    for_all_glossy(5, |_, case, point, _| {
        pdf_of_samples_agrees(&AtPoint::of_table(&*case.sampler, &point.at, &BRDFS), 2_000)
    });
}

#[test]
fn samplers_cover_all_light_that_glossy_surfaces_reflect() {
    for_all_glossy(7, |world, case, point, _| {
        if case.covers { pdf_covers(&AtPoint::of_table(&*case.sampler, &point.at, &BRDFS), world) } else { Ok(()) }
    });
}

#[test]
fn all_samplers_estimate_the_same_glossy_light() {
    for_all_glossy(3, |world, case, point, tests| {
        if !point.suits(world, case) {
            return Ok(());
        }
        mean_of_sampler(&AtPoint::of_table(&*case.sampler, &point.at, &BRDFS), world, point.truth, 30_000, tests)
    });
}

#[test]
fn resampling_and_two_sample_mis_estimate_the_same_glossy_light() {
    let tasks: Vec<_> =
        WORLDS.iter().zip(&*POINTS).flat_map(|(world, points)| points.iter().map(move |p| (world, p))).collect();
    let failures: Vec<String> = tasks
        .par_iter()
        .flat_map_iter(|(world, point)| {
            let emitter = || EmitterSampler::new(world.light.clone());
            let estimators = [
                ("ris:4", ris(emitter(), 4, world)),
                ("ris:16", ris(emitter(), 16, world)),
                ("mis2", mis2(emitter(), world)),
            ];
            let tests = 3 * tasks.len();
            estimators.into_iter().filter_map(move |(name, estimator)| {
                let verdict = mean_is(point.truth, &estimates(&*estimator, &point.at, 20_000, 8), tests);
                verdict.err().map(|reason| format!("{} / {name}, {}: {reason}", world.name, point.name))
            })
        })
        .collect();
    assert!(failures.is_empty(), "{} failed:\n{}", failures.len(), failures.join("\n"));
}

#[test]
fn the_oracle_of_a_glossy_surface_has_lower_variance_than_mis() {
    let tasks: Vec<_> = WORLDS
        .iter()
        .zip(&*POINTS)
        .flat_map(|(world, points)| points.iter().map(move |point| (world, point)))
        // Lobes much narrower than a dim cell of Y are covered, but not resolved.
        .filter(|(_, point)| point.width > 0.1)
        .collect();
    let failures: Vec<String> = tasks
        .par_iter()
        .filter_map(|(world, point)| {
            let variance = |name| {
                let case = world.cases.iter().find(|case| case.name == name).unwrap();
                let bound = AtPoint::of_table(&*case.sampler, &point.at, &BRDFS);
                let values = estimates_of_sampler(&bound, world, 8, 3_000);
                Moments::of(&values).unwrap().variance / point.truth.powi(2)
            };
            let (oracle, mis) = (variance("oracle"), variance("mis"));
            // Under one white texel, Y has no structure; elsewhere the variance of the oracle is 10 % of that
            // of MIS.
            let most = if world.name.starts_with("1x1") { mis } else { 0.2 * mis };
            (oracle > most).then(|| format!("{} / {}: {oracle:.4} and {mis:.4}", world.name, point.name))
        })
        .collect();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn patches_rarely_select_brdf_sampling_where_a_lobe_contains_a_lamp() {
    // A uniform sky with a lamp of 11 degrees that is 1000 times as bright.
    let (width, height) = (64, 32);
    let is_lamp = |k: usize| (20..22).contains(&(k % width)) && (9..11).contains(&(k / width));
    let pixels = (0..width * height).map(|k| [if is_lamp(k) { 1000.0 } else { 1.0 }; 3]).collect();
    let map = Environment::from_image("lamp", Image { width, height, pixels }).unwrap();
    let light = EnvironmentLight::new(Arc::new(map), TailKind::Hierarchical).unwrap();
    let patches = PatchSampler::new(light, Detail::Leaves).unwrap();
    let lamp = latlong::direction(Vec2::new(20.5 / width as f32, 9.5 / (height - 1) as f32));
    // Viewed along the normal, so that the lobe is centred on it.
    let mixture_weight = |n: Vec3A| {
        let surface = Ggx::new(0.1, Vec3::ONE).into();
        AtPoint::new(&patches, &ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo: n, surface }).mixture_weight()
    };
    let beside = (lamp + 0.3 * lamp.any_orthonormal_vector()).normalize();
    assert!((mixture_weight(beside) - 0.98).abs() < 1e-4, "{}", mixture_weight(beside));
    // The lamp is below the horizon: BRDF sampling has the mixture weight for its width, 0.5 / 2^1.25.
    assert!((mixture_weight(-lamp) - 0.7898).abs() < 1e-3, "{}", mixture_weight(-lamp));
}
