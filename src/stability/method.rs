//! The methods: training in a regime, and the samplers built from it.

use std::{
    cell::OnceCell,
    sync::{Arc, atomic::AtomicBool},
};

use anyhow::{Result, ensure};
use headtail_eval::{DirectionBench, DirectionEffort, DirectionStatistics};
use headtail_render::{
    head::{Head, Linear},
    patches::{Detail, PatchSampler},
    sampler::{BrdfSampler, EmitterSampler, EnvironmentLight, OneSampleMis, ProductSampler, Sampler},
    tail::{Tail, TailKind},
};
use headtail_train::{FitConfig, Run, Viewpoints, build_target, fit, fit_tail, native_head};

use super::regime::{Change, Regime, to_half_precision};

/// A description of each method.
pub const METHODS: [(&str, &str); 6] = [
    (MIS, "one-sample MIS of emitter and BRDF sampling: the baseline"),
    (PATCHES, "patches of sky, beside BRDF sampling where lobes are narrow: the product in closed form, no training"),
    ("head", "the head alone: the plain method"),
    (HALVES, "the same head and BRDF sampling, one half each"),
    ("share", "the same with a learned mixture weight, trained jointly"),
    (
        DEFAULT,
        "what headtail fit makes without further flags: a learned mixture weight, and no head that is worse than none",
    ),
];

/// The baseline.
pub const MIS: &str = "mis";
/// The product in closed form.
const PATCHES: &str = "patches";
/// The head in a 1:1 mixture with BRDF sampling, for which it was not trained.
const HALVES: &str = "head and brdf by halves";
/// The result of `headtail fit` without further flags, used as its file specifies.
pub const DEFAULT: &str = "default";

/// One row of the table.
pub struct Row {
    /// The regime's name.
    pub regime: String,
    /// One of [`METHODS`].
    pub method: &'static str,
    /// The figures, or an error.
    pub outcome: Result<DirectionStatistics, String>,
    /// Skipped training steps.
    pub skipped: usize,
    /// A remark on the training.
    pub note: String,
}

/// A trained head with its light.
#[derive(Clone)]
struct Trained {
    head: Head,
    light: EnvironmentLight,
    skipped: usize,
    fell_back: bool,
}

/// Context of the measurements in a regime.
pub struct StabilityContext<'a> {
    regime: &'a Regime,
    bench: DirectionBench,
    config: FitConfig,
    rows: Vec<Row>,
    stop: &'a AtomicBool,
    /// The tail of all methods.
    tail: OnceCell<Arc<Tail>>,
}

impl<'a> StabilityContext<'a> {
    /// Measures every method in a regime. Results after the stop flag is set are invalid.
    pub fn run(
        regime: &'a Regime,
        config: FitConfig,
        effort: DirectionEffort,
        stop: &'a AtomicBool,
    ) -> Result<Vec<Row>> {
        let light = EnvironmentLight::new(regime.environment.clone(), TailKind::Hierarchical)?;
        let bench = DirectionBench::new(&regime.name, &light, effort, |index| regime.shading_point(index));
        ensure!(bench.lit() > 1, "{}: no shading point sees light", regime.name);
        let mut context = Self { regime, bench, config, rows: Vec::new(), stop, tail: OnceCell::new() };
        context.add(MIS, &OneSampleMis::new(EmitterSampler::new(light.clone()), BrdfSampler), 0, "");
        context.add(PATCHES, &OneSampleMis::new(PatchSampler::new(light, Detail::Leaves)?, BrdfSampler), 0, "");
        context.heads();
        Ok(context.rows)
    }

