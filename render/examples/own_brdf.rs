//! A custom BRDF: `cargo run --release -p headtail-render --example own_brdf` prints three estimates.

use std::{f32::consts::PI, sync::Arc};

use glam::{Vec2, Vec3, Vec3A, Vec3Swizzles};
use headtail_render::{
    Arena, BrdfTable, Contributions, Environment, Estimator, Frame, Kernel, Lambert, Lobes, MAX_PARAMETERS, OfKernel,
    PointSet, Points, Result, SamplerSpec, ShadingPoint, Surface, Tile,
};

/// The modified Phong BRDF (Lafortune and Willems 1994): diffuse, plus a power of the cosine to the mirrored
/// view.
#[derive(Clone, Copy, Debug)]
pub struct Phong {
    /// Albedo of the diffuse part.
    pub diffuse: f32,
    /// Reflectance of the lobe.
    pub specular: f32,
    /// Exponent of the lobe, above 0.
    pub exponent: f32,
}

impl Phong {
    /// Returns the lobe's solid-angle density.
    fn lobe(&self, n: Vec3, wo: Vec3, wi: Vec3) -> f32 {
        let mirrored = 2.0 * n.dot(wo) * n - wo;
        (self.exponent + 1.0) / (2.0 * PI) * mirrored.dot(wi).max(0.0).powf(self.exponent)
    }

    /// Returns the probability of sampling the lobe.
    fn lobe_weight(&self) -> f32 {
        self.specular / (self.specular + self.diffuse)
    }
}

impl Kernel for Phong {
    const PARAMETERS: usize = 3;

    fn of_parameters(&[diffuse, specular, exponent, ..]: &[f32; MAX_PARAMETERS]) -> Self {
        Self { diffuse, specular, exponent }
    }

    fn parameters(&self) -> [f32; MAX_PARAMETERS] {
        let mut parameters = [0.0; MAX_PARAMETERS];
        parameters[..3].copy_from_slice(&[self.diffuse, self.specular, self.exponent]);
        parameters
    }

    fn evaluate_cosine(&self, n: Vec3, wo: Vec3, wi: Vec3) -> Vec3 {
        let glossy = self.specular * (self.exponent + 2.0) / (self.exponent + 1.0) * self.lobe(n, wo, wi);
        Vec3::splat((self.diffuse / PI + glossy) * n.dot(wi).max(0.0))
    }

    fn sample(&self, n: Vec3, wo: Vec3, u: Vec2) -> (Vec3, f32) {
        let lobe_weight = self.lobe_weight();
        if u.x >= lobe_weight {
            let (wi, _) =
                Lambert { albedo: Vec3::ONE }.sample(n, wo, Vec2::new((u.x - lobe_weight) / (1.0 - lobe_weight), u.y));
            return (wi, self.pdf(n, wo, wi));
        }
        let cos = (u.x / lobe_weight).powf(1.0 / (self.exponent + 1.0));
        let side = Vec2::from_angle(2.0 * PI * u.y) * (1.0 - cos * cos).max(0.0).sqrt();
        let wi = Frame::from_normal(2.0 * n.dot(wo) * n - wo).to_world(side.extend(cos));
        (wi, self.pdf(n, wo, wi))
    }

    fn pdf(&self, n: Vec3, wo: Vec3, wi: Vec3) -> f32 {
        self.lobe_weight() * self.lobe(n, wo, wi) + (1.0 - self.lobe_weight()) * n.dot(wi).max(0.0) / PI
    }

    fn alpha(&self) -> f32 {
        (2.0 / (self.exponent + 2.0)).sqrt()
    }

    /// Approximates the lobe by a microfacet lobe with half vectors of equal width.
    fn lobes(&self, _cos_o: f32) -> Lobes {
        Lobes { diffuse: self.diffuse, specular: 1.0, f0: self.specular, alpha: self.alpha() }
    }
}

/// Returns points that are all seen from above, on one surface of a table with the new BRDF.
pub fn tile(phong: Phong) -> Tile {
    let (table, brdf) = BrdfTable::default().with(Arc::new(OfKernel::<Phong>::NEW));
    let surface = Surface { brdf, parameters: phong.parameters() };
    let point = |k: usize| {
        let ns = Vec3A::from(Vec2::from_angle(k as f32).extend(0.7).normalize().xzy());
        ShadingPoint { p: Vec3A::ZERO, ng: ns, ns, wo: (ns + 0.5 * Vec3A::Y).normalize(), surface }
    };
    Tile::of_table(&std::array::from_fn::<_, 64, _>(point), &table)
}

/// Estimates the mean unshadowed light that the points reflect, with one sample.
pub fn estimate(estimator: &dyn Estimator, tile: &Tile, (points, sample): (PointSet, u32)) -> f64 {
    let (mut contributions, points) = (Contributions::default(), Points::new(points, 1).at_sample(sample));
    estimator.propose(&tile.rows(), &points, &mut contributions, &Arena::default());
    contributions.radiance().iter().map(|value| f64::from(value.y)).sum::<f64>() / tile.len() as f64
}

fn main() -> Result<()> {
    let map = Arc::new(Environment::open("studio")?);
    let tile = tile(Phong { diffuse: 0.3, specular: 0.4, exponent: 60.0 });
    for sampler in ["mis", "ris:4", "patches"] {
        let estimator = sampler.parse::<SamplerSpec>()?.build(&map)?;
        println!(
            "{sampler:8} {:.3}",
            (0..4096).map(|k| estimate(&*estimator, &tile, (PointSet::Sobol, k))).sum::<f64>() / 4096.0
        );
    }
    Ok(())
}
