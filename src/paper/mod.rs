//! `headtail paper`: reproduces every table and figure of the paper on one page.
//!
//! | file | concept |
//! | --- | --- |
//! | `scenes.rs`, `neural.rs`, `catcher.rs` | rendered scenes, neural materials, compositing |
//! | `ablation.rs`, `costs.rs` | the parts of the model; costs |
//! | `bias.rs`, `passes.rs` | the bias of the mask; one pass against two |
//! | `fits.rs`, `two_dimensions.rs` | densities of all fits; the two-dimensional example |
//! | `part.rs`, `heads.rs` | parts and trained heads, each computed once and cached |
//! | `comparison.rs`, `measure.rs`, `cosine_weighted.rs` | comparison of samplers in a view |
//! | `densities.rs`, `shot.rs`, `figure.rs` | code that sections share |
//! | `data.rs`, `effort.rs` | maps and scenes; sizes of the computations |

mod ablation;
mod bias;
mod catcher;
mod comparison;
mod cosine_weighted;
mod costs;
mod data;
mod densities;
mod effort;
mod figure;
mod fits;
mod heads;
mod measure;
mod neural;
mod part;
mod passes;
mod scenes;
mod shot;
mod two_dimensions;

use std::{
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Instant,
};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use headtail_eval::machine;
use headtail_render::{
    estimator::Estimator,
    file,
    integrator::{self, Budget, Rendering, View},
    points::{PointSet, Points},
};
use maud::{Markup, PreEscaped, html};
use serde_json::{Value, json};

use self::{
    data::Data,
    effort::Effort,
    heads::Heads,
    part::{CachedPart, Part},
};
use crate::terminal::{self, note, say};
use crate::{
    output::{OutputFolder, make_folder, request_of},
    progress,
    report::{number::duration, shell},
};

/// Make every table and figure of the paper on one page.
/// Writes DIR/paper.html, with the paper's numbers where its text states them.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail paper --quick --out out/paper
  headtail paper --data maps --only catcher --json --out out/paper
  headtail paper --data maps --out out/paper

--quick takes a few minutes on two cores; without it, expect hours; the estimate is printed first. After an interruption the same command \
continues: heads and finished parts of sections are kept in DIR/heads and DIR/sections. Without --data, maps and scenes are the \
built-in ones. Of --data the folders envmaps (.hdr, .exr), scenes (.glb, .gltf), nbrdf (nbrdf_all.f32) and materials (welt, satin and velvet.safetensors; else those of ./checkpoints) are used.")]
pub struct Arguments {
    /// Read maps and scenes from this folder.
    /// Default: the built-in ones.
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Use fewer maps, smaller pictures and shorter training.
    #[arg(long)]
    quick: bool,
    /// Make only sections whose name contains this text; repeatable.
    /// Finished parts of other sections stay on the page.
    #[arg(long, value_name = "TEXT")]
    only: Vec<String>,
    /// Use this many threads. Default: all cores.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Print the figures of all tables as a JSON object.
    #[arg(long)]
    json: bool,
    /// Write the results to this folder.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Context of all parts: data, sizes, heads and the stop flag.
pub struct PaperContext {
    data: Data,
    effort: Effort,
    heads: Heads,
    stop: Arc<AtomicBool>,
}

impl PaperContext {
    /// Renders a view; a signal stops it early.
    fn render(&self, view: View<'_>, estimator: &dyn Estimator, spp: u32, seed: u64) -> Rendering {
        let points = Points::new(PointSet::Sobol, seed);
        integrator::render(view, estimator, Budget::Spp(spp), points, &self.stop, &|_| {})
    }