    fn heads(&mut self) {
        let mut plain = FitConfig { fall_back: false, ..self.config.clone() };
        plain.head.share = false;
        match self.train(&plain) {
            Ok(trained) => {
                let product = trained.sampler();
                self.add("head", &product, trained.skipped, "");
                self.add(HALVES, &OneSampleMis::new(product, BrdfSampler), trained.skipped, "");
            }
            Err(error) => ["head", HALVES].into_iter().for_each(|method| self.stop(method, &error)),
        }
        let default = self.train(&self.config);
        let with_mixture_weight = match &default {
            // The same head, unless training fell back.
            Ok(trained) if !trained.fell_back => Ok(trained.clone()),
            _ => self.train(&FitConfig { fall_back: false, ..self.config.clone() }),
        };
        self.add_trained("share", &with_mixture_weight);
        self.add_trained(DEFAULT, &default);
    }

    /// Measures a trained head as its file would be used (see `SamplerSpec::of_exported`).
    fn add_trained(&mut self, method: &'static str, trained: &Result<Trained>) {
        let trained = match trained {
            Ok(trained) => trained,
            Err(error) => return self.stop(method, error),
        };
        let note = if trained.fell_back { "training did not help: the untrained head was kept" } else { "" };
        self.add(method, &trained.sampler(), trained.skipped, note);
    }

    fn add(&mut self, method: &'static str, sampler: &dyn Sampler, skipped: usize, note: &str) {
        let figures = self.bench.measure(sampler);
        let regime = self.regime.name.clone();
        self.rows.push(Row { regime, method, outcome: Ok(figures), skipped, note: note.to_owned() });
    }

    fn stop(&mut self, method: &'static str, error: &anyhow::Error) {
        let regime = self.regime.name.clone();
        self.rows.push(Row { regime, method, outcome: Err(format!("{error:#}")), skipped: 0, note: String::new() });
    }

    /// Returns the tail of a configuration; a flow tail is fitted once for all methods.
    fn tail(&self, config: &FitConfig) -> Result<Arc<Tail>> {
        if let Some(tail) = self.tail.get() {
            return Ok(tail.clone());
        }
        let run = Run { progress: &mut |_| Ok(()), interrupt: self.stop, checkpoints: None, warn: &mut |_| {} };
        let (tail, _) = fit_tail(config, &self.regime.environment, run)?;
        Ok(self.tail.get_or_init(|| tail).clone())
    }

    fn train(&self, config: &FitConfig) -> Result<Trained> {
        let tail = self.tail(config)?;
        let target = build_target(config, &tail, Viewpoints::Sphere)?;
        let fitted = fit(config, &*target, &mut |_| {}, self.stop)?;
        let mut head = native_head(&fitted.head)?;
        if self.regime.change == Change::HalfWeights {
            head = with_half_weights(&head)?;
        }
        let light = EnvironmentLight::with_tail(self.regime.environment.clone(), tail.clone());
        Ok(Trained { head, light, skipped: fitted.summary.skipped, fell_back: fitted.summary.fell_back })
    }
}

impl Trained {
    /// Builds the sampler that its file specifies: mixed with BRDF sampling if it learned a mixture weight.
    fn sampler(&self) -> Arc<dyn Sampler> {
        let product = Arc::new(ProductSampler::new(self.light.clone(), self.head.clone()));
        if self.head.has_mixture_weight() { Arc::new(OneSampleMis::new(product, BrdfSampler)) } else { product }
    }
}

/// Rounds the head's weights to half precision.
fn with_half_weights(head: &Head) -> Result<Head> {
    let rounded = |values: &[f32]| values.iter().map(|&value| to_half_precision(value)).collect::<Vec<f32>>();
    let part = |prefix: &str| -> Result<Vec<Linear>> {
        let layers = head.layers();
        let of_part = layers.iter().filter(|(name, _)| name.starts_with(prefix));
        let round = |(name, layer): &(String, &Linear)| {
            let (weight, bias) = (rounded(layer.weight()), rounded(layer.bias()));
            Ok(Linear::new(name, layer.inputs(), layer.outputs(), &weight, bias)?)
        };
        of_part.map(round).collect()
    };
    let networks = [part("layer0.")?, part("layer1.")?];
    let head = Head::new(head.condition(), head.mode(), head.leaky_slope(), part("encoder.")?, networks)?
        .with_mixture_weight(part("selection.")?)?;
    Ok(head)
}
