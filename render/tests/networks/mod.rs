//! Networks of synthetic BRDFs for tests.

use std::sync::Arc;

use headtail_render::{
    brdf::{
        BrdfTable,
        neural::{INPUTS, Network, NeuralBrdf, OUTPUTS},
    },
    head::Linear,
    random::{Purpose, Stream},
};

const HIDDEN: usize = 21;

/// A reflection whose logarithm is `base`, plus `grazing` towards grazing light, plus up to `peak` where the
/// sine of the half vector's angle is below `width`, plus `waves` of a random network; at `waves` 0 all
/// channels are equal.
pub struct Form {
    pub base: f32,
    pub peak: f32,
    pub width: f32,
    pub grazing: f32,
    pub waves: f32,
    pub seed: u64,
}

pub const MIRROR: Form = Form { base: 0.05, peak: 3.0, width: 0.3, grazing: 0.3, waves: 0.0, seed: 0 };
#[allow(dead_code, reason = "not every test binary asks for it")]
pub const MATTE: Form = Form { base: 0.2, peak: 0.3, width: 0.8, grazing: 0.5, waves: 0.0, seed: 0 };
#[allow(dead_code, reason = "not every test binary asks for it")]
pub const ODD: Form = Form { base: 0.3, peak: 1.5, width: 0.5, grazing: 0.2, waves: 0.25, seed: 3 };

impl Form {
    pub fn network(&self) -> Network {
        let mut random = Stream::new(self.seed, Purpose::Test, 77);
        let mut noise =
            |count: usize| -> Vec<f32> { (0..count).map(|_| self.waves * (random.uniform() - 0.5)).collect() };
        let (mut first, mut first_bias) = (noise(HIDDEN * INPUTS), noise(HIDDEN));
        // Unit 0 is the peak, unit 1 grows towards grazing light; later layers pass both on.
        first[..INPUTS].copy_from_slice(&[-1.0 / self.width, 0.0, 0.0, 0.0, 0.0, 0.0]);
        first[INPUTS..2 * INPUTS].copy_from_slice(&[0.0, 0.0, 0.0, 0.0, 0.0, -1.0]);
        (first_bias[0], first_bias[1]) = (1.0, 1.0);
        let (mut second, mut second_bias) = (noise(HIDDEN * HIDDEN), noise(HIDDEN));
        for unit in 0..2 {
            second[unit * HIDDEN..(unit + 1) * HIDDEN].fill(0.0);
            second[unit * HIDDEN + unit] = 1.0;
            second_bias[unit] = 0.0;
        }
        let mut third = noise(OUTPUTS * HIDDEN);
        for channel in third.chunks_exact_mut(HIDDEN) {
            (channel[0], channel[1]) = (self.peak, self.grazing);
        }
        let linear = |inputs, outputs, weight: &[f32], bias: Vec<f32>| {
            Linear::new("form", inputs, outputs, weight, bias).unwrap()
        };
        let layers = [
            linear(INPUTS, HIDDEN, &first, first_bias),
            linear(HIDDEN, HIDDEN, &second, second_bias),
            linear(HIDDEN, OUTPUTS, &third, vec![self.base; OUTPUTS]),
        ];
        Network::new("form", layers).unwrap()
    }
}

/// Returns a table of the analytic BRDFs, then these.
#[allow(dead_code, reason = "not every test binary asks for it")]
pub fn table(forms: &[&Form]) -> BrdfTable {
    forms.iter().fold(BrdfTable::default(), |table, form| {
        table.with(Arc::new(NeuralBrdf::new("form", form.network()).unwrap())).0
    })
}
