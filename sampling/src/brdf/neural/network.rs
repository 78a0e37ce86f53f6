//! The network of a measured BRDF, over columns.
//!
//! After Sztrajman et al. 2021, "Neural BRDF Representation and Importance Sampling": the inputs are
//! half and difference vectors, the outputs are logarithms of `1 + f_r` per channel. The surface is
//! isotropic: of the half vector, only the angle to the normal matters.

use glam::Vec3;

use crate::{
    brdf::{MAX_PARAMETERS, Surfaces},
    columns::{strips, vectorized},
    error::{Error, Result},
    linear::{Linear, Packed, Start},
    simd::{self, LANES, Lanes},
};

/// Number of inputs: half vector, then difference vector.
pub const INPUTS: usize = 6;
/// Number of outputs: one logarithm per channel.
pub const OUTPUTS: usize = 3;
/// Number of layers of the network.
pub const LAYERS: usize = 3;
/// Maximum width of hidden layers.
pub const MAX_HIDDEN: usize = 32;

/// Squared sine of the angle between half vector and normal below which the azimuth is only rounding error.
const SMALLEST_SQUARED_SINE: f32 = 1e-13;

/// Affine layers with ReLU between them, 6 - hidden - hidden - 3: `f_r = max(0, exp(network(x)) - 1)`.
///
/// With the half vector `h` in the plane y = 0 of a frame whose z axis is the normal,
/// `x = (h.x, 0, h.z, d.x, d.y, d.z)`, where `d` is `wi` turned about the y axis by the angle that
/// takes `h` to the z axis (Rusinkiewicz 1998).
#[derive(Clone)]
pub struct Network {
    layers: [Linear; LAYERS],
    packed: [Packed; LAYERS],
}

impl Network {
    /// Makes a network of its layers.
    ///
    /// # Errors
    /// The layers' sizes do not match, or a hidden layer is wider than [`MAX_HIDDEN`].
    pub fn new(name: &str, layers: [Linear; LAYERS]) -> Result<Self> {
        let sizes = layers.each_ref().map(|layer| (layer.inputs(), layer.outputs()));
        let [first, second, third] = sizes;
        let follow = first.0 == INPUTS && first.1 == second.0 && second.1 == third.0 && third.1 == OUTPUTS;
        if !follow || first.1 > MAX_HIDDEN || second.1 > MAX_HIDDEN {
            let reason =
                format!("its layers are {sizes:?} (inputs, outputs); 6 - h - h - 3 with h up to {MAX_HIDDEN} is known");
            return Err(Error::argument(name, reason));
        }
        let packed = layers.each_ref().map(Packed::new);
        Ok(Self { layers, packed })
    }

    /// The layers in order.
    pub fn layers(&self) -> &[Linear; LAYERS] {
        &self.layers
    }

    /// An upper bound on the network's logarithms over all directions.
    pub fn bound(&self) -> f32 {
        let mut reach = vec![1.0; INPUTS];
        for layer in &self.layers {
            let rows = layer.weight().chunks_exact(layer.inputs()).zip(layer.bias());
            let bound = |(row, bias): (&[f32], &f32)| {
                bias.abs() + row.iter().zip(&reach).map(|(weight, reach)| weight.abs() * reach).sum::<f32>()
            };
            reach = rows.map(bound).collect();
        }
        reach.into_iter().fold(0.0, |a: f32, b| if b <= a { a } else { b })
    }

    /// [`Self::reflected`] with the normal along z.
    pub fn of_pairs(&self, pairs: &[[Vec3; 2]]) -> Vec<Vec3> {
        self.reflected(Vec3::Z, pairs)
    }

    /// Evaluates `f_r max(0, n . wi)` per channel for pairs of `wo` and `wi` at one normal.
    pub fn reflected(&self, n: Vec3, pairs: &[[Vec3; 2]]) -> Vec<Vec3> {
        let count = strips(pairs.len());
        let mut columns = vec![vec![[0.0; LANES]; count]; 9];
        for (column, number) in columns[6..].iter_mut().zip(n.to_array()) {
            column.fill([number; LANES]);
        }
        for (place, pair) in pairs.iter().enumerate() {
            for (column, number) in columns.iter_mut().zip(pair.iter().flat_map(Vec3::to_array)) {
                column.as_flattened_mut()[place] = number;
            }
        }
        let [a, b, c, d, e, f, x, y, z] = std::array::from_fn(|k| &columns[k][..]);
        let at = Surfaces { n: [x, y, z], wo: [a, b, c], parameters: [x; MAX_PARAMETERS] };
        let mut out = [(); OUTPUTS].map(|()| vec![[0.0; LANES]; count]);
        let [red, green, blue] = &mut out;
        self.evaluate_cosine(&at, [d, e, f], [red, green, blue]);
        let channels = out.each_ref().map(|column| column.as_flattened());
        (0..pairs.len()).map(|place| Vec3::from_array(channels.map(|channel| channel[place]))).collect()
    }

