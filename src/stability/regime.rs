//! The regimes: light, surfaces and training under which importance samplers are known to fail.

use std::{path::Path, sync::Arc};

use anyhow::Result;
use glam::{Vec2, Vec3, Vec3A};
use headtail_render::{
    brdf::{Ggx, Lambert},
    environment::{Environment, MapSpec, built_in},
    image::Image,
    latlong,
    random::{Purpose, Stream},
    scene::MaterialSpec,
    tail::TailKind,
    tile::ShadingPoint,
};
use headtail_train::{FitConfig, Loss, Preset, Viewpoints};

/// A regime: light, surfaces, directions and training.
#[derive(Clone)]
pub struct Regime {
    /// Its name in the table.
    pub name: String,
    /// Why it is hard, in a sentence.
    pub why: &'static str,
    /// The map.
    pub environment: Arc<Environment>,
    /// The surfaces.
    pub material: MaterialSpec,
    /// The normals and view directions.
    pub directions: Directions,
    /// The change in training or weights.
    pub change: Change,
}

/// Distributions of normal and view direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Directions {
    /// The distribution in training.
    Sphere,
    /// View directions 0.6 to 3 degrees above the surface.
    Grazing,
    /// Normals within half a degree of the poles of the map.
    Poles,
    /// Normals within half a degree of the seam of the map.
    Seam,
}

/// Differences from the default training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Change {
    /// Nothing.
    None,
    /// Weights are rounded to half precision.
    HalfWeights,
    /// Ten times the learning rate.
    LearningRate,
    /// Another loss.
    Loss(Loss),
    /// Another tail.
    Tail(TailKind),
}

impl Regime {
    /// Returns the defaults of `headtail fit` for this material with the regime's change, and fewer steps in
    /// quick runs.
    pub fn config(&self, quick: bool) -> FitConfig {
        let mut config = Preset::fast_for(&self.material).config().for_material(self.material.clone());
        // The validation at the end suffices; the others do not affect the result.
        config.validate_every = 0;
        if quick {
            config.steps = 160;
            config.flow.steps = 300;
        }
        match self.change {
            Change::LearningRate => config.learning_rate *= 10.0,
            Change::Loss(loss) => config.loss = loss,
            Change::Tail(tail) => config.tail = tail,
            Change::None | Change::HalfWeights => {}
        }
        config
    }

    /// Returns the shading point of an index.
    pub fn shading_point(&self, index: u64) -> ShadingPoint {
        let mut stream = Stream::new(7, Purpose::Test, index);
        let (wo, n) = self.directions.draw(index, &mut stream);
        let surface = match &self.material {
            MaterialSpec::Lambert { .. } => Lambert { albedo: Vec3::ONE }.into(),
            MaterialSpec::Ggx { alpha, .. } => {
                Ggx::new(alpha.low + (alpha.high - alpha.low) * stream.uniform(), Vec3::ONE).into()
            }
            MaterialSpec::Measured { .. } | MaterialSpec::Neural(_) => {
                unreachable!("the regimes are of analytic materials")
            }
        };
        ShadingPoint { p: Vec3A::ZERO, ng: n, ns: n, wo, surface }
    }
}

impl Directions {
    /// Draws `(wo, n)`.
    fn draw(self, index: u64, stream: &mut Stream) -> (Vec3A, Vec3A) {
        let [wo, n] = Viewpoints::Sphere.draw(stream);
        match self {
            Self::Sphere => (wo, n),
            Self::Grazing => {
                let along = (wo - wo.dot(n) * n).normalize_or(n.any_orthonormal_vector());
                let cosine = 0.01 + 0.04 * stream.uniform();
                ((along * (1.0 - cosine * cosine).sqrt() + cosine * n).normalize(), n)
            }
            Self::Poles | Self::Seam => {
                let at = if self == Self::Poles {
                    if index.is_multiple_of(2) { Vec3A::Y } else { -Vec3A::Y }
                } else {
                    latlong::direction(Vec2::new(0.0, 0.1 + 0.8 * stream.uniform()))
                };
                let n = (at + 0.008 * stream.direction()).normalize();
                (if wo.dot(n) < 0.0 { -wo } else { wo }, n)
            }
        }
    }
}

/// A synthetic map, texel by texel.
fn made(name: &str, width: usize, height: usize, value: impl Fn(usize, usize) -> f32) -> Result<Arc<Environment>> {
    let pixels = (0..width * height).map(|k| [value(k % width, k / width); 3]).collect();
    Ok(Arc::new(Environment::from_image(name, Image { width, height, pixels })?))
}

/// A sun of half a degree towards `(u, v)` of the map, in a sky of luminance 1.
fn sun_at(name: &str, centre: Vec2) -> Result<Arc<Environment>> {
    let (width, height) = (1024, 512);
    let sun = latlong::direction(centre);
    made(name, width, height, |i, j| {
        let x = Vec2::new((i as f32 + 0.5) / width as f32, j as f32 / (height - 1) as f32);
        let towards = latlong::direction(x);
        let angle = towards.dot(sun).clamp(-1.0, 1.0).acos();
        let sky = if towards.y > 0.0 { 1.0 } else { 0.2 };
        sky + if angle < 0.006 { 5e4 } else { 0.0 }
    })
}

/// A regime and the file that it lacks.
pub type Missing = (String, String);

