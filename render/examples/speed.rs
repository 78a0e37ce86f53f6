//! scratch
use std::{hint::black_box, sync::Arc};
use glam::{Vec2, Vec3A};
use headtail_render::{bake::*, brdf::*, environment::Environment, random::*, sampler::*, tail::*};
fn at(normal: Vec3A) -> ShadingPoint {
    let brdf = Brdf::Lambert(Lambert { albedo: Vec3A::ONE });
    ShadingPoint { p: Vec3A::ZERO, ng: normal, ns: normal, wo: normal, brdf }
}
fn time<S: DirectionSampler>(s: &S, points: &[ShadingPoint]) -> f64 {
    let start = cpu();
    let mut state = 1_u64;
    for k in 0..500_000 {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        let u = Vec2::new((state >> 40) as f32, (state >> 16 & 0xffffff) as f32) / 16777216.0;
        let at = &points[k % points.len()];
        let p = s.prepare(at);
        black_box(s.sample(&p, at, u));
    }
    (cpu() - start) / 500_000.0
}
fn cpu() -> f64 { std::fs::read_to_string("/proc/thread-self/schedstat").unwrap().split(' ').next().unwrap().parse().unwrap() }
fn main() {
    for name in std::env::args().skip(1) {
        let env = Arc::new(Environment::open(&name).unwrap());
        let mut r = Stream::new(1, Purpose::Test, 0);
        let random: Vec<_> = (0..2048).map(|_| at(r.direction())).collect();
        let d = r.direction();
        let coherent: Vec<_> = (0..2048).map(|_| at((d + 0.1 * r.direction()).normalize())).collect();
        for kind in [TailKind::Hierarchical, TailKind::RowColumn] {
            let light = EnvironmentLight::new(env.clone(), kind).unwrap();
            let emitter = EmitterSampler::new(light.clone());
            let cosine = BrdfSampler::new(env.clone());
            let mis = OneSampleMis::new(emitter.clone(), cosine.clone());
            let table = |c| ProductSampler::new(light.clone(), direct_bake(light.tail(), NormalGrid::new(16, 32).unwrap(), CellGrid::new(c, c).unwrap()).unwrap());
            let (t8, t32, t64) = (table(8), table(32), table(64));
            for (what, points) in [("random", &random), ("coherent", &coherent)] {
                let mut best = [f64::MAX; 6];
                for _ in 0..15 {
                    for (b, t) in best.iter_mut().zip([time(&emitter, points), time(&cosine, points), time(&mis, points), time(&t8, points), time(&t32, points), time(&t64, points)]) {
                        *b = b.min(t);
                    }
                }
                println!("{:20} {:12} {what:9} emitter {:.0} cosine {:.0} mis {:.0} 8x8 {:.0} 32x32 {:.0} 64x64 {:.0} ns; ratio {:.2}", env.name(), kind.name(), best[0], best[1], best[2], best[3], best[4], best[5], best[4] / best[0]);
            }
        }
    }
}
