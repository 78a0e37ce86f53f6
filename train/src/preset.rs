//! Named configurations.

use std::{fmt, str::FromStr};

use headtail_model::{Condition, EncoderConfig, HeadConfig};
use headtail_render::{scene::MaterialSpec, tail::TailKind};

use crate::{
    Backend, FitConfig, FlowSize, GradientForm, Loss,
    config::{Over, Points},
};

/// A named configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preset {
    /// The paper's cosine head and optimisation (its section 5).
    PaperCosine,
    /// The paper's microfacet head and optimisation.
    PaperGgx,
    /// The cosine head with learned mixture weight; trains in seconds.
    FastCosine,
    /// A small microfacet head with learned mixture weight; trains in a minute.
    FastGgx,
    /// A smaller head over patches of sky; trains in seconds.
    OverPatches,
}

impl Preset {
    /// All presets.
    pub const ALL: [Self; 5] = [Self::PaperCosine, Self::PaperGgx, Self::FastCosine, Self::FastGgx, Self::OverPatches];

    /// Returns the name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::PaperCosine => "paper-cosine",
            Self::PaperGgx => "paper-ggx",
            Self::FastCosine => "fast-cosine",
            Self::FastGgx => "fast-ggx",
            Self::OverPatches => "over-patches",
        }
    }

    /// Returns the configuration.
    pub fn config(self) -> FitConfig {
        match self {
            Self::PaperCosine => paper_cosine(),
            Self::PaperGgx => paper_ggx(),
            Self::FastCosine => fast_cosine(),
            Self::FastGgx => fast_ggx(),
            Self::OverPatches => over_patches(),
        }
    }

    /// Returns the fast preset for a material.
    pub fn fast_for(material: &MaterialSpec) -> Self {
        if material.is_lambert() { Self::FastCosine } else { Self::FastGgx }
    }
}

impl fmt::Display for Preset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Preset {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|preset| preset.name() == text).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            format!("'{text}' is not a preset; choose one of {names}")
        })
    }
}

/// Of the learning rates from 4e-3 to 3e-2, this one gives the least variance on two maps; batches of 1600 to
/// 8192 points are equally good per point. The betas are the paper's, the weight decay PyTorch's; neither
/// decay nor clipping matters much, and clipping guards against outlier steps. Learned mixture weight and
/// fall-back keep the variance of `head+mis` at or below that of one-sample MIS (`headtail stability`).
fn fast_cosine() -> FitConfig {
    FitConfig {
        material: MaterialSpec::LAMBERT,
        tail: TailKind::Hierarchical,
        fall_back: true,
        setback: 2.0,
        over: Over::Tail,
        points: Points::Strata,
        naive: false,
        backend: Backend::default(),
        gradient: GradientForm::Auto,
        seed: 0,
        steps: 1000,
        conditions: 64,
        strata: 8,
        brdf_samples: 0,
        loss: Loss::LogChiSquare,
        entropic: 0.0,
        learning_rate: 1.6e-2,
        warmup: 0.05,
        beta_1: 0.9,
        beta_2: 0.999,
        epsilon: 1e-8,
        weight_decay: 1e-2,
        clip_norm: 10.0,
        ema_decay: 0.0,
        max_skipped: 10,
        validate_every: 250,
        validation_conditions: 64,
        validation_strata: 32,
        head: HeadConfig { share: true, ..HeadConfig::COSINE },
        flow: FlowSize::Small.settings(),
    }
}

