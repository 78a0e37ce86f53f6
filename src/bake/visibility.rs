//! `headtail bake --visibility`: precomputes the visibility of the sky in a scene.

use std::{path::PathBuf, sync::atomic::Ordering, time::Instant};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use headtail_render::{
    estimator::LearnedVisibility, integrator::learn_visibility, memory, patches::Detail, points::PointSet,
    scene::MaterialSpec, visibility::SceneVisibility,
};

use crate::{
    arguments::{CameraArguments, VISIBILITY_MEGABYTES, ViewArguments},
    given::given,
    progress,
    terminal::say,
};

/// Arguments of `--visibility`.
#[derive(Args)]
#[command(next_help_heading = "For --visibility")]
pub struct Arguments {
    /// Built-in scene or glTF 2.0 file.
    #[arg(long, value_name = "NAME|FILE", requires = "visibility", value_parser = given::<String>())]
    scene: Option<String>,
    #[command(flatten)]
    camera: CameraArguments,
    /// Put a grey diffuse plane under the scene.
    #[arg(long, requires = "visibility")]
    ground: bool,
    /// Give every surface one material.
    /// The visibility holds for all materials, but is sampled where this one reflects light from.
    #[arg(long, value_name = "SPEC", requires = "visibility", value_parser = given::<MaterialSpec>())]
    material: Option<MaterialSpec>,
    /// Maximum number of surfaces on a light path.
    /// Visibility at later surfaces helps paths and other viewpoints.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1024))]
    depth: u32,
    /// Training samples per pixel.
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=1_048_576))]
    spp: u32,
    /// Seed of the samples.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Continue from this file, possibly from another viewpoint.
    #[arg(long, value_name = "FILE", requires = "visibility")]
    resume: Option<PathBuf>,
    /// Memory for visibility, in MB of 2^20 bytes.
    /// Cells are larger where it is not enough.
    #[arg(long, value_name = "MB", default_value_t = VISIBILITY_MEGABYTES, value_parser = clap::value_parser!(u32).range(1..=65536))]
    visibility_memory: u32,
    /// Threads to render with. Default: all cores.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

impl Arguments {
    fn view(&self, env: &str) -> Result<ViewArguments> {
        let scene = self.scene.as_ref().context("--scene: name the scene that --visibility is of")?;
        Ok(ViewArguments {
            ground: self.ground,
            material: self.material.clone(),
            depth: self.depth,
            points: PointSet::Independent,
            visibility_memory: self.visibility_memory,
            threads: self.threads,
            ..ViewArguments::of(scene, env, self.camera.clone())
        })
    }

    /// Trains visibility under a map, and reports its size.
    pub fn bake(&self, env: &str) -> Result<SceneVisibility> {
        let start = Instant::now();
        let opened = self.view(env)?.open()?;
        // Training needs a film of the size of the picture.
        memory::require_pictures(opened.part().width, opened.part().height, 0)?;
        let map = &opened.environment;
        let estimator = LearnedVisibility::new(map.clone(), Detail::Leaves, opened.visibility_bytes())?;
        let resumed = |file| SceneVisibility::open(file, Some(&opened.scene().geometry_hash()), map);
        let before = self.resume.as_ref().map(|file| resumed(file)).transpose()?;
        // Samples differ from those of the resumed file, even with an equal seed.
        let seed = self.seed ^ before.as_ref().map_or(0, SceneVisibility::rays);
        let before_seconds = before.as_ref().map_or(Some(0.0), |before| before.seconds);
        let stop = progress::stop_flag()?;
        let bar = progress::bar(progress::FRACTION_UNITS, "learning");
        let show = bar.fraction_setter();
        let mut learned = learn_visibility(opened.view(), &estimator, before, (self.spp, seed), &stop, &show);
        bar.finish_and_clear();
        ensure!(learned.cells() > 0, "the camera sees no surface of {}", opened.scene_name());
        if stop.load(Ordering::Relaxed) {
            bail!(progress::Interrupted::new("nothing was written"));
        }
        let (cells, rays) = (learned.cells(), learned.rays() as f64 / 1e6);
        let seconds = start.elapsed().as_secs_f64();
        learned.seconds = before_seconds.map(|before| before + seconds);
        say!("{cells} cells from {rays:.1} million shadow rays in {seconds:.2} s");
        Ok(learned)
    }
}