    /// Evaluates `f_r max(0, n . wi)` per channel, in 1/sr; 0 where a direction is below the horizon.
    pub fn evaluate_cosine(&self, at: &Surfaces<'_>, wi: [&[Lanes]; 3], out: [&mut [Lanes]; 3]) {
        evaluate(self, at, wi, out);
    }
}

/// The network's inputs for a pair of directions.
#[inline(always)]
fn inputs(n: Vec3, wo: Vec3, wi: Vec3) -> [f32; INPUTS] {
    let sum = wo + wi;
    let h = sum * reciprocal_length(sum.dot(sum));
    // The sine of the angle to the normal by a cross product, without cancellation.
    let across = n.cross(h);
    let squared_sine = across.dot(across);
    // A half vector without azimuth takes that of wi, which puts the difference vector into the plane y = 0.
    let has_azimuth = squared_sine > SMALLEST_SQUARED_SINE;
    let fallback = n.cross(wi);
    let across = Vec3::new(
        if has_azimuth { across.x } else { fallback.x },
        if has_azimuth { across.y } else { fallback.y },
        if has_azimuth { across.z } else { fallback.z },
    );
    let y = across * reciprocal_length(across.dot(across));
    let x = y.cross(n);
    let (cos, sin) = (n.dot(h), squared_sine.sqrt());
    [sin, 0.0, cos, cos * x.dot(wi) - sin * n.dot(wi), y.dot(wi), h.dot(wi)]
}

/// 1 over the square root of a squared length; finite for the zero vector.
#[inline(always)]
fn reciprocal_length(squared: f32) -> f32 {
    1.0 / if squared > f32::MIN_POSITIVE { squared } else { f32::MIN_POSITIVE }.sqrt()
}

vectorized! {
    fn evaluate['a](simd, network: &'a Network, at: &'a Surfaces<'a>, wi: [&'a [Lanes]; 3], out: [&'a mut [Lanes]; 3]) {
        let [first, second, third] = &network.packed;
        let (mut seen, mut result) = ([[0.0; LANES]; INPUTS], [[0.0; LANES]; OUTPUTS]);
        let mut hidden = [[[0.0; LANES]; MAX_HIDDEN]; 2];
        let [red, green, blue] = out;
        for strip in 0..red.len() {
            let mut cosine = [0.0; LANES];
            for lane in 0..LANES {
                let n = Vec3::new(at.n[0][strip][lane], at.n[1][strip][lane], at.n[2][strip][lane]);
                let wo = Vec3::new(at.wo[0][strip][lane], at.wo[1][strip][lane], at.wo[2][strip][lane]);
                let wi = Vec3::new(wi[0][strip][lane], wi[1][strip][lane], wi[2][strip][lane]);
                let numbers = inputs(n, wo, wi);
                for k in 0..INPUTS {
                    seen[k][lane] = numbers[k];
                }
                let (cos_o, cos_i) = (n.dot(wo), n.dot(wi));
                cosine[lane] = if (cos_o > 0.0) & (cos_i > 0.0) { cos_i } else { 0.0 };
            }
            let [one, two] = &mut hidden;
            first.forward(simd, Start::Bias, &seen, one, Some(0.0));
            second.forward(simd, Start::Bias, one, two, Some(0.0));
            third.forward(simd, Start::Bias, two, &mut result, None);
            for (out, logs) in [&mut red[strip], &mut green[strip], &mut blue[strip]].into_iter().zip(&result) {
                for lane in 0..LANES {
                    let value = simd::exp(logs[lane]) - 1.0;
                    // Not `max`: it would turn NaN into 0.
                    let value = if value < 0.0 { 0.0 } else { value };
                    out[lane] = if cosine[lane] > 0.0 { value * cosine[lane] } else { 0.0 };
                }
            }
        }
    }
}
