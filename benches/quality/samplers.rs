//! The samplers that are measured, and what is trained for them.

use std::{
    cell::OnceCell,
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use headtail_render::{
    bake::{BakedTable, CellGrid, NormalGrid, direct_bake},
    environment::Environment,
    estimator::Ris,
    head::Head,
    patches::{Detail, PatchSampler},
    sampler::{BrdfSampler, Covering, EmitterSampler, EnvironmentLight, OneSampleMis, Oracle, ProductSampler, Sampler},
    tail::TailKind,
};
use headtail_train::{FitConfig, Material, Preset, Viewpoints, build_target, fit, learned_bake, native_head};

use crate::{
    Fallible,
    measure::{Conditions, Quality, measure, measure_by_draws, quadratures},
};

/// Samplers on one map, in the order of the tables' columns; the first is what the others are held against.
pub type Qualities = Vec<(&'static str, Quality)>;

/// Trains a head for a map; with the seconds that it took.
pub fn train(config: &FitConfig, light: &EnvironmentLight) -> Fallible<(Head, f64)> {
    let start = Instant::now();
    let target = build_target(config, light.tail(), Viewpoints::Sphere);
    let fitted = fit(config, &*target, &mut |_| {}, &AtomicBool::new(false))?;
    Ok((native_head(&fitted.head)?, start.elapsed().as_secs_f64()))
}

/// The samplers of a material on one map: all, or `mis` and those that are asked for.
pub fn measure_map(
    material: Material,
    over_patches: &FitConfig,
    environment: &Arc<Environment>,
    only: &[String],
) -> Fallible<Qualities> {
    let light = EnvironmentLight::new(environment.clone(), TailKind::Hierarchical)?;
    let is_wanted = |name: &str| name == "mis" || only.is_empty() || only.iter().any(|only| only == name);
    let config = Preset::fast_for(material).config().for_material(material);
    let trained = OnceCell::new();
    let head = || {
        if let Some(head) = trained.get() {
            return Ok(Head::clone(head));
        }
        let (head, seconds) = train(&config, &light)?;
        println!("{}: trained for {seconds:.1} s", environment.name());
        Ok(trained.get_or_init(|| head).clone())
    };
    let found = if material == Material::Lambert {
        diffuse(&light, &head, &is_wanted)
    } else {
        glossy(material, over_patches, &light, &head, &is_wanted)
    }?;
    match only.iter().find(|only| found.iter().all(|(name, _)| name != only)) {
        Some(unknown) => Err(format!("--only: no sampler is called '{unknown}'").into()),
        None => Ok(found),
    }
}

/// The head of a map, which is trained when it is first asked for.
type Training<'a> = dyn Fn() -> Fallible<Head> + 'a;

/// Measures the samplers whose names are wanted; the others are not made.
macro_rules! wanted {
    ($is_wanted:expr, $($name:literal: $quality:expr,)*) => {{
        let mut found = Qualities::new();
        $(if $is_wanted($name) {
            found.push(($name, $quality));
        })*
        Ok(found)
    }};
}

fn diffuse(light: &EnvironmentLight, head: &Training, is_wanted: &dyn Fn(&str) -> bool) -> Fallible<Qualities> {
    let environment = light.environment();
    let row_column = EnvironmentLight::new(environment.clone(), TailKind::RowColumn)?;
    let conditions = Conditions::of(Material::Lambert);
    let (points, row_column_points) = (quadratures(conditions, light), quadratures(conditions, &row_column));
    let emitter = EmitterSampler::new(light.clone());
    let brdf = BrdfSampler;
    let compensated = EmitterSampler::compensated(light)?;
    let baked = || -> Fallible<BakedTable> {
        Ok(learned_bake(&head()?, light.tail(), NormalGrid::new(16, 32)?, CellGrid::new(32, 32)?)?)
    };
    let by_draws = |candidates| resampled(conditions, light, &emitter, candidates);
    macro_rules! by_quadrature {
        ($sampler:expr) => {
            measure(conditions, &points, &$sampler)
        };
    }
    wanted! { is_wanted,
        "mis": by_quadrature!(OneSampleMis::new(emitter.clone(), brdf)),
        "cosine": by_quadrature!(brdf),
        "emitter": by_quadrature!(emitter),
        "mis-comp": by_quadrature!(OneSampleMis::new(compensated, brdf)),
        "ris:4": by_draws(4)?,
        "ris:16": by_draws(16)?,
        "patches": by_quadrature!(PatchSampler::new(light.clone(), Detail::Leaves)?),
        "patches:fine": by_quadrature!(PatchSampler::new(light.clone(), Detail::Twigs)?),
        "head+mis": by_quadrature!(OneSampleMis::new(ProductSampler::new(light.clone(), head()?), brdf)),
        "baked 32x32": by_quadrature!(ProductSampler::new(light.clone(), baked()?)),
        "direct 8x8": by_quadrature!(direct(light, 8)?),
        "direct 32x32": by_quadrature!(direct(light, 32)?),
        "direct 64x64": by_quadrature!(direct(light, 64)?),
        "direct 32x32 row-column": measure(conditions, &row_column_points, &direct(&row_column, 32)?),
        "oracle": by_quadrature!(ProductSampler::new(light.clone(), Oracle::new(light.tail()))),
    }
}

fn glossy(
    material: Material,
    over_patches: &FitConfig,
    light: &EnvironmentLight,
    head: &Training,
    is_wanted: &dyn Fn(&str) -> bool,
) -> Fallible<Qualities> {
    let conditions = Conditions::of(material);
    let points = quadratures(conditions, light);
    let emitter = EmitterSampler::new(light.clone());
    let brdf = BrdfSampler;
    let compensated = EmitterSampler::compensated(light)?;
    let head = || -> Fallible<_> { Ok(ProductSampler::new(light.clone(), head()?)) };
    let table = direct(light, 32)?;
    macro_rules! by_quadrature {
        ($sampler:expr) => {
            measure(conditions, &points, &$sampler)
        };
    }
    wanted! { is_wanted,
        "mis": by_quadrature!(OneSampleMis::new(emitter.clone(), brdf)),
        "brdf": by_quadrature!(brdf),
        "emitter": by_quadrature!(emitter),
        "mis-comp": by_quadrature!(OneSampleMis::new(compensated, brdf)),
        "ris:4": resampled(conditions, light, &emitter, 4)?,
        "ris:16": resampled(conditions, light, &emitter, 16)?,
        "patches": by_quadrature!(OneSampleMis::new(PatchSampler::new(light.clone(), Detail::Leaves)?, brdf)),
        "patches:fine": by_quadrature!(OneSampleMis::new(PatchSampler::new(light.clone(), Detail::Twigs)?, brdf)),
        "head": by_quadrature!(head()?),
        "head+mis": by_quadrature!(OneSampleMis::new(head()?, brdf)),
        "head+patches": by_quadrature!(OneSampleMis::new(with_head(over_patches, light)?, brdf)),
        "ris:4:head": resampled(conditions, light, &head()?, 4)?,
        "direct": by_quadrature!(table),
        "direct+mis": by_quadrature!(OneSampleMis::new(table.clone(), brdf)),
        "ris:4:direct": resampled(conditions, light, &table, 4)?,
        "oracle": by_quadrature!(ProductSampler::new(light.clone(), Oracle::new(light.tail()))),
    }
}

/// Patches of sky behind a head that is trained for the map.
fn with_head(config: &FitConfig, light: &EnvironmentLight) -> Fallible<PatchSampler> {
    let (head, seconds) = train(config, light)?;
    println!("{}: trained over patches for {seconds:.1} s", light.environment().name());
    Ok(PatchSampler::with_head(light.clone(), Detail::Leaves, head)?)
}

/// RIS over a sampler and BRDF sampling.
fn resampled(
    conditions: Conditions,
    light: &EnvironmentLight,
    first: &(impl Sampler + Clone),
    candidates: u32,
) -> Fallible<Quality> {
    let (first, brdf) = (Covering::new(first.clone())?, Covering::new(BrdfSampler)?);
    let estimator = Ris::new(first, brdf, candidates, light.environment().clone())?;
    Ok(measure_by_draws(conditions, &estimator))
}

/// The cosine direct bake over 16 x 32 normals.
fn direct(light: &EnvironmentLight, side: usize) -> Fallible<ProductSampler<BakedTable>> {
    let table = direct_bake(light.tail(), NormalGrid::new(16, 32)?, CellGrid::new(side, side)?)?;
    Ok(ProductSampler::new(light.clone(), table))
}