    /// Fails after a signal, so that an unfinished part is not cached.
    fn check(&self) -> Result<()> {
        if self.stop.load(Ordering::Relaxed) {
            bail!(progress::Interrupted::new("the same command goes on with the part that was being made"));
        }
        Ok(())
    }
}

/// A section of the page.
struct Section {
    name: &'static str,
    title: &'static str,
    /// Text before the parts, as HTML.
    intro: String,
    parts: Vec<Part>,
}

fn sections(context: &PaperContext) -> Vec<Section> {
    let section = |name, title, (intro, parts): (String, Vec<Part>)| Section { name, title, intro, parts };
    vec![
        section("example", "A product of an image and a Gaussian", two_dimensions::section(context)),
        section("fits", "Fits of maps and materials", fits::section(context)),
        section("cosine", "Cosine-weighted emitter sampling", scenes::cosine(context)),
        section("microfacet", "Microfacet materials", scenes::microfacet(context)),
        section("neural", "Neural materials", neural::section(context)),
        section("catcher", "Shadow-catcher compositing", catcher::section(context)),
        section("ablation", "Ablation", ablation::section(context)),
        section("costs", "Costs", costs::section(context)),
    ]
}

/// Makes all missing parts and rewrites the page after each.
pub fn run(arguments: &Arguments) -> Result<()> {
    if arguments.json {
        terminal::only_data();
    }
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads)).build_global().context("--threads")?;
    }
    let start = Instant::now();
    let data = Data::open(arguments.data.as_deref(), arguments.quick)?;
    let effort = if arguments.quick { Effort::QUICK } else { Effort::FULL };
    let stamp = format!("{} {} {effort:?}", env!("CARGO_PKG_VERSION"), data.key()?);
    // `--only` is not part of the request: its sections are added to those in the folder.
    let request = request_of(["paper", &stamp].map(Into::into).into_iter());
    let output = OutputFolder::take_for(&arguments.out, &["paper.html"], request)?;
    let folder = arguments.out.join("sections");
    make_folder(&folder)?;
    CachedPart::remove_others(&folder, &arguments.out, &stamp)?;
    let stop = progress::stop_flag()?;
    let heads = Heads::new(&arguments.out.join("heads"), effort, stop.clone())?;
    let context = PaperContext { data, effort, heads, stop };
    let sections = sections(&context);
    let is_wanted = |name: &str| arguments.only.is_empty() || arguments.only.iter().any(|text| name.contains(&**text));
    ensure!(sections.iter().any(|section| is_wanted(section.name)), "--only: there is no section of such a name");
    let known = |section: &Section| -> Vec<Option<CachedPart>> {
        section.parts.iter().map(|part| CachedPart::read(&folder, section.name, &part.name, &stamp)).collect()
    };
    let mut page = Page { cached: sections.iter().map(known).collect(), sections };
    let missing = page.missing(is_wanted);
    page.announce(&missing);
    let cost = |&(k, j): &(usize, usize)| (1000.0 * page.sections[k].parts[j].cost).ceil() as u64;
    let costs: Vec<u64> = missing.iter().map(cost).collect();
    let bar = progress::bar(costs.iter().sum(), "paper");
    let path = output.file("paper.html")?;
    let write = |page: &Page| file::replace(&path, page.encode(&context).as_bytes());
    let draw = |cached: &CachedPart| cached.made.drawings.iter().try_for_each(|drawing| drawing.write(&arguments.out));
    page.cached.iter().flatten().flatten().try_for_each(draw)?;
    write(&page)?;
    for (&(k, j), cost) in missing.iter().zip(costs) {
        let (section, part) = (&page.sections[k], &page.sections[k].parts[j]);
        let name = format!("{}: {}", section.name, part.name);
        bar.set_message(&name);
        let cached = part.make(&context, &stamp).with_context(|| name.clone())?;
        // A signal stops renderings early; their figures are invalid.
        context.check()?;
        cached.write(&folder, section.name, &part.name)?;
        draw(&cached)?;
        note!("{name}: {}", duration(cached.seconds));
        page.cached[k][j] = Some(cached);
        write(&page)?;
        bar.inc(cost);
    }
    bar.finish_and_clear();
    let complete = page.cached.iter().filter(|parts| parts.iter().all(Option::is_some)).count();
    say!(
        "{complete} of {} sections in {}; the page to open is {}",
        page.sections.len(),
        duration(start.elapsed().as_secs_f64()),
        path.display()
    );
    if arguments.json {
        terminal::print_json(&json!({ "page": path.display().to_string(), "sections": page.json() }))?;
    }
    Ok(())
}

/// The page with its finished parts.
struct Page {
    sections: Vec<Section>,
    /// `[section][part]`.
    cached: Vec<Vec<Option<CachedPart>>>,
}