/// Returns every regime whose map is available, and the names of the others with the files missing in `maps`.
pub fn regimes(maps: Option<&Path>) -> Result<(Vec<Regime>, Vec<Missing>)> {
    let built_in = |name: &str| Arc::new(built_in(name).expect("it is one of the built-in maps"));
    let lambert = |name: &str, why, environment| Regime {
        name: name.to_owned(),
        why,
        environment,
        material: MaterialSpec::LAMBERT,
        directions: Directions::Sphere,
        change: Change::None,
    };
    let studio = built_in("studio");
    let mut all = vec![
        lambert("soft light", "nothing: the control", built_in("overcast")),
        lambert("low sun", "half of the light from a disc near the horizon", built_in("sunset")),
        lambert("hard sun", "a disc of half a degree, 5e4 times the sky", sun_at("hard sun", Vec2::new(0.3, 0.3))?),
        lambert("sun at the pole", "the same at the pole of the map", sun_at("sun at the pole", Vec2::new(0.3, 0.0))?),
    ];
    let mut missing = Vec::new();
    for (name, file) in
        [("spiaggia_di_mondello", "a real hard sun"), ("noon_grass", "a real sun 4 degrees from the pole")]
    {
        let path = maps.map(|folder| folder.join(format!("{name}_1k.hdr"))).filter(|path| path.exists());
        match path {
            Some(path) => all.push(lambert(name, file, Arc::new(Environment::load(&path, &MapSpec::default())?))),
            None => missing.push((name.to_owned(), format!("{name}_1k.hdr"))),
        }
    }
    all.push(lambert(
        "one lit texel",
        "all light from one of 1024 x 512 texels",
        made("one lit texel", 1024, 512, |i, j| f32::from(i == 700 && j == 200))?,
    ));
    all.push(lambert("constant map", "nothing to learn from the light", made("constant", 64, 32, |_, _| 1.0)?));
    all.push(lambert(
        "black half",
        "no light from half of the sphere",
        made("black half", 256, 128, |i, _| f32::from(i < 128))?,
    ));
    all.push(lambert(
        "1e6 : 1",
        "a lamp 1e6 times brighter than the room",
        made("1e6 : 1", 256, 128, |i, j| if i / 4 == 40 && j / 4 == 10 { 1e6 } else { 1.0 })?,
    ));
    for alpha in [0.4, 0.2, 0.1, 0.05, 0.02] {
        let material = MaterialSpec::ggx(alpha, alpha);
        all.push(Regime {
            material,
            ..lambert(&format!("alpha = {alpha}"), "narrow lobes among small lights", studio.clone())
        });
    }
    let rough = MaterialSpec::ggx(0.2, 0.2);
    all.push(Regime {
        material: rough,
        directions: Directions::Grazing,
        ..lambert("grazing view", "alpha = 0.2, seen from 0.6 to 3 degrees above the surface", studio.clone())
    });
    for (name, directions) in [("normals at the poles", Directions::Poles), ("normals on the seam", Directions::Seam)] {
        all.push(Regime { directions, ..lambert(name, "where the map's coordinates are singular", studio.clone()) });
    }
    for (name, why, change) in [
        ("half-precision weights", "weights rounded to 11 bits", Change::HalfWeights),
        ("learning rate x 10", "steps too large", Change::LearningRate),
        ("forward KL", "the paper's loss", Change::Loss(Loss::ForwardKl)),
        ("reverse KL", "a loss that the paper found unstable", Change::Loss(Loss::ReverseKl)),
        ("chi-square loss", "a loss with unbounded gradients", Change::Loss(Loss::ChiSquare)),
        ("row-column tail", "a tail with other discontinuities", Change::Tail(TailKind::RowColumn)),
        ("flow tail", "a smooth tail that is not exact, of a map with hard edges", Change::Tail(TailKind::Flow)),
    ] {
        all.push(Regime { change, ..lambert(name, why, studio.clone()) });
    }
    Ok((all, missing))
}

/// Rounds to IEEE half precision: 11 significant bits, up to 65504, subnormal below 6.1e-5.
pub fn to_half_precision(x: f32) -> f32 {
    let held = x.clamp(-65_504.0, 65_504.0);
    // Adding and subtracting a power of two 13 binary places up rounds off the lower bits; half floats have
    // no exponent below -14.
    let exponent = held.abs().max(6.103_515_6e-5).log2().floor();
    let unit = (exponent - 10.0).exp2();
    (held / unit).round_ties_even() * unit
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_precision_keeps_eleven_bits() {
        for (x, half) in
            [(1.0, 1.0), (1.0 + 1.0 / 2048.0, 1.0), (1.0 + 3.0 / 2048.0, 1.0 + 2.0 / 1024.0), (1e9, 65_504.0)]
        {
            assert_eq!(to_half_precision(x), half);
            assert_eq!(to_half_precision(-x), -half);
        }
        assert_eq!(to_half_precision(0.0), 0.0);
        // The smallest subnormal half is 2^-24.
        assert_eq!(to_half_precision(5e-8), 5.960_464_5e-8);
        assert_eq!(to_half_precision(1e-8), 0.0);
    }

    #[test]
    fn directions_match_their_names() {
        let (regimes, missing) = regimes(None).unwrap();
        assert_eq!(missing.len(), 2);
        for regime in &regimes {
            regime.config(true).validate().unwrap();
            for index in 0..50 {
                let at = regime.shading_point(index);
                assert!(at.ns.is_normalized() && at.wo.is_normalized() && at.ns.dot(at.wo) > 0.0);
                match regime.directions {
                    Directions::Sphere => {}
                    Directions::Grazing => assert!((0.009..0.051).contains(&at.ns.dot(at.wo))),
                    Directions::Poles => assert!(at.ns.y.abs() > 0.9999),
                    Directions::Seam => {
                        let u = latlong::square(at.ns).x;
                        assert!(u.min(1.0 - u) < 0.01);
                    }
                }
            }
        }
    }
}
