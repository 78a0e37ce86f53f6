//! temporary
use headtail_render::{environment::Environment, integrator::*, points::*, scene::*, spec::SamplerSpec};
use std::sync::{Arc, atomic::AtomicBool};
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let f = "/work/shared/data/nbrdf/nbrdf_all.f32";
    for env in args[2].split(',') {
        let environment = Arc::new(Environment::open(&format!("/work/shared/data/envmaps/{env}_1k.hdr")).unwrap());
        for m in args[3].split(';') {
            let scene = Scene::built_in(&args[1]).unwrap();
            let b = scene.bounds();
            let camera = scene.camera();
            let scene = format!("nbrdf:{f}#{m}").parse::<MaterialSpec>().unwrap().dress(scene, &b).unwrap();
            print!("{env} {}: ", &m[..m.len().min(30)]);
            let mut base = 0.0;
            for s in ["mis", "ris:4", "patches"] {
                let est = s.parse::<SamplerSpec>().unwrap().build(&environment).unwrap();
                let (w, h) = (96, 72);
                let img = |seed| {
                    let view = View {
                        scene: &scene,
                        camera: &camera,
                        environment: &environment,
                        width: w,
                        height: h,
                        unshadowed: true,
                        depth: 1,
                    };
                    render(
                        view,
                        &*est,
                        Budget::Spp(16),
                        Points::new(PointSet::Sobol, seed),
                        &AtomicBool::new(false),
                        &|_| {},
                    )
                    .surfaces
                };
                let images: Vec<_> = (0..6).map(|k| img(k)).collect();
                let mut mse = 0.0;
                for i in 0..w * h {
                    for c in 0..3 {
                        let v: Vec<f64> = images.iter().map(|im| f64::from(im.pixels[i][c])).collect();
                        let mean = v.iter().sum::<f64>() / 6.0;
                        mse += v.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / 5.0;
                    }
                }
                if s == "mis" {
                    base = mse;
                }
                print!("{s} {:.2} | ", base / mse);
            }
            println!();
        }
    }
}