impl Page {
    /// Wanted parts that are missing, as indices of section and part.
    fn missing(&self, is_wanted: impl Fn(&str) -> bool) -> Vec<(usize, usize)> {
        let sections = self.sections.iter().zip(&self.cached).enumerate();
        let wanted = sections.filter(|(_, (section, _))| is_wanted(section.name));
        wanted
            .flat_map(|(k, (_, cached))| (0..cached.len()).filter(|&j| cached[j].is_none()).map(move |j| (k, j)))
            .collect()
    }

    /// Logs the number of missing parts and an estimate of their time on idle cores.
    fn announce(&self, missing: &[(usize, usize)]) {
        let threads = rayon::current_num_threads();
        let seconds: f64 = missing.iter().map(|&(k, j)| self.sections[k].parts[j].cost).sum();
        let all: usize = self.cached.iter().map(Vec::len).sum();
        let is_there = all - missing.len();
        match missing.len() {
            0 => note!("all {is_there} parts are there"),
            count => note!(
                "{count} parts to be made, {is_there} there or not asked for: about {} on {}",
                duration(seconds / threads as f64),
                shell::count(threads, "thread")
            ),
        }
    }

    fn encode(&self, context: &PaperContext) -> String {
        let version = env!("CARGO_PKG_VERSION");
        let main = html! {
            (self.contents(context))
            @for (section, cached) in self.sections.iter().zip(&self.cached) {
                @if cached.iter().any(Option::is_some) {
                    section #(section.name) {
                        h2 { (section.title) }
                        (PreEscaped(&section.intro))
                        @for part in cached.iter().flatten() { (PreEscaped(&part.made.html)) }
                        p.note { "Made in " (duration(cached.iter().flatten().map(|part| part.seconds).sum())) "." (progress_of(cached)) }
                    }
                }
            }
        };
        let page = shell::Page {
            kicker: "paper",
            title: "The paper, figure by figure".into(),
            heading: html! { "The paper, figure by figure" },
            facts: vec![context.data.words(), machine(), format!("headtail {version}")],
            command: &terminal::command(),
            version,
            style: figure::STYLE,
            script: "",
        };
        page.encode(&main)
    }

    fn contents(&self, context: &PaperContext) -> Markup {
        html! {
            section.reading {
                h2 { "Contents" }
                ul {
                    @for (Section { name, title, .. }, cached) in self.sections.iter().zip(&self.cached) {
                        @if cached.iter().any(Option::is_some) { li { a href={ "#" (name) } { (title) } (progress_of(cached)) } }
                        @else { li { (title) " " small { "(not made yet)" } } }
                    }
                }
                p.note {
                    "After Litalien et al. 2024, \u{201c}Neural Product Importance Sampling via Warp Composition\u{201d}. Scenes and maps are not the paper\u{2019}s: \
                     its numbers stand beside ours where its text states them, and only ratios can be compared. Heads are trained with this program\u{2019}s batches and optimiser ("
                    (context.effort.cosine_steps) " and " (context.effort.ggx_steps)
                    " steps), with a learned mixture weight for neural materials only."
                }
            }
        }
    }

    /// All figures by section and part.
    fn json(&self) -> Vec<Value> {
        let section = |(section, cached): (&Section, &Vec<Option<CachedPart>>)| {
            let parts = section.parts.iter().zip(cached).filter_map(|(part, cached)| {
                let cached = cached.as_ref()?;
                Some(json!({ "name": part.name, "seconds": cached.seconds, "tables": cached.made.tables }))
            });
            json!({ "name": section.name, "title": section.title, "parts": parts.collect::<Vec<_>>() })
        };
        self.sections.iter().zip(&self.cached).map(section).collect()
    }
}

/// The number of finished parts, unless all are.
fn progress_of(cached: &[Option<CachedPart>]) -> Markup {
    let there = cached.iter().flatten().count();
    html! { @if there < cached.len() { small { " (" (there) " of " (cached.len()) " parts)" } } }
}

/// Whether a path is a folder.
fn is_folder(path: &Path) -> bool {
    path.is_dir()
}
