//! Cosine-weighted directions for every material, a baseline of the paper.

use glam::{Vec2, Vec3};
use headtail_render::{
    brdf::{Kernel as _, Lambert},
    columns::Arena,
    sampler::{Coverage, Draws, Sampler},
    simd::{LANES, Lanes},
    tile::Rows,
};

/// Samples every surface as a diffuse one; `brdf` samples the material's own lobes.
pub struct CosineWeighted;

const DIFFUSE: Lambert = Lambert { albedo: Vec3::ONE };

/// Calls `f` with strip, lane and normal of each lane.
fn for_each(at: &Rows<'_>, mut f: impl FnMut(usize, usize, Vec3)) {
    for strip in 0..at.strips() {
        let [x, y, z] = at.normals(strip);
        (0..LANES).for_each(|lane| f(strip, lane, Vec3::new(x[lane], y[lane], z[lane])));
    }
}

impl Sampler for CosineWeighted {
    fn sample(&self, at: &Rows<'_>, _state: &[Lanes], u: [&[Lanes]; 2], out: Draws<'_>, _arena: &Arena) {
        let [x, y, z] = out.wi;
        for_each(at, |strip, lane, n| {
            let (wi, pdf) = DIFFUSE.sample(n, n, Vec2::new(u[0][strip][lane], u[1][strip][lane]));
            (x[strip][lane], y[strip][lane], z[strip][lane]) = wi.into();
            out.pdf[strip][lane] = pdf;
        });
    }

    fn pdf(&self, at: &Rows<'_>, _state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], _arena: &Arena) {
        for_each(at, |strip, lane, n| {
            out[strip][lane] = DIFFUSE.pdf(n, n, Vec3::from_array(wi.map(|column| column[strip][lane])));
        });
    }

    fn coverage(&self) -> Coverage {
        Coverage::Everything
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3A;
    use headtail_render::{
        brdf::Ggx,
        random::{Purpose, Stream},
        sampler::{AtPoint, BrdfSampler},
        tile::ShadingPoint,
    };

    use super::*;

    /// Equals BRDF sampling on a diffuse surface and stays cosine-weighted on others.
    #[test]
    fn every_surface_is_sampled_as_a_diffuse_one() {
        let n = Vec3A::new(0.3, 0.8, -0.4).normalize();
        let diffuse = ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo: n, surface: DIFFUSE.into() };
        let glossy = ShadingPoint { surface: Ggx::new(0.1, Vec3::ONE).into(), ..diffuse };
        let expected = AtPoint::new(&BrdfSampler, &diffuse);
        let mut random = Stream::new(1, Purpose::Test, 0);
        let u: Vec<Vec2> = (0..50).map(|_| random.uniform2()).collect();
        let wi: Vec<Vec3A> = (0..50).map(|_| random.direction()).collect();
        for point in [diffuse, glossy] {
            let own = AtPoint::new(&CosineWeighted, &point);
            for (a, b) in own.sample_many(&u).into_iter().zip(expected.sample_many(&u)) {
                let (a, b) = (a.unwrap(), b.unwrap());
                assert!((a.wi - b.wi).length() < 1e-6 && (a.pdf - b.pdf).abs() < 1e-6, "{a:?} {b:?}");
            }
            for (a, b) in own.pdf_many(&wi).into_iter().zip(expected.pdf_many(&wi)) {
                assert!((a - b).abs() < 1e-6, "{a} {b}");
            }
        }
    }
}
