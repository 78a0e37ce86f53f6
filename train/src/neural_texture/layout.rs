//! The layout of a material's weights in one list.

use headtail_render::{
    brdf::neural_texture::{
        Description, FEATURES, MIXTURE_SIZES, Networks, NeuralTexture, Pyramid, REFLECTANCE_SIZES, SHIFT_SIZES,
    },
    head::Linear,
    random::{Purpose, Stream},
};

use crate::Result;

/// Slope of the leaky ReLU of the networks.
pub const LEAKY_SLOPE: f32 = 0.01;

/// Sizes of the networks in the order of their weights.
pub(super) const NETWORKS: [&[usize]; 3] = [&SHIFT_SIZES, &REFLECTANCE_SIZES, &MIXTURE_SIZES];

/// The order of weights in one list: texels, then for each network layer by layer a row-major `[out, in]`
/// weight and a bias.
#[derive(Clone, Debug)]
pub struct Layout {
    side: usize,
}

impl Layout {
    /// Returns the layout for a texture of `side` texels along an axis.
    pub fn new(side: usize) -> Self {
        Self { side }
    }

    /// Returns the number of texels of all levels.
    pub fn texels(&self) -> usize {
        Pyramid::texel_count(self.side)
    }

    /// Returns the number of weights.
    pub fn weight_count(&self) -> usize {
        let layers = NETWORKS.iter().flat_map(|sizes| sizes.windows(2));
        FEATURES * self.texels() + layers.map(|size| (size[0] + 1) * size[1]).sum::<usize>()
    }

    /// Returns the weights before the first step: small random texels, networks initialised as in PyTorch,
    /// and no shift.
    pub fn initial_weights(&self, seed: u64) -> Vec<f32> {
        let mut random = Stream::new(seed, Purpose::Weights, 0);
        let mut weights: Vec<f32> = (0..FEATURES * self.texels()).map(|_| 0.2 * (random.uniform() - 0.5)).collect();
        for (network, sizes) in NETWORKS.iter().enumerate() {
            for (index, size) in sizes.windows(2).enumerate() {
                let is_last_of_shift = network == 0 && index + 2 == sizes.len();
                let bound = if is_last_of_shift { 0.0 } else { 1.0 / (size[0] as f32).sqrt() };
                weights.extend((0..(size[0] + 1) * size[1]).map(|_| bound * (2.0 * random.uniform() - 1.0)));
            }
        }
        weights
    }

    /// Returns the renderer's form.
    ///
    /// # Errors
    /// If a weight is not finite.
    pub fn material(&self, weights: &[f32], description: Description) -> Result<NeuralTexture> {
        let (texels, mut rest) = weights.split_at(FEATURES * self.texels());
        let pyramid = Pyramid::new(self.side, texels.as_chunks().0.to_vec())?;
        let mut networks = Vec::new();
        for sizes in NETWORKS {
            let mut layers = Vec::new();
            for (index, size) in sizes.windows(2).enumerate() {
                let (weight, others) = rest.split_at(size[0] * size[1]);
                let (bias, others) = others.split_at(size[1]);
                let name = format!("linear{index}");
                layers.push(Linear::new(&name, size[0], size[1], weight, bias.to_vec())?);
                rest = others;
            }
            networks.push(layers);
        }
        let [shift, reflectance, mixture] = networks.try_into().expect("there are three networks");
        let leaky_slope = description.leaky_slope;
        Ok(NeuralTexture::new(pyramid, Networks { shift, reflectance, mixture, leaky_slope }, description)?)
    }

    /// Returns the texels along an axis of the finest level.
    pub(super) fn side(&self) -> usize {
        self.side
    }

    /// Returns the sizes of each network and the offset of its weights.
    pub(super) fn networks(&self) -> [(&'static [usize], usize); 3] {
        let mut start = FEATURES * self.texels();
        NETWORKS.map(|sizes| {
            let first = start;
            start += sizes.windows(2).map(|size| (size[0] + 1) * size[1]).sum::<usize>();
            (sizes, first)
        })
    }
}