/// Trains in about 40 s on two busy cores; on dancing_hall_1k (alpha = 0.4) the validation variance, 0.0948,
/// is 1.07x that of ten times the steps. After 1500 steps of 4096 points, 64 conditions each, it is 0.169,
/// 0.139, 0.129 and 0.141 at rates of 4e-3, 8e-3, 1.6e-2 and 2.4e-2, 0.139 with K = 16 and 0.126 with twice
/// the width at the best rate; the autoregressive mode has 1.3x the variance (1.5x on kloofendal_overcast_1k)
/// at 8e-3. 128 conditions of 32 points are better than 64 of 64 and 256 of 16 (variance over that of the
/// tail alone after 4000 steps: 0.029, 0.034, 0.036).
fn fast_ggx() -> FitConfig {
    FitConfig {
        material: MaterialSpec::ggx(0.4, 0.4),
        steps: 4000,
        conditions: 128,
        strata: 5,
        brdf_samples: 7,
        learning_rate: 1.6e-2,
        validate_every: 1000,
        head: HeadConfig {
            condition: Condition::Ggx,
            bins: 8,
            encoder: Some(EncoderConfig { hidden: 32, output: 32 }),
            share: true,
            ..HeadConfig::COSINE
        },
        ..fast_cosine()
    }
}

/// Trains in about 10 s on one core. The residual of patches is small and smooth: on studio_small_03_1k the
/// validation variance at alpha = 0.05 is 0.292, and with the head and the rate of [`fast_ggx`] 0.252, at
/// twice the time per sample (patches alone: 0.921).
fn over_patches() -> FitConfig {
    FitConfig {
        over: Over::Patches,
        steps: 1000,
        learning_rate: 1e-2,
        head: HeadConfig { bins: 4, hidden: 16, ..fast_ggx().head },
        ..fast_ggx()
    }
}

/// "AdamW with a learning rate of 0.001 and beta = (0.9, 0.999)", batches of "1024 samples for each of 256
/// conditions", "10k iterations", forward KL with an entropic term of weight 0.0001. The paper names no
/// schedule, weight decay (PyTorch's is 0.01) or clipping: the rate is constant except for the last decay to
/// 0, which the paper may not have. Points are strata of Y with weights; the paper's own method is
/// `points = "tabulated"`.
fn paper_cosine() -> FitConfig {
    FitConfig {
        steps: 10_000,
        conditions: 256,
        strata: 32,
        fall_back: false,
        setback: 0.0,
        loss: Loss::ForwardKl,
        entropic: 1e-4,
        learning_rate: 1e-3,
        warmup: 0.0,
        clip_norm: 1e6,
        validate_every: 500,
        head: HeadConfig::COSINE,
        ..fast_cosine()
    }
}

/// As [`paper_cosine`], with the encoder, K = 32 and roughness as an input. 25 % of the 1024 points come from
/// BRDF sampling, without which strata miss narrow lobes.
fn paper_ggx() -> FitConfig {
    FitConfig {
        material: MaterialSpec::ggx(0.2, 0.8),
        strata: 28,
        brdf_samples: 240,
        head: HeadConfig::MICROFACET,
        ..paper_cosine()
    }
}

#[cfg(test)]
mod tests {
    use headtail_model::Head;

    use super::*;

    #[test]
    fn presets_are_valid_and_parse_from_their_names() {
        for preset in Preset::ALL {
            preset.config().validate().unwrap();
            assert_eq!(preset.name().parse::<Preset>().unwrap(), preset);
        }
        assert!("fast".parse::<Preset>().unwrap_err().contains("fast-cosine"));
    }

    /// Encoder `(c + 1) h + (h + 1) x`; layers `(c + x + f + 1) w + (w + 1) w + (w + 1) (3K + 1)` of width
    /// `w` with `f` = 2 and 1; mixture weight `(c + x + 1) 16 + 17`.
    #[test]
    fn presets_have_the_documented_weight_counts() {
        let device = Backend::default().device().unwrap();
        let counts = Preset::ALL.map(|preset| Head::new(preset.config().head, 0, &device).unwrap().weight_count());
        assert_eq!(counts, [10_714, 35_970, 10_795, 19_379, 4_523]);
    }

    #[test]
    fn the_papers_batches_have_the_papers_size() {
        for preset in [Preset::PaperCosine, Preset::PaperGgx] {
            let shape = preset.config().batch_shape();
            assert_eq!((shape.conditions, shape.samples()), (256, 1024));
        }
    }
}
