//! Uses an exported sampler: `cargo run --release -p headtail-render --example exported_sampler -- FILE MAP`.
use glam::{Vec3, Vec3A};
use headtail_render::{Arena, Environment, ExportedSampler, Lambert, ShadingPoint, Tile, points::*, sampler::*};
use std::{error::Error, path::Path, sync::Arc};

/// Estimates the unshadowed light that a white diffuse surface reflects.
pub fn reflected(file: &Path, map: &str) -> Result<Vec3A, Box<dyn Error>> {
    let environment = Arc::new(Environment::open(map)?);
    let sampler = ExportedSampler::read(file)?.open(&environment)?;
    let surface = Lambert { albedo: Vec3::ONE }.into();
    let at = ShadingPoint { p: Vec3A::ZERO, ng: Vec3A::Y, ns: Vec3A::Y, wo: Vec3A::Y, surface };
    let (tile, arena) = (Tile::of(&[at; 256]), Arena::default()); // your shading points, here copies of one
    let (rows, mut sum) = (tile.rows(), Vec3A::ZERO);
    let mut columns = arena.columns::<9>(rows.strips()); // kept for the next tile
    for sample in 0..16 {
        let [u, v, x, y, z, pdf, red, green, blue] = columns.get_mut();
        Points::new(PointSet::Sobol, 0).at_sample(sample).draw(Dimension::Light(0), &rows, [&mut *u, &mut *v]); // or numbers of your own
        prepared(&sampler, &rows, &arena, |state| {
            let out = Draws { wi: [&mut *x, &mut *y, &mut *z], pdf: &mut *pdf };
            sampler.sample(&rows, state, [u, v], out, &arena);
        });
        rows.brdf_cosine([x, y, z], [&mut *red, &mut *green, &mut *blue], &arena);
        let columns = [&*x, y, z, pdf, red, green, blue].map(<[_]>::as_flattened);
        for place in 0..rows.len() {
            let [x, y, z, pdf, red, green, blue] = columns.map(|column| column[place]);
            if pdf > 0.0 {
                let radiance = environment.radiance(Vec3A::new(x, y, z)); // times the visibility of this direction
                sum += Vec3A::new(red, green, blue) * radiance / pdf;
            }
        }
    }
    Ok(sum / (16.0 * 256.0))
}

fn main() -> Result<(), Box<dyn Error>> {
    let [file, map] = std::env::args().skip(1).collect::<Vec<_>>().try_into().map_err(|_| "usage: FILE MAP")?;
    println!("reflected radiance {:.4}", reflected(Path::new(&file), &map)?);
    Ok(())
}
