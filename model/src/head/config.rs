//! The shape of a head.

use headtail_render::head::{Condition, Mode};
use serde::{Deserialize, Serialize};

use crate::{
    Result,
    error::within,
    spline::{MAX_BINS, logit_count},
};

/// The conditioner encoder: `c -> hidden -> output`, leaky ReLU after both layers. Its output is appended to
/// the condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EncoderConfig {
    /// Width of the hidden layer.
    pub hidden: usize,
    /// Length of the latent vector `xi`.
    pub output: usize,
}

/// The shape of a head.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeadConfig {
    /// The head's inputs: `normal`, `ggx`, `ggx-roughness`, `family` or `texture`; the material determines them.
    pub condition: Condition,
    /// Bins K per spline.
    pub bins: usize,
    /// Width of the spline networks' hidden layers.
    pub hidden: usize,
    /// Number of hidden layers of a spline network.
    pub hidden_layers: usize,
    /// Slope of the leaky ReLU for negative arguments.
    pub leaky_slope: f32,
    /// How the coupling layers are joined: `coupled` or `autoregressive`.
    pub mode: Mode,
    /// The conditioner encoder; `None` (in files `"none"`) feeds the condition to the spline networks
    /// unchanged.
    #[serde(with = "optional_encoder")]
    pub encoder: Option<EncoderConfig>,
    /// Whether the head learns the probability of drawing from it rather than from BRDF sampling.
    #[serde(alias = "selection")]
    pub share: bool,
}

impl HeadConfig {
    /// Cosine-weighted emitter sampling (section 5.1 of the paper): conditioned on the normal, K = 4, no
    /// encoder.
    pub const COSINE: Self = Self {
        condition: Condition::Normal,
        bins: 4,
        hidden: 64,
        hidden_layers: 2,
        leaky_slope: 0.01,
        mode: Mode::Coupled,
        encoder: None,
        share: false,
    };

    /// Microfacet surfaces (section 5.2 of the paper): K = 32, an encoder, roughness as an input.
    pub const MICROFACET: Self = Self {
        condition: Condition::GgxRoughness,
        bins: 32,
        encoder: Some(EncoderConfig { hidden: 64, output: 64 }),
        ..Self::COSINE
    };

    /// Checks every field.
    ///
    /// # Errors
    /// [`crate::Error::Config`] naming the first field that is out of range.
    pub fn validate(&self) -> Result<()> {
        let encoder = self.encoder.unwrap_or(EncoderConfig { hidden: 1, output: 1 });
        within("bins", self.bins, 2..=MAX_BINS, "in 2..=512")?;
        within("hidden", self.hidden, 1..=4096, "in 1..=4096")?;
        within("hidden_layers", self.hidden_layers, 1..=16, "in 1..=16")?;
        within("encoder.hidden", encoder.hidden, 1..=4096, "in 1..=4096")?;
        within("encoder.output", encoder.output, 1..=4096, "in 1..=4096")?;
        within("leaky_slope", self.leaky_slope, 0.0..=1.0, "in 0..=1")
    }

    /// Returns the length of the spline networks' condition: `c`, followed by the encoder's output.
    pub fn network_condition(&self) -> usize {
        self.condition.length() + self.encoder.map_or(0, |encoder| encoder.output)
    }

    /// Returns the number of logits per spline.
    pub fn logits(&self) -> usize {
        logit_count(self.bins)
    }
}

/// Represents a head without encoder as `"none"`, so that a file can remove a preset's encoder.
mod optional_encoder {
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

    use super::EncoderConfig;

    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Form {
        Name(String),
        Sizes(EncoderConfig),
    }

    // Serde requires this signature.
    #[allow(clippy::trivially_copy_pass_by_ref)]
    pub fn serialize<S: Serializer>(encoder: &Option<EncoderConfig>, serializer: S) -> Result<S::Ok, S::Error> {
        match encoder {
            Some(encoder) => encoder.serialize(serializer),
            None => serializer.serialize_str("none"),
        }
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<EncoderConfig>, D::Error> {
        let expected =
            "head.encoder must be \"none\" or have the keys hidden and output, both whole numbers, and no others";
        match Form::deserialize(deserializer).map_err(|_| D::Error::custom(expected))? {
            Form::Sizes(encoder) => Ok(Some(encoder)),
            Form::Name(name) if name == "none" => Ok(None),
            Form::Name(_) => Err(D::Error::custom(expected)),
        }
    }
}
