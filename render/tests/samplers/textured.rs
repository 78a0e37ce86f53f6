//! The same properties on neural materials, with heads conditioned on the features at the point.

use std::f32::consts::TAU;

use glam::Vec2;
use headtail_render::{
    brdf::{NeuralTexture, Surface, neural_texture::Seen},
    frame::Frame,
    patches::{Detail, PatchSampler},
};

use super::{
    conditioned::product,
    glossy::{Glossy, MEASURED, for_all_cases},
    *,
};

/// Two of the project's fabrics, the roughest and a glossy one.
pub static FABRICS: LazyLock<[Arc<NeuralTexture>; 2]> = LazyLock::new(|| {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../checkpoints");
    let read = |name: &str| NeuralTexture::read(format!("{folder}/{name}.safetensors").as_ref());
    ["welt", "satin"].map(|name| Arc::new(read(name).unwrap()))
});
/// Index of the first fabric in [`BRDFS`].
const FIRST: u32 = MEASURED + 2;
/// Points of each fabric in every world.
const EACH: usize = 3;

/// Returns shading points of both fabrics under a light, with different positions, tangents, handedness and
/// views.
fn points(world: &World, index: usize) -> Vec<Glossy> {
    let normals = world.normals();
    let mut random = Stream::new(index as u64, Purpose::Test, 21);
    let mut point = |k: usize| {
        let (fabric, n) = (k % FABRICS.len(), normals[(3 * index + 5 * k) % normals.len()]);
        let frame = Frame::from_normal(n.into());
        let (cos_wo, phi) = (0.2 + 0.75 * random.uniform(), TAU * random.uniform());
        let sin_wo = (1.0 - cos_wo * cos_wo).sqrt();
        let wo = frame.to_world(Vec3::new(sin_wo * phi.cos(), sin_wo * phi.sin(), cos_wo)).normalize();
        let (sin, cos) = (TAU * random.uniform()).sin_cos();
        let hand = if k.is_multiple_of(3) { -1.0 } else { 1.0 };
        let tangent = cos * frame.s + sin * frame.t;
        let local = Vec3::new(tangent.dot(wo), (hand * Vec3::from(n).cross(tangent)).dot(wo), cos_wo);
        let uv = Vec2::new(random.uniform(), random.uniform());
        let seen = Seen { uv, width: 0.02, wo: local, tangent: [cos, sin, hand] };
        let surface = Surface { brdf: FIRST + fabric as u32, parameters: FABRICS[fabric].parameters(&seen) };
        let at = ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo: wo.into(), surface };
        let truth = world.quadrature.reflected_at(&at);
        Glossy { name: ["welt", "satin"][fabric], at, truth, width: at.one_of(&BRDFS).lobe_width() }
    };
    (0..EACH * FABRICS.len()).map(&mut point).collect()
}

/// Returns samplers conditioned on the features, and samplers that use only the lobes.
fn cases(world: &World) -> Vec<Case> {
    let head = |mode| random_head_of(Condition::Texture, mode, 4, &[16, 12], &[16, 1]);
    let (coupled, autoregressive) = (product(world, &head(Mode::Coupled)), product(world, &head(Mode::Autoregressive)));
    let mut cases = Vec::new();
    let mut add = |name, sampler: Box<dyn Sampler>, through_tail| {
        cases.push(Case { name, sampler, covers: true, through_tail });
    };
    add("brdf", Box::new(BrdfSampler), false);
    add("head", Box::new(coupled.clone()), true);
    add("autoregressive head", Box::new(autoregressive), true);
    add("head+mis", Box::new(OneSampleMis::new(coupled, BrdfSampler)), false);
    if world.name.ends_with("hierarchical") {
        let over = || PatchSampler::with_head(world.light.clone(), Detail::Leaves, head(Mode::Coupled)).unwrap();
        let patches = || PatchSampler::new(world.light.clone(), Detail::Leaves).unwrap();
        add("patches", Box::new(patches()), true);
        add("patches and brdf", Box::new(OneSampleMis::new(patches(), BrdfSampler)), false);
        add("head over patches", Box::new(over()), true);
        add("head over patches, and brdf", Box::new(OneSampleMis::new(over(), BrdfSampler)), false);
        add("weighted patches", Box::new(Weighted::new(patches())), true);
        add("head over weighted patches", Box::new(Weighted::new(over())), true);
    }
    cases
}

/// Runs a check for every sampler of every world at every `step`-th point.
fn for_all_fabrics(step: usize, check: impl Fn(&World, &Case, &Glossy, usize) -> Verdict + Sync) {
    let all: Vec<(&World, Vec<Glossy>, Vec<Case>)> =
        WORLDS.par_iter().enumerate().map(|(k, world)| (world, points(world, k), cases(world))).collect();
    for_all_cases(all.iter().map(|(world, points, cases)| (*world, &**points, &**cases)), step, check);
}

#[test]
fn directions_on_fabrics_are_drawn_with_the_claimed_density() {
    for_all_fabrics(5, |world, case, point, tests| {
        let probes = if world.name == "sunset / row-column" { 12 } else { 4 };
        let dense = case.through_tail.then_some(&world.dense);
        draws_follow_pdf(&AtPoint::of_table(&*case.sampler, &point.at, &BRDFS), dense, probes, tests)
    });
}

#[test]
fn the_pdf_of_a_direction_on_a_fabric_equals_the_returned_pdf() {
    for_all_fabrics(3, |_, case, point, _| {
        pdf_of_samples_agrees(&AtPoint::of_table(&*case.sampler, &point.at, &BRDFS), 2_000)
    });
}

#[test]
fn samplers_cover_all_light_that_fabrics_reflect() {
    for_all_fabrics(3, |world, case, point, _| {
        pdf_covers(&AtPoint::of_table(&*case.sampler, &point.at, &BRDFS), world)
    });
}

#[test]
fn all_samplers_estimate_the_same_light_on_fabrics() {
    for_all_fabrics(3, |world, case, point, tests| {
        // Half of the light in 1e-5 of the sphere.
        if case.name == "brdf" && world.name.starts_with("sunset") {
            return Ok(());
        }
        mean_of_sampler(&AtPoint::of_table(&*case.sampler, &point.at, &BRDFS), world, point.truth, 30_000, tests)
    });
}

/// A head that ignores the position would pass all of the above.
#[test]
fn heads_depend_on_the_position_on_a_fabric() {
    let world = &WORLDS[0];
    let head = product(world, &random_head_of(Condition::Texture, Mode::Coupled, 4, &[], &[]));
    let [first, second] = [0.1, 0.6].map(|x| {
        let mut point = points(world, 0).swap_remove(0).at;
        let seen = Seen { uv: Vec2::splat(x), width: 0.0, wo: Vec3::Z, tangent: [1.0, 0.0, 1.0] };
        point.surface.parameters = FABRICS[0].parameters(&seen);
        AtPoint::of_table(&head, &point, &BRDFS).sample_many(&[Vec2::splat(0.3)])[0].unwrap().wi
    });
    assert!(first.distance(second) > 1e-4, "{first} {second}");
}
